//! The integrator: one scan into one occupancy field.
//!
//! A scan goes through six phases: *see* builds the range pyramid, *descend* finds free space, *select* finds the blocks that rays pass near their returns,
//! *allocate* creates and refines blocks, *update* updates the voxels of each block, in parallel, and *propagate* frees the robot's own space, brings maxima and
//! "observed" up to the root and merges equal siblings into their parent.

use super::allocate::BlockTasks;
use super::apply::BlockOutcome;
use super::classify::Classifier;
use super::descend::{Descent, DescentScratch};
use super::evidence::{Evidence, Steps};
use super::free_cells::FreeCells;
use super::own_space::{OwnSpace, free_own_space};
use super::range_pyramid::RangePyramid;
use super::settings::{MAX_ROBOT_RADIUS_VOXELS, OccupancySettings};
use super::update_blocks::{UpdateContext, UpdateTask, write_outcomes};
use crate::field::occupancy::OccupancyField;
use crate::field::occupancy::propagate::ChangedOctants;
use crate::geometry::Rigid;
use crate::integrate::SubmapScan;
use crate::integrate::rays::ray::Ray;
use crate::integrate::rays::returns::ReturnsView;
use crate::integrate::rays::scale::ScaleRule;
use crate::integrate::rays::select::{MAX_RAYS, MAX_REACH, Selection};
use crate::integrate::rays::transform::{MeasuredRays, RayFrame, build_rays};
use crate::octree::{BLOCK_EDGE, SCALES, block_key};
use crate::sensor::{BeamModel, RangeImage};
use crate::simd::dispatch;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Time spent in each phase of one integration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OccupancyPhases {
    /// Range pyramid built, and returns transformed into rays unless the TSDF did that.
    pub see: Duration,
    /// The descent for free space.
    pub descend: Duration,
    /// Blocks selected and grouped.
    pub select: Duration,
    /// Octants and blocks created.
    pub allocate: Duration,
    /// Voxels updated.
    pub update: Duration,
    /// Summaries propagated to the root, equal siblings merged.
    pub propagate: Duration,
}

/// What one integration did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct OccupancyStats {
    /// Rays walked.
    pub rays: usize,
    /// Cubes classified on the range pyramid.
    pub visited: usize,
    /// Uniform octants found free.
    pub free_octants: usize,
    /// Blocks updated.
    pub blocks: usize,
    /// Time spent in each phase.
    pub phases: OccupancyPhases,
}

/// Integrates scans into [`OccupancyField`]s. Holds scratch memory, so one integrator should serve all scans.
#[derive(Clone, Debug)]
pub struct OccupancyIntegrator {
    settings: OccupancySettings,
    pyramid: RangePyramid,
    rays: Vec<Ray>,
    selection: Selection,
    tasks: BlockTasks,
    scratches: Vec<Box<DescentScratch>>,
    free: FreeCells,
    outcomes: Vec<BlockOutcome>,
    /// The ids of the blocks of `tasks`, in the same order.
    blocks: Vec<u32>,
}

/// Whether the rays of a scan are in the integrator already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rays {
    Built,
    /// They are to be made of the returns.
    ToBuild,
}

/// Blocks are never made coarser: detail once observed is kept.
const HYSTERESIS: f32 = f32::INFINITY;

impl OccupancyIntegrator {
    /// An integrator for scans of `model`.
    pub fn new(settings: OccupancySettings, model: &BeamModel) -> Self {
        Self {
            settings,
            pyramid: RangePyramid::new(model),
            rays: Vec::new(),
            selection: Selection::default(),
            tasks: BlockTasks::default(),
            scratches: Vec::new(),
            free: FreeCells::default(),
            outcomes: Vec::new(),
            blocks: Vec::new(),
        }
    }

    /// Integrates one scan taken at `t_submap_lidar`: free space from its image, surfaces from its returns. `fill` says that the points were no grid, so that
    /// single empty pixels between returns are artefacts of projection. Returns after the first 2^24 are skipped.
    pub fn integrate(
        &mut self,
        field: &mut OccupancyField,
        t_submap_lidar: &Rigid,
        image: &RangeImage,
        returns: &ReturnsView<'_>,
        fill: bool,
    ) -> OccupancyStats {
        let scan = SubmapScan { t_submap_lidar: *t_submap_lidar, returns: *returns, colours: &[], image, fills_gaps: fill };
        self.update(field, &scan, Rays::ToBuild)
    }

