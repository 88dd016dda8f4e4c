//! Places on the surface of a field.

use super::super::placement::Placement;
use super::displacement::{Cell, cell_of};
use crate::atlas::Submap;
use crate::field::tsdf::resolve::resolve_block;
use crate::field::tsdf::{TsdfField, Voxel, WEIGHT_ONE};
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, block_coords, edge_at, voxel_coords, voxel_index, voxels_at};
use rayon::prelude::*;

/// Places on the surface of a submap, one for each block that has a clear one, with the directions to their fronts: submap frame, metres and length one.
pub(crate) fn places_on_surface(submap: &Submap) -> Vec<([f32; 3], [f32; 3])> {
    let voxel = submap.voxel_size;
    let points = surface_points(&submap.tsdf, &Placement::new(&Pose::identity(), voxel), 0, |_| true);
    points.into_iter().map(|point| (point.position.map(|c| c * voxel), point.normal)).collect()
}

/// A voxel farther from the surface than this, voxels, is not taken as a place on it.
const NEAR: f32 = 0.75;
/// A distance field has a slope of one: voxels with another one lie between two surfaces or have too much noise.
const SLOPES: std::ops::RangeInclusive<f32> = 0.6..=1.4;

/// A place on the surface of a field.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePoint {
    /// In the common lattice, finest voxels.
    pub position: [f32; 3],
    /// Towards the front of the surface, length one.
    pub normal: [f32; 3],
    /// The number of the field.
    pub field: u32,
}

/// One place for each block with a surface whose cell is `wanted`, in Morton order of the blocks.
pub(super) fn surface_points(field: &TsdfField, placement: &Placement, number: u32, wanted: impl Fn(&Cell) -> bool + Sync) -> Vec<SurfacePoint> {
    let of_block = |id: u32| {
        let key = field.block(id).key;
        if !wanted(&cell_of(placement.middle_in_target(key))) {
            return None;
        }
        let (scale, voxels) = resolve_block(field, id, 0);
        let (scale, voxels) = (usize::from(scale), voxels.unwrap_or_else(|| field.current(field.block(id)).into()));
        let (at, normal) = nearest(&voxels, scale)?;
        let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        let position = placement.t_target_source.apply(std::array::from_fn(|k| corner[k] + at[k] * (1 << scale) as f32));
        Some(SurfacePoint { position, normal: placement.t_target_source.rotate(normal), field: number })
    };
    field.ids_in_morton_order().into_par_iter().with_min_len(256).filter_map(of_block).collect()
}

/// The point of the surface nearest to a voxel's centre and the normal there, in voxels of the block's scale; none if there is no clear one.
fn nearest(voxels: &[Voxel], scale: usize) -> Option<([f32; 3], [f32; 3])> {
    let known = |i: usize| voxels[i].weight >= WEIGHT_ONE;
    let mut near: Vec<usize> = (0..voxels_at(scale)).filter(|&i| known(i) && voxels[i].distance_in_voxels().abs() <= NEAR).collect();
    near.sort_unstable_by_key(|&i| (voxels[i].distance.unsigned_abs(), i));
    near.into_iter().find_map(|i| {
        let (c, distance) = (voxel_coords(i, scale), voxels[i].distance_in_voxels());
        let mut gradient = [0.0; 3];
        for k in 0..3 {
            let beside = |up: bool| {
                let at = if up { c[k] + 1 } else { c[k].checked_sub(1)? };
                let j = (at < edge_at(scale)).then(|| voxel_index(std::array::from_fn(|l| if l == k { at } else { c[l] }), scale))?;
                known(j).then(|| voxels[j].distance_in_voxels())
            };
            gradient[k] = match (beside(false), beside(true)) {
                (Some(low), Some(high)) => 0.5 * (high - low),
                (Some(low), None) => distance - low,
                (None, Some(high)) => high - distance,
                (None, None) => return None,
            };
        }
        let slope = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
        SLOPES.contains(&slope).then(|| {
            let normal = gradient.map(|g| g / slope);
            (std::array::from_fn(|k| c[k] as f32 + 0.5 - distance * normal[k]), normal)
        })
    })
}
