//! Adds sampled parts of the source to the target.

use super::sampling::{Resampled, Sampling};
use super::settings::FusionSettings;
use crate::atlas::{Submap, SubmapScan};
use crate::geometry::Pose;
use std::ops::Range;

/// Merges one [`Resampled`] part into a target, any number of blocks at a time.
#[derive(Debug)]
pub struct Merge {
    resampled: Resampled,
    settings: FusionSettings,
    done: usize,
}

impl Merge {
    /// A merge of which no block is done.
    pub fn new(resampled: Resampled, settings: FusionSettings) -> Self {
        Self { resampled, settings, done: 0 }
    }

    /// Number of blocks and octants that are not merged yet.
    pub fn remaining(&self) -> usize {
        self.resampled.len() - self.done
    }

    /// Merges the next `blocks` blocks and octants into `target`, which has to be the same in every call; returns whether all are merged.
    pub fn step(&mut self, target: &mut Submap, blocks: usize) -> bool {
        let end = self.done.saturating_add(blocks).min(self.resampled.len());
        let tsdf_len = self.resampled.tsdf.len();
        if self.done < tsdf_len {
            self.resampled.merge_surface(self.done..end.min(tsdf_len), &mut target.tsdf, &self.settings);
        }
        if end > tsdf_len {
            let range = self.done.max(tsdf_len) - tsdf_len..end - tsdf_len;
            self.resampled.merge_occupancy(range, &mut target.occupancy, &self.settings);
        }
        self.done = end;
        target.revision += 1;
        end == self.resampled.len()
    }
}

/// Fuses the fields and the scans of `source`, which lies at `t_target_source`, into `target`. Both have the same voxel size.
pub fn fuse(target: &mut Submap, source: &Submap, t_target_source: &Pose, settings: &FusionSettings) {
    fuse_from(0, target, source, t_target_source, settings);
}

/// Completes a fusion of which all parts before part `first` are merged. The two fields are independent, so both are merged at once.
pub(crate) fn fuse_from(first: usize, target: &mut Submap, source: &Submap, t_target_source: &Pose, settings: &FusionSettings) {
    let sampling = Sampling::new(source, t_target_source);
    let first_of_occupancy = sampling.surface_parts();
    let (tsdf, occupancy) = (&mut target.tsdf, &mut target.occupancy);
    rayon::join(
        || merge_parts(&sampling, first..first_of_occupancy, |part| part.merge_surface(0..part.tsdf.len(), tsdf, settings)),
        || merge_parts(&sampling, first.max(first_of_occupancy)..sampling.parts(), |part| part.merge_occupancy(0..part.len(), occupancy, settings)),
    );
    move_scans(target, source, t_target_source);
}

/// Samples `parts` and merges them in order. Merging takes one thread, so the others sample what comes next.
fn merge_parts(sampling: &Sampling<'_>, parts: Range<usize>, mut merge: impl FnMut(Resampled) + Send) {
    let at_once = 2 * rayon::current_num_threads();
    let mut sampled = Vec::new();
    for start in parts.clone().step_by(at_once) {
        let before = std::mem::take(&mut sampled);
        let sample = || sampling.parts_in(start..parts.end.min(start + at_once));
        ((), sampled) = rayon::join(|| before.into_iter().for_each(&mut merge), sample);
    }
    sampled.into_iter().for_each(merge);
}

/// Adds the scans of `source` to those of `target`.
pub(crate) fn move_scans(target: &mut Submap, source: &Submap, t_target_source: &Pose) {
    let moved = source.scans.iter().map(|s| SubmapScan { node: s.node, t_submap_lidar: t_target_source * s.t_submap_lidar });
    if !(target.corrected.is_empty() && source.corrected.is_empty()) {
        let as_integrated = target.scans.iter().skip(target.corrected.len()).map(|scan| scan.t_submap_lidar);
        target.corrected.extend(as_integrated.collect::<Vec<_>>());
        target.corrected.extend(source.corrected.iter().map(|pose| t_target_source * pose));
    }
    target.scans.extend(moved);
    target.revision += 1;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::Submap;
    use crate::atlas::fusion::add_votes;
    use crate::geometry::{Pose, Rigid};
    use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
    use crate::octree::block_key;

    /// A submap of a floor of 32 x 32 m at height `z`.
    fn floor(id: u32, t_map_submap: Pose, z: f32) -> Submap {
        let points: Vec<[f32; 3]> = (0..320 * 320).map(|i| [(i % 320) as f32 * 0.1 - 16.0, (i / 320) as f32 * 0.1 - 16.0, z]).collect();
        let normals = vec![[0.0, 0.0, 1.0]; points.len()];
        let identity = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };
        let returns = ReturnsView::of_points(&points, &normals, 0.003);
        let mut submap = Submap::new(id, 0.1, t_map_submap);
        TsdfIntegrator::new(TsdfSettings { voxel_size: 0.1, ..TsdfSettings::default() }).integrate(&mut submap.tsdf, &identity, &returns);
        submap
    }

    const SETTINGS: FusionSettings = FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };

    /// As [`floor`], with occupancy in two layers of blocks, 32 x 32 m, whose values differ from block to block.
    fn room(id: u32, t_map_submap: Pose, z: f32) -> Submap {
        let mut submap = floor(id, t_map_submap, z);
        let value = |block: i32, i: usize| ((block * 7 + i as i32 * (1 + block % 3)) % 90 - 60) as i8;
        let block = |i: i32| (block_key([i % 40 - 20, i / 40 % 40 - 20, i / 1600]), (0..512).map(|v| value(i, v)).collect());
        add_votes(&mut submap.occupancy, &(0..3200).map(block).collect::<Vec<_>>(), &SETTINGS);
        submap
    }

    #[test]
    fn a_fusion_can_be_continued_from_any_part() {
        let t_target_source = Pose::new(nalgebra::Vector3::new(3.0, -1.0, 0.05), nalgebra::Vector3::new(0.0, 0.0, 0.4));
        let (target, source) = (room(0, Pose::identity(), -2.0), room(1, t_target_source, -2.03));
        let image = |submap: &Submap| {
            let (field, occupancy) = (&submap.tsdf, &submap.occupancy);
            let surface: Vec<_> = field.ids_in_morton_order().into_iter().map(|id| (field.head(id), field.stored_voxels(id))).collect();
            let values: Vec<Vec<i8>> = occupancy.ids_in_morton_order().into_iter().map(|id| occupancy.values(occupancy.block(id)).to_vec()).collect();
            (surface, occupancy.octants_in_order(), values)
        };
        let mut expected = target.clone();
        fuse(&mut expected, &source, &t_target_source, &SETTINGS);
        assert!(image(&expected) != image(&target));
        let sampling = Sampling::new(&source, &t_target_source);
        let surface_parts = sampling.surface_parts();
        assert!(surface_parts > 2 && sampling.parts() > surface_parts + 2, "{surface_parts} of {} parts", sampling.parts());
        for first in 1..=sampling.parts() {
            let mut fused = target.clone();
            for number in 0..first {
                Merge::new(sampling.part(number), SETTINGS).step(&mut fused, usize::MAX);
            }
            fuse_from(first, &mut fused, &source, &t_target_source, &SETTINGS);
            assert!(image(&fused) == image(&expected), "continued from part {first}");
        }
    }
}
