//! Submap fusion (paper Sec. IV-C): one submap becomes part of another.
//!
//! The paper moves every voxel of the source into the target. Scattering voxels forward leaves holes, so this works backward: for every
//! block of the target's lattice that the source reaches, the source is *sampled* at the centres of the target's voxels. That happens in
//! two steps. [`Sampling`] depends on the source and the transform alone, so it can run beside integration; its parts lie in the
//! target's lattice, and [`Merge`] adds them voxel by voxel, a few blocks at a time if integration must not wait:
//!
//! - TSDF: trilinear samples, weighted mean of the distances (what was seen at a coarser scale counts less), weights add up to the cap; colours of the
//!   nearest voxel;
//! - occupancy: log-odds add up and are clamped, unknown stays unknown, free space stays as coarse as it is.

mod colour;
mod corners;
mod doubts;
mod occupancy;
mod points;
mod seen;
mod tsdf;
mod window;

use super::{Atlas, Submap};
use crate::field::occupancy::steps;
use crate::field::tsdf::WEIGHT_ONE;
use crate::geometry::{Pose, Rigid};
use crate::settings::Settings;
use colour::ColourPatch;
use doubts::Doubts;
use occupancy::{OccupancyPatch, OccupancySampling};
use rayon::prelude::*;
use std::ops::Range;
use tsdf::{TsdfPatch, TsdfSampling};

/// Blocks of a TSDF that are sampled as one part.
const PART: usize = 512;

/// What fusion must know about the fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionSettings {
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
    /// Cap of a TSDF voxel's weight, observations.
    pub max_weight: f32,
    /// Least log-odds of an occupancy voxel.
    pub min_log_odds: f32,
    /// Largest log-odds of an occupancy voxel.
    pub max_log_odds: f32,
}

impl From<&Settings> for FusionSettings {
    fn from(settings: &Settings) -> Self {
        let occupancy = crate::integrate::OccupancySettings::default();
        Self { voxel: settings.voxel, max_weight: settings.max_weight, min_log_odds: occupancy.min, max_log_odds: occupancy.max }
    }
}

impl FusionSettings {
    fn log_odds_limits(&self) -> [i8; 2] {
        [steps(self.min_log_odds), steps(self.max_log_odds)]
    }

    fn weight_cap(&self) -> u16 {
        (self.max_weight * f32::from(WEIGHT_ONE)).clamp(1.0, f32::from(u16::MAX)) as u16
    }
}

/// A submap on its way into the lattice of another one: parts that are sampled one by one, so that they need not be there all at once.
pub struct Sampling<'a> {
    source: &'a Submap,
    placement: Placement,
    tsdf: TsdfSampling<'a>,
    occupancy: OccupancySampling<'a>,
}

impl<'a> Sampling<'a> {
    /// `source` as the voxels of a submap see it in which it lies at `t_target_source`. Parallel, as the parts may be; nothing depends on how.
    pub fn new(source: &'a Submap, t_target_source: &Pose, settings: &FusionSettings) -> Self {
        let placement = Placement::new(t_target_source, settings.voxel);
        let (tsdf, occupancy) = (TsdfSampling::new(&source.tsdf, &placement), OccupancySampling::new(&source.occupancy, &placement));
        Self { source, placement, tsdf, occupancy }
    }

    /// Its parts.
    pub fn parts(&self) -> usize {
        self.tsdf.len().div_ceil(PART) + self.occupancy.len()
    }

    /// Samples the part numbered `number`.
    ///
    /// # Panics
    /// When there is no such part.
    pub fn part(&self, number: usize) -> Resampled {
        let start = number * PART;
        if start >= self.tsdf.len() {
            let occupancy = self.occupancy.part(number - self.tsdf.len().div_ceil(PART));
            return Resampled { occupancy, ..Resampled::default() };
        }
        let tsdf = self.tsdf.part(start..(start + PART).min(self.tsdf.len()));
        let colours = ColourPatch::sample(&self.source.tsdf, &self.placement, &tsdf.places());
        Resampled { tsdf, colours, ..Resampled::default() }
    }

    fn several(&self, numbers: Range<usize>) -> Vec<Resampled> {
        numbers.into_par_iter().map(|number| self.part(number)).collect()
    }
}

/// A submap's fields, or a part of them, in the lattice of another one.
#[derive(Debug, Default)]
pub struct Resampled {
    tsdf: TsdfPatch,
    colours: ColourPatch,
    occupancy: OccupancyPatch,
}

impl Resampled {
    /// Blocks and octants to be merged.
    pub fn len(&self) -> usize {
        self.tsdf.len() + self.occupancy.len()
    }

    /// Whether there is nothing to merge.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A merge under way: which of the resampled blocks are in the target.
#[derive(Debug)]
pub struct Merge {
    resampled: Resampled,
    settings: FusionSettings,
    done: usize,
}

impl Merge {
    /// Nothing merged yet.
    pub fn new(resampled: Resampled, settings: FusionSettings) -> Self {
        Self { resampled, settings, done: 0 }
    }

    /// Blocks and octants that are not yet merged.
    pub fn left(&self) -> usize {
        self.resampled.len() - self.done
    }

