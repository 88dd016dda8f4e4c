//! Overlap of a scan with a submap (the open question of the paper's Sec. VI: a submap count that plateaus).
//!
//! A return on a well-observed surface of the submap adds no information. If that holds for most returns of a scan, for those on walls in
//! every direction as well as for those on the ground, the scan is integrated into that submap: it adds little, and its pose is consistent
//! with the submap. A scan that is displaced by more than the truncation band still overlaps on the ground, but not on walls perpendicular
//! to the displacement. So overlap is computed per direction and the smallest value decides.

use super::Submap;
use crate::field::occupancy::{OccupancyField, State};
use crate::field::tsdf::{TsdfField, WEIGHT_ONE};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_SHIFT, Cursor, block_key, voxel_index};

/// Number of returns sampled: enough for an accuracy of one percent.
const SAMPLES: usize = 4096;
/// A direction counts if at least this share of the returns face it.
const MIN_SHARE: f64 = 0.05;
/// Weight from which a voxel counts as well observed.
const WELL_OBSERVED: u16 = 2 * WEIGHT_ONE;
/// Largest distance between a return and a surface that it lies on, voxels of the surface's scale.
const ON_SURFACE: f32 = 1.0;

/// A scan to be compared with submaps: returns and the normals of their local planes, in the lidar frame.
#[derive(Clone, Copy, Debug)]
pub struct OverlapQuery<'a> {
    /// Returns, metres.
    pub points: &'a [[f32; 3]],
    /// Normals of the local planes at the returns; zero where unknown. As many as points.
    pub normals: &'a [[f32; 3]],
}

/// Share of a scan's returns that lie on surfaces of a submap.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overlap {
    /// Of all returns.
    pub known: f64,
    /// Of the returns that face one axis of the submap: the smallest of the three.
    pub worst_direction: f64,
}

/// Overlap of a scan taken at `t_submap_lidar` with `submap`: with its surfaces if it has a TSDF, otherwise with its occupied space.
pub fn overlap(submap: &Submap, t_submap_lidar: &Rigid, query: &OverlapQuery<'_>) -> Overlap {
    if submap.tsdf.is_empty() {
        count(t_submap_lidar, query, submap.voxel_size, |point, _| is_occupied(&submap.occupancy, point))
    } else {
        let mut cursor = Cursor::new(submap.tsdf.tree());
        count(t_submap_lidar, query, submap.voxel_size, |point, normal| is_on_surface(&submap.tsdf, &mut cursor, point, normal))
    }
}

/// Calls `is_known` for returns sampled evenly from the scan, with points in finest voxels and normals in the submap frame.
fn count(t_submap_lidar: &Rigid, query: &OverlapQuery<'_>, voxel_size: f32, mut is_known: impl FnMut([f32; 3], [f32; 3]) -> bool) -> Overlap {
    let mut counts = [(0usize, 0usize); 4];
    let step = query.points.len().div_ceil(SAMPLES).max(1);
    for (point, normal) in query.points.iter().zip(query.normals).step_by(step) {
        let normal = t_submap_lidar.rotate(*normal);
        let point = t_submap_lidar.apply(*point).map(|c| c / voxel_size);
        let facing = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).filter(|_| normal != [0.0; 3]).unwrap_or(3);
        counts[facing].0 += 1;
        counts[facing].1 += usize::from(is_known(point, normal));
    }
    let share = |(all, known): (usize, usize)| if all == 0 { 0.0 } else { known as f64 / all as f64 };
    let total = counts.iter().fold((0, 0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
    let counted = counts[..3].iter().filter(|c| c.0 as f64 >= MIN_SHARE * total.0 as f64 && c.0 > 0);
    let known = share(total);
    Overlap { known, worst_direction: counted.map(|c| share(*c)).fold(known, f64::min) }
}

/// Whether the TSDF has a well-observed surface within a voxel of `point`. All beams of a sparse scan may have missed the point's own
/// voxel, so its neighbours along the normal are tested, too.
fn is_on_surface(field: &TsdfField, cursor: &mut Cursor, point: [f32; 3], normal: [f32; 3]) -> bool {
    [0.0f32, 1.0, -1.0].into_iter().any(|offset| {
        let at: [f32; 3] = std::array::from_fn(|k| point[k] + offset * normal[k]);
        distance_at(field, cursor, at).is_some_and(|(d, edge)| (d - offset / edge).abs() <= ON_SURFACE)
    })
}

/// Distance to the surface at `point` in voxels of the block's scale, and their edge in finest voxels; none where not well observed.
fn distance_at(field: &TsdfField, cursor: &mut Cursor, point: [f32; 3]) -> Option<(f32, f32)> {
    let c = point.map(|v| v.floor() as i32);
    let id = cursor.block(field.tree(), block_key(c.map(|v| v >> BLOCK_SHIFT)))?;
    let block = field.block(id);
    let scale = usize::from(block.scale);
    let voxel = field.voxel(block, voxel_index(c.map(|v| (v & 7) as usize >> scale), scale));
    (voxel.weight >= WELL_OBSERVED).then(|| (voxel.distance_in_voxels(), (1 << scale) as f32))
}

/// Whether the voxel at `point` or one of its six neighbours is occupied.
fn is_occupied(field: &OccupancyField, point: [f32; 3]) -> bool {
    let c = point.map(|v| v.floor() as i32);
    let steps = [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
    steps.iter().any(|s| field.state_at(std::array::from_fn(|k| c[k] + s[k])) == State::Occupied)
}
