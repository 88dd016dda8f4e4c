//! Colours of a scan into the colour layer of a TSDF: a pass of its own after that of the distances, only for scans that have colours.

use crate::field::tsdf::colour::descendants;
use crate::field::tsdf::{ColourVoxel, TsdfField};
use crate::geometry::Rigid;
use crate::integrate::rays::returns::ReturnsView;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, block_key};

/// How far before and behind its point a return colours voxels, voxels of the block's scale: a mesh takes colours from the two voxels on either side of the
/// surface.
const REACH: f32 = 1.5;
/// Samples per voxel within that distance.
const SAMPLES: f32 = 2.0;

/// The block that was looked up last: consecutive samples are mostly in the same block.
struct BlockContext {
    coords: [i32; 3],
    /// Its id and the scale at which it is integrated.
    block: Option<(u32, usize)>,
}

/// Colours the voxels around the returns of a scan taken at `t_submap_lidar`, which must have been integrated into the field. `colours` has one sRGB entry a
/// return, [0, 0, 0] where a return has no colour. Finest voxels are `voxel` metres wide; returns beyond `max_range` metres are skipped.
pub fn colour_voxels(field: &mut TsdfField, t_submap_lidar: &Rigid, returns: &ReturnsView<'_>, colours: &[[u8; 3]], voxel: f32, max_range: f32) {
    let TsdfField { tree, blocks, colours: layer, .. } = field;
    let mut cursor = Cursor::new(tree);
    let mut context = BlockContext { coords: [i32::MAX; 3], block: None };
    for (i, (&p, &colour)) in returns.points.iter().zip(colours).enumerate().filter(|(_, (_, colour))| **colour != [0; 3]) {
        let origin = returns.origins.get(i).copied().unwrap_or([0.0; 3]);
        let offset: [f32; 3] = std::array::from_fn(|k| p[k] - origin[k]);
        let range = offset.iter().map(|c| c * c).sum::<f32>().sqrt();
        if range > max_range {
            continue;
        }
        let point = t_submap_lidar.apply(p).map(|c| c / voxel);
        let direction = t_submap_lidar.rotate(offset).map(|c| c / range);
        let mut find = |c: [i32; 3]| {
            if context.coords != c {
                let id = cursor.block(tree, block_key(c));
                context = BlockContext { coords: c, block: id.map(|id| (id, usize::from(blocks[id].scale))) };
            }
            context.block
        };
        let Some((_, scale)) = find(point.map(|c| c.floor() as i32 >> BLOCK_SHIFT)) else { continue };
        let step = (1 << scale) as f32 / SAMPLES;
        let samples = (REACH * SAMPLES) as i32;
        let mut last = None;
        for s in -samples..=samples {
            let at: [i32; 3] = std::array::from_fn(|k| (point[k] + s as f32 * step * direction[k]).floor() as i32);
            let Some((id, scale)) = find(at.map(|c| c >> BLOCK_SHIFT)) else { continue };
            let within = at.map(|c| (c & (BLOCK_EDGE as i32 - 1)) as usize >> scale);
            if last.replace((id, within)) != Some((id, within)) {
                let (own_scale, voxels) = layer.block_mut(id, usize::from(blocks[id].finest));
                observe_colour(voxels, own_scale, within, scale, colour);
            }
        }
    }
}

/// Adds a colour observed in voxel `c` at `scale`. The layer stores the block at `own_scale`, which is no coarser; where it is finer, because the block was once
/// observed from nearer, only unknown colours take it.
fn observe_colour(voxels: &mut [ColourVoxel], own_scale: usize, c: [usize; 3], scale: usize, colour: [u8; 3]) {
    for index in descendants(c, scale, own_scale) {
        let voxel_colour = &mut voxels[index];
        if scale == own_scale || !voxel_colour.is_known() {
            *voxel_colour = voxel_colour.with(ColourVoxel::once(colour));
        }
    }
}