    /// The rays of the next scan, to be filled by [`build_rays`].
    pub(crate) fn rays_to_build(&mut self, smallest_angle: f32) -> MeasuredRays<'_> {
        MeasuredRays { rule: self.scale_rule(smallest_angle), rays: &mut self.rays }
    }

    fn scale_rule(&self, smallest_angle: f32) -> ScaleRule {
        ScaleRule::new(smallest_angle, self.settings.voxel_size, SCALES - 1, HYSTERESIS)
    }

    /// Updates the field from a scan.
    pub(crate) fn update(&mut self, field: &mut OccupancyField, scan: &SubmapScan<'_>, made: Rays) -> OccupancyStats {
        let steps = Steps::new(&self.settings);
        let reach = self.cover(field, scan.t_submap_lidar.translation);
        let (see, descend, select) = self.find_cells(field, scan, made, &steps, reach);

        let selected = Instant::now();
        let mut changed = self.tasks.allocate(field, &self.free, &self.selection.blocks, &steps);
        let allocated = Instant::now();

        self.update_voxels(field, &steps);
        let updated = Instant::now();

        write_outcomes(field, &self.tasks.list, &self.outcomes, &mut changed);
        self.free_own_space(field, &scan.t_submap_lidar, &steps, &mut changed);
        changed.propagate(field);
        let done = Instant::now();

        OccupancyStats {
            rays: self.rays.len(),
            visited: self.free.buffers.iter().map(|buffer| buffer.visited).sum(),
            free_octants: self.free.buffers.iter().map(|buffer| buffer.octants).sum(),
            blocks: self.tasks.list.len(),
            phases: OccupancyPhases { see, descend, select, allocate: allocated - selected, update: updated - allocated, propagate: done - updated },
        }
    }

    /// Frees the robot's own space around the sensor. After the scan, so that nothing is freed that it saw occupied.
    fn free_own_space(&self, field: &mut OccupancyField, t_submap_lidar: &Rigid, steps: &Steps, changed: &mut ChangedOctants) {
        let OccupancySettings { voxel_size, max_range, robot_radius, robot_height, .. } = self.settings;
        let radius = (robot_radius.min(max_range) / voxel_size).min(MAX_ROBOT_RADIUS_VOXELS);
        if radius > 0.0 {
            let sensor = t_submap_lidar.translation.map(|c| c / voxel_size);
            let own = OwnSpace { sensor, axis: t_submap_lidar.rotation.map(|row| row[2]), radius, height: robot_height / voxel_size };
            free_own_space(field, &own, steps, changed);
        }
    }

    /// Grows the root over everything within reach of the sensor; returns the reach in blocks.
    fn cover(&self, field: &mut OccupancyField, sensor: [f32; 3]) -> u32 {
        let edge = BLOCK_EDGE as f32 * self.settings.voxel_size;
        // A ray at the coarsest scale is walked this far beyond its return, metres.
        let beyond = self.settings.thickness_voxels.max(3.0) * (1 << (SCALES - 1)) as f32 * self.settings.voxel_size;
        let reach = (((self.settings.max_range + beyond) / edge).ceil() as u32 + 2).min(MAX_REACH);
        let centre = sensor.map(|c| (c / edge).floor() as i32);
        field.tree.grow_to(block_key(centre.map(|c| c - reach as i32)));
        field.tree.grow_to(block_key(centre.map(|c| c + reach as i32)));
        reach
    }

    /// Finds free space and the blocks of the rays, side by side, because both have parts that do not use all threads. Returns the durations of the phases
    /// *see*, *descend* and *select*.
    fn find_cells(&mut self, field: &OccupancyField, scan: &SubmapScan<'_>, made: Rays, steps: &Steps, reach: u32) -> (Duration, Duration, Duration) {
        let rule = self.scale_rule(scan.returns.smallest_angle);
        let Self { settings, pyramid, selection, rays, tasks, scratches, free, .. } = self;
        let settings: &OccupancySettings = settings;
        let descend = || {
            let ((), see) = timed(|| pyramid.build(scan.image, settings.max_range, settings.clear_no_return, scan.fills_gaps));
            let classifier = Classifier::new(pyramid, settings, &scan.t_submap_lidar);
            let ((), descend) = timed(|| Descent { field, classifier, settings, steps: *steps }.run(scratches, free));
            (see, descend)
        };
        let select = || {
            /// Fewer rays are processed by one thread.
            const RAYS_PER_TASK: usize = 4096;
            let OccupancySettings { voxel_size: voxel, max_range, .. } = *settings;
            let ((), see) = timed(|| {
                if made == Rays::ToBuild {
                    let frame = RayFrame { t_submap_lidar: scan.t_submap_lidar, voxel, max_range };
                    build_rays(&scan.returns.first(MAX_RAYS), &frame, None, Some(MeasuredRays { rule, rays: &mut *rays }));
                }
                rays.par_iter_mut().with_min_len(RAYS_PER_TASK).for_each(|ray| {
                    let (before, behind) = Evidence::new(settings, ray.range * voxel, ray.scale as usize).reach();
                    ray.reach = [-before, behind];
                });
            });
            let ((), select) = timed(|| {
                let position = scan.t_submap_lidar.translation;
                selection.select(rays, position.map(|c| c / voxel), reach);
                tasks.look_up(field, &selection.blocks, &rule, voxel, position);
            });
            (see, select)
        };
        let ((see, descend), (transform, select)) = rayon::join(descend, select);
        (see + transform, descend, select)
    }

    /// Updates the voxels of all blocks.
    fn update_voxels(&mut self, field: &mut OccupancyField, steps: &Steps) {
        const BLOCKS_PER_TASK: usize = 64;
        let Self { settings, rays, selection, tasks, free, outcomes, blocks, .. } = self;
        let context = UpdateContext { rays, records: &selection.records, free, settings, steps };
        outcomes.clear();
        outcomes.resize(tasks.list.len(), BlockOutcome::default());
        blocks.clear();
        blocks.extend(tasks.list.iter().map(|task| task.block));
        let parts = tasks.list.par_chunks(BLOCKS_PER_TASK).zip(outcomes.par_chunks_mut(BLOCKS_PER_TASK));
        field.write_blocks(blocks, BLOCKS_PER_TASK, parts, |writer, (blocks, outcomes)| {
            dispatch(UpdateTask { blocks, writer, outcomes, context: &context })
        });
    }
}

/// The result of `work` and its duration.
fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    (work(), start.elapsed())
}
