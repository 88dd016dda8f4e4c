//! What somebody takes out of a map: surfaces and observations in a part of space.

use crate::atlas::Submap;
use crate::atlas::fusion::{Corrections, FusionSettings};
use crate::field::occupancy::UNKNOWN;
use crate::field::tsdf::RemoveFrom;
use crate::octree::{BLOCK_EDGE, block_coords};
use nalgebra::{Point3, Vector3};
use std::collections::HashSet;

/// Half the diagonal of a cube of edge 1, and a little for rounding.
const HALF_DIAGONAL: f64 = 0.867;

/// What observed space is after it was erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OccupancyThen {
    /// Never observed: free, occupied, all is forgotten.
    Unknown,
    /// What was occupied is free; free space stays, and what was not observed stays so.
    Free,
}

/// What is erased in a region.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Erase {
    /// Surfaces: voxels of the TSDF are unobserved then.
    pub surfaces: bool,
    /// Occupancy; none if it stays.
    pub occupancy: Option<OccupancyThen>,
}

/// What [`erase`] changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErasedVoxels {
    /// Voxels of the TSDF that were observed, at all scales.
    pub surface: u64,
    /// Finest voxels whose occupancy is another one.
    pub occupancy: u64,
}

impl ErasedVoxels {
    /// Whether nothing changed.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl std::ops::AddAssign for ErasedVoxels {
    fn add_assign(&mut self, other: Self) {
        *self = Self { surface: self.surface + other.surface, occupancy: self.occupancy + other.occupancy };
    }
}

/// Erases what a submap has in a region of the map. A voxel is in the region if its centre is: of occupancy, where the root pose puts it; of surfaces, where the mesh of the map
/// has it, which is bent as corrections have moved the scans.
///
/// `distance` is that of a point of the map frame to the border of the region, metres, negative in it; where that is not known it may be anything nearer to zero with
/// the right sign. The result does not depend on the number of threads.
pub fn erase(submap: &mut Submap, distance: &(impl Fn([f64; 3]) -> f64 + Sync), what: Erase, settings: &FusionSettings) -> ErasedVoxels {
    let (voxel, t_map_submap) = (f64::from(submap.voxel_size), submap.t_map_submap);
    let in_map = |c: [f64; 3]| t_map_submap * Point3::from(c.map(|c| c * voxel));
    let in_voxels = |c: [f64; 3]| distance(in_map(c).coords.into()) / voxel;
    let mut erased = ErasedVoxels::default();
    if what.surfaces && !submap.tsdf.is_empty() {
        let (edge, half) = (BLOCK_EDGE as f64, 0.5 * BLOCK_EDGE as f64);
        let corrections = Corrections::new(submap, &t_map_submap);
        let bend = |c: [f64; 3]| if corrections.is_empty() { Vector3::zeros() } else { corrections.at_point(&in_map(c)) };
        let bent = |c: [f64; 3], bend: &Vector3<f64>| distance((in_map(c) + bend).coords.into()) / voxel;
        let middle = |key: u64| block_coords(key).map(|c| f64::from(c) * edge + half);
        // A voxel more, as a block is bent a little differently from end to end.
        let reaches = |key: &u64| bent(middle(*key), &bend(middle(*key))) <= HALF_DIAGONAL * edge + 1.0;
        let blocks: HashSet<u64> = submap.tsdf.ids().map(|id| submap.tsdf.block(id).key).filter(reaches).collect();
        if !blocks.is_empty() {
            // Centres that are asked for together are those of a block.
            let is_erased = |centres: &[[f32; 3]]| {
                let bend = centres.first().map_or_else(Vector3::zeros, |first| bend(first.map(|c| ((f64::from(c) / edge).floor() + 0.5) * edge)));
                centres.iter().map(|c| bent(c.map(f64::from), &bend) < 0.0).collect()
            };
            erased.surface = submap.tsdf.remove_voxels(RemoveFrom::Blocks(&blocks), &is_erased) as u64;
            submap.tsdf.compact_all();
        }
    }
    if let Some(then) = what.occupancy {
        let free = settings.log_odds_limits()[0];
        let change = |value: i8| match then {
            OccupancyThen::Unknown => UNKNOWN,
            OccupancyThen::Free => {
                if value > 0 {
                    free
                } else {
                    value
                }
            }
        };
        erased.occupancy = submap.occupancy.overwrite(&in_voxels, &change);
    }
    submap.revision += u64::from(!erased.is_none());
    erased
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::SubmapScan;
    use crate::field::tsdf::Voxel;
    use crate::field::{BlockHead, TsdfBuilder};
    use crate::geometry::Pose;
    use crate::octree::{block_key, voxel_coords, voxels_at};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_ball_takes_the_voxels_whose_centres_are_in_it(at in prop::array::uniform3(-4.0..4.0f64), turn in prop::array::uniform3(-1.0..1.0f64),
            centre in prop::array::uniform3(-1.0..3.0f64), radius in 0.1..2.0f64, shift in prop::option::of(prop::array::uniform3(-0.5..0.5f64))) {
            const VOXEL: f32 = 0.1;
            let t_map_submap = Pose::new(Vector3::from(at), Vector3::from(turn));
            let mut builder = TsdfBuilder::default();
            let keys: Vec<u64> = (0..8).map(|i| block_key([i & 1, i >> 1 & 1, i >> 2])).collect();
            for key in &keys {
                let voxels: Vec<Voxel> = (0..voxels_at(0)).map(|i| Voxel { distance: i as i16, weight: 16 }).collect();
                builder.push(BlockHead { key: *key, scale: 0, finest: 0, has_intensity: false }, &voxels, &[]).unwrap();
            }
            let mut submap = Submap::new(0, VOXEL, t_map_submap).with_fields(builder.finish(), crate::field::occupancy::OccupancyField::default());
            // A scan that was moved takes all along.
            let shift = shift.map(Vector3::from);
            if let Some(shift) = shift {
                let moved = t_map_submap.inverse() * Pose::translation(shift.x, shift.y, shift.z) * t_map_submap;
                let scans = vec![SubmapScan { node: 0, t_submap_lidar: Pose::identity() }];
                submap = submap.with_scans(scans, 0.0).with_corrected(vec![moved]);
            }
            let middle = (t_map_submap * Point3::from(centre)).coords;
            let distance = |p: [f64; 3]| (Vector3::from(p) - middle).norm() - radius;
            let revision = submap.revision();
            let settings = FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };
            let erased = erase(&mut submap, &distance, Erase { surfaces: true, occupancy: Some(OccupancyThen::Unknown) }, &settings);
            let mut expected = 0;
            for id in submap.tsdf().ids_in_morton_order() {
                let block = submap.tsdf().block(id);
                let corner = block_coords(block.key).map(|c| f64::from(c) * BLOCK_EDGE as f64);
                for (i, voxel) in submap.tsdf().current(block).iter().enumerate() {
                    let c = voxel_coords(i, 0);
                    let p = t_map_submap * Point3::from(std::array::from_fn(|k| (corner[k] + c[k] as f64 + 0.5) * f64::from(VOXEL)));
                    let gone = distance((p + shift.unwrap_or_default()).coords.into());
                    // Points on the border may go either way by rounding.
                    if gone.abs() > 1e-6 {
                        prop_assert_eq!(voxel.is_observed(), gone > 0.0, "{} {}", block.key, i);
                    }
                    expected += u64::from(!voxel.is_observed());
                }
            }
            prop_assert_eq!(erased.surface, expected);
            prop_assert_eq!(submap.revision() > revision, !erased.is_none());
        }
    }
}
