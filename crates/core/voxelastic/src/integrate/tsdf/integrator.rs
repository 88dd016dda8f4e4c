//! MultiresTSDF integration (paper Sec. III-A, III-B): walk each ray through its truncation band, from the measured point.
//!
//! A scan goes through four phases: *transform* the returns into rays of the submap, *select* the blocks that the rays' bands pass, *allocate* missing blocks
//! (in bulk, in Morton order) and choose each block's scale, and *update* the voxels of each block from its rays in ray order ([`update`](super::update)). Blocks
//! are updated independently of each other, so results do not depend on the number of threads.

use super::block_run::{ALL_OCTANTS, BlockRun, ScaleChange};
use super::redundancy::Redundancy;
use super::settings::TsdfSettings;
use super::truncation::TruncationBand;
use super::update::{LaneBuffers, UpdateContext, UpdateTask};
use crate::field::tsdf::{TsdfField, WEIGHT_ONE};
use crate::geometry::Rigid;
use crate::integrate::rays::ray::Ray;
use crate::integrate::rays::returns::ReturnsView;
use crate::integrate::rays::scale::{ScaleRule, distance_to_block};
use crate::integrate::rays::select::{BlockRays, MAX_RAYS, MAX_REACH, Selection, ray_of};
use crate::integrate::rays::transform::{RayFrame, SurfaceRayParams, SurfaceRays, build_rays};
use crate::octree::{BLOCK_EDGE, Cursor, NONE, block_coords, prefetch_item};
use crate::simd::dispatch;
use rayon::prelude::*;
use std::cell::RefCell;
use std::time::{Duration, Instant};

/// Least sine of the angle between a ray and its local plane. On the simulated campus 90 % of the surface is mapped without this limit and 95 % with 0.3 to
/// 0.5; with more, neighbouring rays leave gaps between them.
const LEAST_SLOPE: f32 = 0.4;

/// How much farther in front of the surface existing voxels are updated than new ones are created, voxels. Farther voxels may belong to another surface.
const ERODE_MARGIN: f32 = 0.5;

/// Weight of a scattered return: there are fewer of them than of a dense scan, and a surface that few saw must not count as small components.
const SCATTERED_WEIGHT: u8 = 4;

thread_local! {
    /// Scratch memory of a thread, kept from scan to scan.
    static LANE_BUFFERS: RefCell<Box<LaneBuffers>> = RefCell::new(Box::new(LaneBuffers::new()));
}

/// Time spent in each phase of one integration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TsdfPhases {
    /// Returns transformed into rays; with both fields this includes the rays of occupancy.
    pub transform: Duration,
    /// Blocks selected and grouped.
    pub select: Duration,
    /// Octants and blocks created, scales chosen.
    pub allocate: Duration,
    /// Bricks decompressed or created and voxels updated, including propagation between scales and compaction.
    pub update: Duration,
}

/// What one integration did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct TsdfStats {
    /// Rays walked, after bundling.
    pub rays: usize,
    /// Blocks updated.
    pub blocks: usize,
    /// Blocks created.
    pub new_blocks: usize,
    /// Blocks whose scale changed.
    pub scale_changes: usize,
    /// Time spent in each phase.
    pub phases: TsdfPhases,
}

/// Integrates scans into [`TsdfField`]s. Holds scratch memory, so one integrator should serve all scans.
#[derive(Clone, Debug)]
pub struct TsdfIntegrator {
    settings: TsdfSettings,
    rays: Vec<Ray>,
    selection: Selection,
    runs: Vec<BlockRun>,
}

impl TsdfIntegrator {
    /// An integrator with the given settings.
    pub fn new(settings: TsdfSettings) -> Self {
        Self { settings, rays: Vec::new(), selection: Selection::default(), runs: Vec::new() }
    }

    /// The settings.
    pub fn settings(&self) -> &TsdfSettings {
        &self.settings
    }

    /// The rule that chooses integration scales for beams `smallest_angle` radians apart.
    pub fn scale_rule(&self, smallest_angle: f32) -> ScaleRule {
        ScaleRule::new(smallest_angle, self.settings.voxel_size, self.settings.max_scale, self.settings.scale_hysteresis)
    }

