//! Colours of a scan into the colour layer of a TSDF: a pass of its own after the distances, only for scans that have colours.

use super::transform::Returns;
use crate::field::tsdf::colour::cube;
use crate::field::tsdf::{Tint, TsdfField};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, block_key};

/// How far before and behind its point a return gives its colour, voxels of the block's scale: a mesh takes colours from the two voxels
/// on either side of the surface.
const REACH: f32 = 1.5;
/// Samples to a voxel along that way.
const SAMPLES: f32 = 2.0;

/// A block that samples fall into, looked up once for all that follow each other.
struct Home {
    coords: [i32; 3],
    /// Its id and the scale at which it is integrated.
    block: Option<(u32, usize)>,
}

/// Colours the voxels around the returns of a scan taken at `t_submap_lidar`; the field has integrated it before. `colours` has one entry a
/// return, [0, 0, 0] where it has none. Voxels are `voxel` metres; returns beyond `max_range` metres are left out, as they were before.
pub fn paint(field: &mut TsdfField, t_submap_lidar: &Rigid, returns: &Returns<'_>, colours: &[[u8; 3]], voxel: f32, max_range: f32) {
    let TsdfField { tree, blocks, colours: layer, .. } = field;
    let mut cursor = Cursor::new(tree);
    let mut home = Home { coords: [i32::MAX; 3], block: None };
    for (i, (&p, &colour)) in returns.points.iter().zip(colours).enumerate().filter(|(_, (_, colour))| **colour != [0; 3]) {
        let origin = returns.origins.get(i).copied().unwrap_or([0.0; 3]);
        let way: [f32; 3] = std::array::from_fn(|k| p[k] - origin[k]);
        let range = way.iter().map(|c| c * c).sum::<f32>().sqrt();
        if range > max_range {
            continue;
        }
        let point = t_submap_lidar.apply(p).map(|c| c / voxel);
        let direction = t_submap_lidar.rotate(way).map(|c| c / range);
        let mut find = |c: [i32; 3]| {
            if home.coords != c {
                let id = cursor.block(tree, block_key(c));
                home = Home { coords: c, block: id.map(|id| (id, usize::from(blocks[id].scale))) };
            }
            home.block
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
                let (own, tints) = layer.open(id, usize::from(blocks[id].finest));
                observe(tints, own, within, scale, colour);
            }
        }
    }
}

/// Notes a colour seen in voxel `c` at `scale`; the colours are at `own`, no coarser. Where colours are finer, because they were once seen from nearer, only unknown ones take it.
fn observe(tints: &mut [Tint], own: usize, c: [usize; 3], scale: usize, colour: [u8; 3]) {
    for index in cube(c, scale, own) {
        let tint = &mut tints[index];
        if scale == own || !tint.is_known() {
            *tint = tint.with(Tint::once(colour));
        }
    }
}
