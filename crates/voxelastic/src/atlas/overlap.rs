//! What would a scan add to a submap? (the paper's open question, Sec. VI: a submap count that plateaus)
//!
//! A return that falls where the submap holds a well observed surface, and on that surface, tells nothing new. When most returns of a
//! scan are like that, and those on walls in every direction as well as those on the ground, then the scan belongs into that submap:
//! it adds little, and its pose is evidently consistent with it. A scan that is displaced by more than the truncation band keeps the
//! ground but loses the walls across its displacement, which is why the directions are judged apart and the worst one counts.

use super::Submap;
use crate::field::occupancy::{OccupancyField, State};
use crate::field::tsdf::{TsdfField, WEIGHT_ONE};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_SHIFT, Cursor, block_key, voxel_index};

/// Returns looked at: enough for a percent of accuracy.
const SAMPLES: usize = 4096;
/// A direction counts when at least this share of the returns face it.
const LEAST_SHARE: f64 = 0.05;
/// Observations from which on a voxel counts as well observed.
const WELL_OBSERVED: u16 = 2 * WEIGHT_ONE;
/// A return this many voxels (of the surface's scale) from the surface is still on it.
const ON_SURFACE: f32 = 1.0;

/// A scan to be held against submaps: returns and the normals of their local planes, in the lidar frame.
#[derive(Clone, Copy, Debug)]
pub struct Probe<'a> {
    /// Returns, metres.
    pub points: &'a [[f32; 3]],
    /// Normals of the local planes at the returns; zero where unknown. As many as points.
    pub normals: &'a [[f32; 3]],
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
}

/// Share of the returns that fall on what is known already.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overlap {
    /// Over all returns.
    pub known: f64,
    /// Over the returns that face one axis of the submap, in the worst of the three directions.
    pub worst_direction: f64,
}

/// Holds a scan taken at `t_submap_lidar` against `submap`: its surfaces if it has a TSDF, its occupied space otherwise.
pub fn overlap(submap: &Submap, t_submap_lidar: &Rigid, probe: &Probe<'_>) -> Overlap {
    if submap.tsdf.is_empty() {
        tally(t_submap_lidar, probe, |point, _| is_occupied(&submap.occupancy, point))
    } else {
        let mut cursor = Cursor::new(submap.tsdf.tree());
        tally(t_submap_lidar, probe, |point, normal| is_on_surface(&submap.tsdf, &mut cursor, point, normal))
    }
}

/// Asks `is_known` for returns spread evenly over the scan; points in finest voxels and normals in the submap frame.
fn tally(t_submap_lidar: &Rigid, probe: &Probe<'_>, mut is_known: impl FnMut([f32; 3], [f32; 3]) -> bool) -> Overlap {
    let mut counts = [(0usize, 0usize); 4];
    let step = probe.points.len().div_ceil(SAMPLES).max(1);
    for (point, normal) in probe.points.iter().zip(probe.normals).step_by(step) {
        let normal = t_submap_lidar.rotate(*normal);
        let point = t_submap_lidar.apply(*point).map(|c| c / probe.voxel);
        let facing = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).filter(|_| normal != [0.0; 3]).unwrap_or(3);
        counts[facing].0 += 1;
        counts[facing].1 += usize::from(is_known(point, normal));
    }
    let share = |(all, known): (usize, usize)| if all == 0 { 0.0 } else { known as f64 / all as f64 };
    let total = counts.iter().fold((0, 0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
    let counted = counts[..3].iter().filter(|c| c.0 as f64 >= LEAST_SHARE * total.0 as f64 && c.0 > 0);
    let known = share(total);
    Overlap { known, worst_direction: counted.map(|c| share(*c)).fold(known, f64::min) }
}

/// Whether the TSDF holds a well observed surface within a voxel of `point`. The point's own voxel may have been missed by every beam
/// of a sparse scan, so its neighbours along the normal are asked as well.
fn is_on_surface(field: &TsdfField, cursor: &mut Cursor, point: [f32; 3], normal: [f32; 3]) -> bool {
    [0.0f32, 1.0, -1.0].into_iter().any(|offset| {
        let at: [f32; 3] = std::array::from_fn(|k| point[k] + offset * normal[k]);
        distance_at(field, cursor, at).is_some_and(|(d, edge)| (d - offset / edge).abs() <= ON_SURFACE)
    })
}

/// Where well observed, the distance to the surface at `point` in voxels of the place's own scale, and their edge in finest voxels.
fn distance_at(field: &TsdfField, cursor: &mut Cursor, point: [f32; 3]) -> Option<(f32, f32)> {
    let c = point.map(|v| v.floor() as i32);
    let id = cursor.block(field.tree(), block_key(c.map(|v| v >> BLOCK_SHIFT)))?;
    let block = field.block(id);
    let scale = usize::from(block.scale);
    let voxel = field.voxel(block, voxel_index(c.map(|v| (v & 7) as usize >> scale), scale));
    (voxel.weight >= WELL_OBSERVED).then(|| (voxel.distance_in_voxels(), (1 << scale) as f32))
}

/// Whether `point` or a voxel beside it is occupied.
fn is_occupied(field: &OccupancyField, point: [f32; 3]) -> bool {
    let c = point.map(|v| v.floor() as i32);
    let steps = [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
    steps.iter().any(|s| field.state_at(std::array::from_fn(|k| c[k] + s[k])) == State::Occupied)
}