    /// Integrates the returns of one scan taken at `t_submap_lidar`. Returns beyond the maximum range, and those after the first 2^24, are skipped.
    pub fn integrate(&mut self, field: &mut TsdfField, t_submap_lidar: &Rigid, returns: &ReturnsView<'_>) -> TsdfStats {
        let clock = Instant::now();
        let returns = returns.first(MAX_RAYS);
        let frame = self.frame(t_submap_lidar);
        build_rays(&returns, &frame, Some(self.rays_to_build(returns.smallest_angle)), None);
        let transform = clock.elapsed();
        let stats = self.update_from_rays(field, t_submap_lidar, &returns, &Redundancy::default());
        TsdfStats { phases: TsdfPhases { transform, ..stats.phases }, ..stats }
    }

    /// What makes rays of the returns of a scan taken at `t_submap_lidar`.
    pub(crate) fn frame(&self, t_submap_lidar: &Rigid) -> RayFrame {
        RayFrame { t_submap_lidar: *t_submap_lidar, voxel: self.settings.voxel_size, max_range: self.settings.max_range }
    }

    /// The rays of the next scan, to be filled by [`build_rays`].
    pub(crate) fn rays_to_build(&mut self, smallest_angle: f32) -> SurfaceRays<'_> {
        let params = SurfaceRayParams {
            rule: self.scale_rule(smallest_angle),
            least_slope: LEAST_SLOPE,
            band: [self.settings.truncation_front + ERODE_MARGIN, self.settings.truncation_behind],
            max_reach: self.settings.truncation_voxels,
            bundle_width: self.settings.bundle_width,
        };
        SurfaceRays { params, rays: &mut self.rays }
    }

    /// Updates the field from the rays that were built last, of `returns`; skips rays that are redundant.
    pub(crate) fn update_from_rays(
        &mut self,
        field: &mut TsdfField,
        t_submap_lidar: &Rigid,
        returns: &ReturnsView<'_>,
        redundancy: &Redundancy<'_>,
    ) -> TsdfStats {
        let rule = self.scale_rule(returns.smallest_angle);
        let reach = self.reach().min(MAX_REACH);
        if !returns.spacing.is_empty() {
            self.rays.iter_mut().for_each(|ray| ray.count = ray.count.saturating_mul(SCATTERED_WEIGHT));
        }
        let clock = Instant::now();
        let position = t_submap_lidar.translation;
        self.selection.select(&self.rays, position.map(|c| c / self.settings.voxel_size), reach);
        let selected = Instant::now();

        let new_blocks = self.allocate(field, &rule, position, returns, redundancy);
        let allocated = Instant::now();

        let changes: Vec<u32> = self.runs.iter().filter(|r| r.change != ScaleChange::None).map(|r| r.block).collect();
        let ids: Vec<u32> = self.runs.iter().map(|run| run.block).collect();
        self.update(field, &ids);
        changes.iter().for_each(|&id| field.release_coarser(id));
        field.record_changes(ids);
        let updated = Instant::now();

        TsdfStats {
            rays: self.rays.len(),
            blocks: self.runs.len(),
            new_blocks,
            scale_changes: changes.len(),
            phases: TsdfPhases { transform: Duration::ZERO, select: selected - clock, allocate: allocated - selected, update: updated - allocated },
        }
    }

    /// Blocks from the sensor to the farthest voxel that a ray can update.
    fn reach(&self) -> u32 {
        let band = self.settings.truncation_voxels * (1 << self.settings.max_scale) as f32;
        ((self.settings.max_range / self.settings.voxel_size + band) / BLOCK_EDGE as f32).ceil() as u32 + 2
    }

    /// Finds or creates every selected block and moves it towards the scale that fits; returns how many are new.
    fn allocate(
        &mut self,
        field: &mut TsdfField,
        rule: &ScaleRule,
        sensor: [f32; 3],
        returns: &ReturnsView<'_>,
        redundancy: &Redundancy<'_>,
    ) -> usize {
        let (block_edge, has_intensity) = (BLOCK_EDGE as f32 * self.settings.voxel_size, !returns.intensities.is_empty());
        field.tree.grow_over(self.selection.blocks.iter().map(|run| run.key));
        // Rays with a spacing of their own have scales of their own, which decide on those of blocks; else the distance to the sensor does.
        let scales = if !returns.spacing.is_empty() {
            // The mean of the rays' scales, rounded.
            let scale_of = |run: &BlockRays| {
                let all = &self.selection.records[run.start as usize..run.end as usize];
                let sum: usize = all.iter().map(|&record| self.rays[ray_of(record)].scale as usize).sum();
                (2 * sum + all.len()) / (2 * all.len()).max(1)
            };
            let distances: Vec<f32> = self.selection.blocks.iter().map(|run| rule.start(scale_of(run))).collect();
            self.find(field, rule, redundancy, |i, _| distances[i])
        } else {
            self.find(field, rule, redundancy, |_, coords| distance_to_block(coords, block_edge, sensor))
        };
        let mut cursor = Cursor::new(&field.tree);
        let mut new_blocks = 0;
        for ((run, &BlockRays { key, .. }), scale) in self.runs.iter_mut().zip(&self.selection.blocks).zip(scales) {
            match run.change {
                _ if run.start == run.end => {}
                _ if run.block == NONE => {
                    run.block = field.find_or_create(&mut cursor, key, scale, has_intensity).0;
                    new_blocks += 1;
                }
                ScaleChange::None => {}
                ScaleChange::Coarser => field.go_coarser(run.block),
                ScaleChange::Finer | ScaleChange::FinerNew => field.go_finer(run.block),
            }
        }
        self.runs.retain(|run| run.start < run.end);
        new_blocks
    }

    /// Finds the selected blocks that exist, in parallel, and decides on their scale changes; returns the scale that fits each block. Runs are left without rays
    /// where nothing is to be done: no ray creates voxels in a missing block, or all rays are redundant.
    fn find(
        &mut self,
        field: &TsdfField,
        rule: &ScaleRule,
        redundancy: &Redundancy<'_>,
        distance: impl Fn(usize, [i32; 3]) -> f32 + Sync,
    ) -> Vec<u8> {
        /// Few enough for an even load on all threads, many enough that a cursor seldom starts at the root.
        const BLOCKS_PER_TASK: usize = 1024;
        let Self { selection: Selection { blocks, records, .. }, rays, runs, settings, .. } = self;
        let mut scales = vec![0; blocks.len()];
        runs.clear();
        runs.resize(blocks.len(), BlockRun { block: NONE, start: 0, end: 0, change: ScaleChange::None, octant_mask: ALL_OCTANTS });
        let tasks = (runs.par_chunks_mut(BLOCKS_PER_TASK), scales.par_chunks_mut(BLOCKS_PER_TASK), blocks.par_chunks(BLOCKS_PER_TASK));
        tasks.into_par_iter().enumerate().for_each(|(task, (runs, scales, blocks))| {
            let (mut cursor, mut others) = (Cursor::new(&field.tree), redundancy.other_fields(settings.voxel_size));
            // Blocks are prefetched long before they are read: few of them are in a cache.
            for (run, &BlockRays { key, start, end }) in runs.iter_mut().zip(blocks) {
                let block = cursor.block(&field.tree, key);
                *run = BlockRun { block: block.unwrap_or(NONE), start, end, ..*run };
                if let Some(id) = block {
                    prefetch_item(&raw const field.blocks[id]);
                }
            }
            for (((run, scale), &BlockRays { key, start, end }), i) in runs.iter_mut().zip(scales).zip(blocks).zip(task * BLOCKS_PER_TASK..) {
                let coords = block_coords(key);
                let distance = distance(i, coords);
                *scale = rule.fitting(distance) as u8;
                let corner = coords.map(|c| (c * BLOCK_EDGE as i32) as f32);
                let own_rays = records[start as usize..end as usize].iter().map(|&record| &rays[ray_of(record)]);
                let block = (run.block != NONE).then(|| &field.blocks[run.block]);
                if let Some(block) = block {
                    run.change = ScaleChange::of(block, rule, distance);
                }
                run.octant_mask = match block {
                    // A view from nearer than ever before is not redundant.
                    _ if run.change.is_finer() => ALL_OCTANTS,
                    Some(block) if block.observation_count.get() > 0 => redundancy.new_octants(field, run.block, corner, own_rays.clone()),
                    _ => others.new_octants(corner, own_rays.clone()),
                };
                if run.octant_mask != ALL_OCTANTS {
                    run.change = ScaleChange::None;
                } else if block.is_some() {
                    continue;
                }
                let creates_voxels = |ray: &Ray| block.is_some() || ray.creates_voxels_in(corner, *scale, settings.truncation_front);
                let has_updates = own_rays.into_iter().any(|ray| run.takes(ray.point, corner) && creates_voxels(ray));
                if !has_updates {
                    run.end = start;
                }
            }
        });
        scales
    }

    /// Updates the voxels of all runs; `ids` are their blocks.
    fn update(&self, field: &mut TsdfField, ids: &[u32]) {
        /// Few enough for an even load on all threads, many enough that the tasks' overhead does not count.
        const RUNS_PER_TASK: usize = 64;
        let context = UpdateContext {
            rays: &self.rays,
            records: &self.selection.records,
            band: TruncationBand {
                front: self.settings.truncation_voxels,
                create_front: self.settings.truncation_front,
                back: self.settings.truncation_behind,
                fade: 1.0 / (self.settings.truncation_behind - 1.0).max(0.5),
                weight: f32::from(WEIGHT_ONE),
                max_weight: (self.settings.max_weight * f32::from(WEIGHT_ONE)).min(f32::from(u16::MAX)),
            },
        };
        field.write_blocks(ids, RUNS_PER_TASK, |range, writer| {
            LANE_BUFFERS.with_borrow_mut(|buffers| dispatch(UpdateTask { runs: &self.runs[range], context: &context, writer, buffers }));
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::Voxel;
    use crate::field::{BlockHead, TsdfBuilder};
    use proptest::prelude::*;

    /// All contents of a field.
    fn contents(field: &TsdfField) -> Vec<(BlockHead, Vec<Voxel>, Vec<u8>)> {
        let of = |id| (field.head(id), field.stored_voxels(id), field.stored_intensities(id));
        field.ids_in_morton_order().into_iter().map(of).collect()
    }

    /// The octants of a block that have observed voxels, computed voxel by voxel.
    fn observed_octants(field: &TsdfField, id: u32) -> u8 {
        let block = field.block(id);
        let (scale, edge) = (usize::from(block.scale), 1 << block.scale);
        let mut octants = 0;
        for (i, _) in field.current(block).iter().enumerate().filter(|(_, voxel)| voxel.is_observed()) {
            let low = crate::octree::voxel_coords(i, scale).map(|c| c * edge);
            // Every finest voxel in it: the coarsest voxel covers all octants.
            for finest in 0..edge.pow(3) {
                let at = [finest % edge, finest / edge % edge, finest / edge / edge];
                octants |= 1 << (0..3).fold(0, |octant, k| octant | ((low[k] + at[k]) / 4) << k);
            }
        }
        octants
    }

    /// Scans of points around the origin, from near and far positions, so that blocks change their scales both ways.
    fn scans() -> impl Strategy<Value = Vec<([f32; 3], Vec<[f32; 3]>)>> {
        let position = prop::array::uniform3(-20f32..20.0);
        let points = prop::collection::vec(prop::array::uniform3(-3f32..3.0), 1..60);
        prop::collection::vec((position, points), 1..8)
    }

    proptest! {
        #[test]
        fn a_field_compacted_after_every_scan_holds_the_same_bits(scans in scans(), has_intensity in any::<bool>(), hands_pages_on in any::<bool>()) {
            let mut integrator = TsdfIntegrator::new(TsdfSettings { voxel_size: 0.1, ..TsdfSettings::default() });
            let (mut hot, mut cold) = (TsdfField::default(), TsdfField::default());
            for (i, (position, points)) in scans.iter().enumerate() {
                let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
                let t_submap_lidar = Rigid { rotation, translation: *position };
                let points: Vec<[f32; 3]> = points.iter().map(|p| std::array::from_fn(|k| p[k] - position[k])).collect();
                let normals = vec![[0.0; 3]; points.len()];
                let intensities: Vec<u8> = (0..points.len()).map(|p| (1 + (7 * p + i) % 255) as u8).collect();
                let intensities = if has_intensity { &intensities[..] } else { &[] };
                let returns = ReturnsView { intensities, ..ReturnsView::of_points(&points, &normals, 0.01) };
                integrator.integrate(&mut hot, &t_submap_lidar, &returns);
                integrator.integrate(&mut cold, &t_submap_lidar, &returns);
                if hands_pages_on {
                    let mut pages = Vec::new();
                    cold.compact_from_end(40, &mut pages);
                    cold.adopt_pages(pages);
                } else {
                    cold.compact_all();
                }
                for field in [&hot, &cold] {
                    field.assert_invariants();
                    for id in field.ids() {
                        prop_assert_eq!(field.observed_octants(field.block(id)), observed_octants(field, id));
                    }
                }
            }
            let expected = contents(&hot);
            prop_assert_eq!(&contents(&cold), &expected);
            let mut builder = TsdfBuilder::default();
            expected.iter().for_each(|(head, voxels, intensities)| builder.push(*head, voxels, intensities).unwrap());
            let built = builder.finish();
            built.assert_invariants();
            prop_assert_eq!(contents(&built), expected);
        }
    }
}
