//! The source of a fusion, sampled in the target's lattice part by part.

use super::alignment::Displacement;
use super::colour::ColourPatch;
use super::occupancy::{Cube, OccupancyPatch, OccupancySampling, target_cubes};
use super::placement::Placement;
use super::samples::tsdf_sampling::{TargetBlock, TsdfSampling, target_blocks};
use super::settings::FusionSettings;
use super::tsdf::TsdfPatch;
use crate::atlas::Submap;
use crate::field::occupancy::OccupancyField;
use crate::field::tsdf::TsdfField;
use crate::geometry::Pose;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// TSDF blocks per part.
const BLOCKS_PER_PART: usize = 256;

/// What of a target's lattice a source reaches. It holds no reference to the source, so that several threads can sample by one plan.
#[derive(Clone, Debug)]
pub struct SamplingPlan {
    placement: Placement,
    blocks: Arc<[TargetBlock]>,
    cubes: Arc<[Cube]>,
}

impl SamplingPlan {
    /// Finds what `source` reaches in a submap of the same voxel size in which it lies at `t_target_source`. Runs in parallel; the result
    /// does not depend on the number of threads.
    pub fn new(source: &Submap, t_target_source: &Pose) -> Self {
        let placement = Placement::new(t_target_source, source.voxel_size);
        let (blocks, cubes) = (target_blocks(&source.tsdf, &placement), target_cubes(&source.occupancy, &placement));
        Self { placement, blocks, cubes }
    }

    /// The sampling of `source`, which must be the submap that the plan was made for.
    pub fn of<'a>(&self, source: &'a Submap) -> Sampling<'a> {
        let tsdf = TsdfSampling::new(&source.tsdf, &self.placement, Arc::clone(&self.blocks));
        let occupancy = OccupancySampling::new(&source.occupancy, &self.placement, Arc::clone(&self.cubes));
        Sampling { source, placement: self.placement, tsdf, occupancy }
    }
}

/// A submap to be sampled in the lattice of another one. Parts are sampled one at a time, so that they need not all be in memory.
pub struct Sampling<'a> {
    source: &'a Submap,
    placement: Placement,
    tsdf: TsdfSampling<'a>,
    occupancy: OccupancySampling<'a>,
}

impl<'a> Sampling<'a> {
    /// A sampling of `source` by a plan of its own.
    pub fn new(source: &'a Submap, t_target_source: &Pose) -> Self {
        SamplingPlan::new(source, t_target_source).of(source)
    }

    /// Number of parts.
    pub fn parts(&self) -> usize {
        self.surface_parts() + self.occupancy.len()
    }

    /// Number of parts of the TSDF, which come before those of the occupancy.
    pub(super) fn surface_parts(&self) -> usize {
        self.tsdf.len().div_ceil(BLOCKS_PER_PART)
    }

    /// Samples part `number`.
    ///
    /// # Panics
    /// If `number` is not below [`parts`](Self::parts).
    pub fn part(&self, number: usize) -> Resampled {
        let start = number * BLOCKS_PER_PART;
        if start >= self.tsdf.len() {
            let occupancy = self.occupancy.part(number - self.surface_parts());
            return Resampled { occupancy, ..Resampled::default() };
        }
        let tsdf = self.tsdf.part(start..(start + BLOCKS_PER_PART).min(self.tsdf.len()));
        let colours = ColourPatch::sample(&self.source.tsdf, &self.placement, &Displacement::default(), &tsdf.keys_and_scales());
        Resampled { tsdf, colours, ..Resampled::default() }
    }

    /// Samples several parts in parallel.
    pub(crate) fn parts_in(&self, numbers: Range<usize>) -> Vec<Resampled> {
        numbers.into_par_iter().map(|number| self.part(number)).collect()
    }
}

/// Fields of a submap, or a part of them, in the lattice of another one.
#[derive(Debug, Default)]
pub struct Resampled {
    pub(super) tsdf: TsdfPatch,
    pub(super) colours: ColourPatch,
    pub(super) occupancy: OccupancyPatch,
}

impl Resampled {
    /// Number of blocks and octants.
    pub fn len(&self) -> usize {
        self.tsdf.len() + self.occupancy.len()
    }

    /// Whether there are no blocks and octants.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Adds TSDF blocks `range`, with their colours, to `target`.
    pub(super) fn merge_surface(&self, range: Range<usize>, target: &mut TsdfField, settings: &FusionSettings) {
        self.tsdf.merge(range.clone(), target, settings.weight_cap());
        self.colours.merge(range, target);
    }

    /// Adds blocks and octants `range` of the occupancy to `target`.
    pub(super) fn merge_occupancy(&self, range: Range<usize>, target: &mut OccupancyField, settings: &FusionSettings) {
        self.occupancy.merge(range, target, settings.log_odds_limits());
    }
}