    /// Merges the next `blocks` blocks into `target`, always the same one; returns whether all are merged now.
    pub fn step(&mut self, target: &mut Submap, blocks: usize) -> bool {
        let end = self.done.saturating_add(blocks).min(self.resampled.len());
        let border = self.resampled.tsdf.len();
        if self.done < border {
            let blocks = self.done..end.min(border);
            self.resampled.tsdf.merge(blocks.clone(), &mut target.tsdf, self.settings.weight_cap());
            self.resampled.colours.merge(blocks, &mut target.tsdf);
        }
        if end > border {
            let range = self.done.max(border) - border..end - border;
            self.resampled.occupancy.merge(range, &mut target.occupancy, self.settings.log_odds_limits());
        }
        self.done = end;
        target.revision += 1;
        end == self.resampled.len()
    }
}

/// Fuses the fields and the scans of `source`, which lies at `t_target_source`, into `target` at once.
pub fn fuse(target: &mut Submap, source: &Submap, t_target_source: &Pose, settings: &FusionSettings) {
    fuse_from(0, target, source, t_target_source, settings);
}

/// Does what is left of a fusion of which the parts before the one numbered `first` are merged.
pub(crate) fn fuse_from(first: usize, target: &mut Submap, source: &Submap, t_target_source: &Pose, settings: &FusionSettings) {
    let sampling = Sampling::new(source, t_target_source, settings);
    let (parts, at_once) = (sampling.parts(), 2 * rayon::current_num_threads());
    for start in (first..parts).step_by(at_once) {
        for part in sampling.several(start..parts.min(start + at_once)) {
            Merge::new(part, *settings).step(target, usize::MAX);
        }
    }
    move_scans(target, source, t_target_source);
}

/// Lets the submaps of `atlas` settle what one of them calls occupied because of a single `hit` (log-odds) and the others
/// together know to be free; returns how many finest voxels that freed.
pub fn settle_doubts(atlas: &mut Atlas, settings: &FusionSettings, hit: f32) -> usize {
    let doubts = Doubts::of(atlas, settings.voxel, steps(hit));
    let mut freed = 0;
    for (submap, doubts) in atlas.submaps_mut().iter_mut().zip(doubts) {
        let settled = doubts.settle(&mut submap.occupancy, settings.log_odds_limits());
        submap.revision += u64::from(settled > 0);
        freed += settled;
    }
    freed
}

/// Notes the scans of `source` as scans of `target`.
pub fn move_scans(target: &mut Submap, source: &Submap, t_target_source: &Pose) {
    let moved = source.scans.iter().map(|s| super::SubmapScan { node: s.node, t_submap_lidar: t_target_source * s.t_submap_lidar });
    target.scans.extend(moved);
    target.revision += 1;
}

/// Where the source lies in the target, both in finest voxels.
#[derive(Clone, Copy, Debug)]
struct Placement {
    t_target_source: Rigid,
    t_source_target: Rigid,
}

impl Placement {
    fn new(t_target_source: &Pose, voxel: f32) -> Self {
        let in_voxels = |pose: &Pose| {
            let mut pose = *pose;
            pose.translation.vector /= f64::from(voxel);
            Rigid::from(&pose)
        };
        Self { t_target_source: in_voxels(t_target_source), t_source_target: in_voxels(&t_target_source.inverse()) }
    }

    /// The axis-aligned box around a cube of the source, in the target: centre and half extents.
    fn box_in_target(&self, centre: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
        turned_box(&self.t_target_source, centre, half)
    }

    /// The axis-aligned box around a cube of the target, in the source: centre and half extents.
    fn box_in_source(&self, centre: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
        turned_box(&self.t_source_target, centre, half)
    }
}

fn turned_box(t: &Rigid, centre: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
    (t.apply(centre), std::array::from_fn(|i| t.rotation[i].iter().map(|r| r.abs()).sum::<f32>() * half))
}

/// The largest whole number that is not above `x`. What the library has is a call where the processor may lack the instruction.
#[inline(always)]
fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole - i32::from(whole as f32 > x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::{Returns, TsdfIntegrator, TsdfSettings};

    /// A submap of a floor of 32 x 32 m at height `z`.
    fn floor(id: u32, t_map_submap: Pose, z: f32) -> Submap {
        let points: Vec<[f32; 3]> = (0..320 * 320).map(|i| [(i % 320) as f32 * 0.1 - 16.0, (i / 320) as f32 * 0.1 - 16.0, z]).collect();
        let normals = vec![[0.0, 0.0, 1.0]; points.len()];
        let still = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };
        let returns = Returns { points: &points, normals: &normals, shades: &[], origins: &[], smallest_angle: 0.003 };
        let mut submap = Submap::new(id, t_map_submap);
        TsdfIntegrator::new(TsdfSettings { voxel: 0.1, ..TsdfSettings::default() }).integrate(&mut submap.tsdf, &still, &returns);
        submap
    }

    #[test]
    fn a_fusion_goes_on_from_any_of_its_parts() {
        let t_target_source = Pose::new(nalgebra::Vector3::new(3.0, -1.0, 0.05), nalgebra::Vector3::new(0.0, 0.0, 0.4));
        let (target, source) = (floor(0, Pose::identity(), -2.0), floor(1, t_target_source, -2.03));
        let settings = FusionSettings { voxel: 0.1, max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };
        let image = |submap: &Submap| -> Vec<_> {
            let field = &submap.tsdf;
            field.ids_in_morton_order().into_iter().map(|id| (field.head(id), field.stored_voxels(id).flatten().collect::<Vec<_>>())).collect()
        };
        let mut expected = target.clone();
        fuse(&mut expected, &source, &t_target_source, &settings);
        assert!(image(&expected) != image(&target));
        let sampling = Sampling::new(&source, &t_target_source, &settings);
        assert!(sampling.parts() > 2, "{} parts", sampling.parts());
        for first in 1..=sampling.parts() {
            let mut fused = target.clone();
            for number in 0..first {
                Merge::new(sampling.part(number), settings).step(&mut fused, usize::MAX);
            }
            fuse_from(first, &mut fused, &source, &t_target_source, &settings);
            assert!(image(&fused) == image(&expected), "on from part {first}");
        }
    }
}
