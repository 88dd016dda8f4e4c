//! MultiresTSDF integration (paper Sec. III-A, III-B): walk each beam through its truncation band, from the true point.
//!
//! A scan goes through five phases: *transform* the beams into the submap, *select* the blocks that their bands touch,
//! *allocate* the blocks that are missing (in bulk, in Morton order, choosing each block's scale), *update* each block's voxels
//! from its beams in beam order (`formation.rs`), and *release* what scale changes left over. Blocks are
//! independent in the update, so threads share nothing and change nothing but the time.

use super::band::Band;
use super::formation::{Formations, Run, Share, Update, octant_bit};
use super::known::Known;
use super::rescale::{Change, scale_change};
use super::scale::{ScaleRule, distance_to_block};
use super::select::{BlockBeams, MAX_BEAMS, MAX_REACH, Selection, beam_of};
use super::transform::{Beam, Returns, ToSubmap, to_submap};
use crate::dispatch::dispatch;
use crate::field::tsdf::{Touched, TsdfField, WEIGHT_ONE};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, SCALES, ask_for_all, block_coords};
use rayon::prelude::*;
use std::cell::RefCell;
use std::time::{Duration, Instant};

/// Least sine of the angle at which a walk leaves its local plane. On the campus 90 % of the surface is there without it, 95 % with
/// 0.3 to 0.5; beyond that walks beside each other no longer touch.
const LEAST_SLOPE: f32 = 0.4;

thread_local! {
    /// What a thread updates blocks with, from scan to scan.
    static FORMATIONS: RefCell<Box<Formations>> = RefCell::new(Box::new(Formations::new()));
}

/// How much farther in front of the surface than voxels are made they are worn away, voxels: what is farther may be a thing of its own.
const WORN: f32 = 0.5;

/// How scans update a TSDF.
#[derive(Clone, Debug, PartialEq)]
pub struct TsdfSettings {
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
    /// Largest range that is integrated, metres.
    pub max_range: f32,
    /// How far along a beam the truncation band reaches before its point and beyond, in voxels of the integration scale, 1 to 8.
    pub truncation_voxels: f32,
    /// How far in front of the surface voxels are made, in the same voxels, 1.5 to 8. Half a voxel farther, what a beam went through is worn away:
    /// there voxels, which no mesh needs, learn only if they are there.
    pub truncation_new: f32,
    /// How far it reaches behind the surface, in the same voxels, 1 to 8: what is there is a guess, and is in the way of what else is there.
    pub truncation_behind: f32,
    /// How wide a bundle of beams may be that are walked as one, voxels of the integration scale; 0 to walk each alone. Walks half a voxel apart
    /// still pass the same voxels.
    pub bundle_width: f32,
    /// Observations after which a voxel's mean becomes a moving one.
    pub max_weight: f32,
    /// Coarsest integration scale, 0 to 3.
    pub max_scale: usize,
    /// How many times farther than its cone demands a block stays at the finer scale it already has.
    pub coarser_factor: f32,
}

impl Default for TsdfSettings {
    fn default() -> Self {
        Self {
            voxel: 0.065,
            max_range: 60.0,
            truncation_voxels: 3.0,
            truncation_new: 1.5,
            truncation_behind: 1.5,
            bundle_width: 0.6,
            max_weight: 100.0,
            max_scale: SCALES - 1,
            coarser_factor: 1.5,
        }
    }
}

/// Time spent in each phase of one integration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TsdfPhases {
    /// Beams into the submap frame.
    pub transform: Duration,
    /// Blocks touched, grouped.
    pub select: Duration,
    /// Octants and blocks made, scales chosen.
    pub allocate: Duration,
    /// Bricks made or woken, voxels updated, propagation between scales and coming to rest included.
    pub update: Duration,
}

/// What one integration did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TsdfStats {
    /// Beams walked.
    pub beams: usize,
    /// Blocks touched.
    pub blocks: usize,
    /// Blocks that did not exist before.
    pub new_blocks: usize,
    /// Blocks whose scale changed.
    pub scale_changes: usize,
    /// Where the time went.
    pub phases: TsdfPhases,
}

/// Integrates scans into [`TsdfField`]s; holds the scratch memory, so keep one for all scans.
#[derive(Clone, Debug)]
pub struct TsdfIntegrator {
    settings: TsdfSettings,
    beams: Vec<Beam>,
    selection: Selection,
    runs: Vec<Run>,
}

impl TsdfIntegrator {
    /// An integrator with the given settings.
    pub fn new(settings: TsdfSettings) -> Self {
        Self { settings, beams: Vec::new(), selection: Selection::default(), runs: Vec::new() }
    }

    /// The settings.
    pub fn settings(&self) -> &TsdfSettings {
        &self.settings
    }

    /// The rule that chooses integration scales for beams `smallest_angle` radians apart.
    pub fn scale_rule(&self, smallest_angle: f32) -> ScaleRule {
        ScaleRule::new(smallest_angle, self.settings.voxel, self.settings.max_scale, self.settings.coarser_factor)
    }

    /// Blocks from the sensor to the farthest voxel that a beam can touch.
    fn reach(&self) -> u32 {
        let band = self.settings.truncation_voxels * (1 << self.settings.max_scale) as f32;
        ((self.settings.max_range / self.settings.voxel + band) / BLOCK_EDGE as f32).ceil() as u32 + 2
    }

    /// Integrates the returns of one scan taken at `t_submap_lidar`. Returns beyond the maximum range, and those beyond
    /// the 2^24th, are left out.
    pub fn integrate(&mut self, field: &mut TsdfField, t_submap_lidar: &Rigid, returns: &Returns<'_>) -> TsdfStats {
        self.integrate_unknown(field, t_submap_lidar, returns, &Known::default())
    }

    /// As [`integrate`](Self::integrate), but leaves out what is known.
    pub(crate) fn integrate_unknown(&mut self, field: &mut TsdfField, t_submap_lidar: &Rigid, returns: &Returns<'_>, known: &Known<'_>) -> TsdfStats {
        let settings = self.settings.clone();
        let rule = self.scale_rule(returns.smallest_angle);
        let reach = self.reach().min(MAX_REACH);
        let count = returns.points.len().min(MAX_BEAMS);
        let returns = Returns { points: &returns.points[..count], normals: &returns.normals[..count], ..*returns };

        let clock = Instant::now();
        let how = ToSubmap {
            t_submap_lidar: *t_submap_lidar,
            voxel: settings.voxel,
            max_range: settings.max_range,
            rule,
            least_slope: LEAST_SLOPE,
            band: [settings.truncation_new + WORN, settings.truncation_behind],
            along: settings.truncation_voxels,
            bundle_width: settings.bundle_width,
        };
        to_submap(&returns, &how, &mut self.beams);
        let transformed = Instant::now();

        let sensor = t_submap_lidar.translation.map(|c| c / settings.voxel);
        self.selection.select(&self.beams, sensor, reach);
        let selected = Instant::now();

        let new_blocks = self.allocate(field, &rule, t_submap_lidar.translation, !returns.shades.is_empty(), known);
        let allocated = Instant::now();

        let changes: Vec<u32> = self.runs.iter().filter(|r| r.change != Change::None).map(|r| r.block).collect();
        self.update(field);
        changes.iter().for_each(|&id| field.release_coarser(id));
        field.note_changed(self.runs.iter().map(|run| run.block).collect());
        let updated = Instant::now();

        TsdfStats {
            beams: self.beams.len(),
            blocks: self.runs.len(),
            new_blocks,
            scale_changes: changes.len(),
            phases: TsdfPhases {
                transform: transformed - clock,
                select: selected - transformed,
                allocate: allocated - selected,
                update: updated - allocated,
            },
        }
    }

    /// Finds or makes every selected block and moves it towards the scale that fits; returns how many are new.
    fn allocate(&mut self, field: &mut TsdfField, rule: &ScaleRule, sensor: [f32; 3], shaded: bool, known: &Known<'_>) -> usize {
        let block_edge = BLOCK_EDGE as f32 * self.settings.voxel;
        field.tree.grow_over(self.selection.blocks.iter().map(|run| run.key));
        let found = self.find(field, rule, known, |coords| distance_to_block(coords, block_edge, sensor));
        let mut cursor = Cursor::new(&field.tree);
        let mut new_blocks = 0;
        for ((run, &BlockBeams { key, .. }), scale) in self.runs.iter_mut().zip(&self.selection.blocks).zip(found) {
            match run.change {
                _ if run.start == run.end => {}
                _ if run.block == NONE => {
                    run.block = field.make(&mut cursor, key, scale, shaded).0;
                    new_blocks += 1;
                }
                Change::None => {}
                Change::Coarser => field.go_coarser(run.block),
                Change::Finer | Change::FinerNew => field.go_finer(run.block),
            }
        }
        self.runs.retain(|run| run.start < run.end);
        new_blocks
    }

    /// Finds the selected blocks that exist, in parallel, and decides on their scales; returns the scale that fits each. Those that neither exist nor
    /// have a beam that makes voxels there, and those of which enough is known, are left without beams.
    fn find(&mut self, field: &TsdfField, rule: &ScaleRule, known: &Known<'_>, distance: impl Fn([i32; 3]) -> f32 + Sync) -> Vec<u8> {
        /// Few enough that threads share evenly, many enough that a cursor seldom starts anew.
        const BLOCKS_PER_TASK: usize = 1024;
        let blocks = &self.selection.blocks;
        let mut fitting = vec![0; blocks.len()];
        self.runs.clear();
        self.runs.resize(blocks.len(), Run { block: NONE, start: 0, end: 0, change: Change::None, open: u8::MAX });
        let tasks = (self.runs.par_chunks_mut(BLOCKS_PER_TASK), fitting.par_chunks_mut(BLOCKS_PER_TASK), blocks.par_chunks(BLOCKS_PER_TASK));
        tasks.into_par_iter().for_each(|(runs, fitting, blocks)| {
            let (mut cursor, mut elsewhere) = (Cursor::new(&field.tree), known.elsewhere(self.settings.voxel));
            // Heads are asked for long before they are read: few of them are near.
            for (run, &BlockBeams { key, start, end }) in runs.iter_mut().zip(blocks) {
                let block = cursor.block(&field.tree, key);
                *run = Run { block: block.unwrap_or(NONE), start, end, change: Change::None, open: u8::MAX };
                if let Some(id) = block {
                    ask_for_all(&raw const field.blocks[id]);
                }
            }
            for ((run, fitting), &BlockBeams { key, start, end }) in runs.iter_mut().zip(fitting).zip(blocks) {
                let coords = block_coords(key);
                let distance = distance(coords);
                *fitting = rule.fitting(distance) as u8;
                let corner = coords.map(|c| (c * BLOCK_EDGE as i32) as f32);
                let beams = self.selection.records[start as usize..end as usize].iter().map(|&record| &self.beams[beam_of(record)]);
                let own = (run.block != NONE).then(|| &field.blocks[run.block]);
                if let Some(block) = own {
                    run.change = scale_change(block, rule, distance);
                }
                run.open = match own {
                    // What is seen from nearer than ever is worth telling.
                    _ if matches!(run.change, Change::Finer | Change::FinerNew) => u8::MAX,
                    Some(block) if block.told.beams() > 0 => known.open_octants(field, run.block, corner, beams.clone()),
                    _ => elsewhere.open_octants(corner, beams.clone()),
                };
                if run.open != u8::MAX {
                    run.change = Change::None;
                } else if own.is_some() {
                    continue;
                }
                let is_open = |beam: &Beam| run.open == u8::MAX || run.open & octant_bit(beam.point, corner) != 0;
                let makes = |beam: &Beam| own.is_some() || beam.makes(corner, *fitting, self.settings.truncation_new);
                let tells = beams.into_iter().any(|beam| is_open(beam) && makes(beam));
                if !tells {
                    run.end = start;
                }
            }
        });
        fitting
    }

    fn update(&mut self, field: &mut TsdfField) {
        /// Few enough that threads share evenly, many enough that handing them out costs nothing.
        const RUNS_PER_TASK: usize = 64;
        let band = Band {
            before: self.settings.truncation_voxels,
            new: self.settings.truncation_new,
            behind: self.settings.truncation_behind,
            fade: 1.0 / (self.settings.truncation_behind - 1.0).max(0.5),
            weight: f32::from(WEIGHT_ONE),
            max_weight: (self.settings.max_weight * f32::from(WEIGHT_ONE)).min(f32::from(u16::MAX)),
        };
        let task = Update {
            field: field.open(self.runs.len(), self.runs.len().div_ceil(RUNS_PER_TASK)),
            beams: &self.beams,
            records: &self.selection.records,
            band,
        };
        let share = |runs: &[Run]| {
            let mut touched = Touched::default();
            FORMATIONS.with_borrow_mut(|formations| dispatch(Share { runs, task: &task, formations, touched: &mut touched }));
            touched
        };
        let touched: Vec<Touched> = self.runs.par_chunks(RUNS_PER_TASK).with_max_len(1).map(share).collect();
        let taken = task.field.taken();
        field.close(taken, touched);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::Voxel;
    use crate::field::{BlockHead, TsdfBuilder};
    use proptest::prelude::*;

    /// Everything that a field holds.
    fn image(field: &TsdfField) -> Vec<(BlockHead, Vec<Voxel>, Vec<u8>)> {
        let of = |id| {
            let (voxels, shades): (Vec<_>, Vec<_>) = (field.stored_voxels(id).collect(), field.stored_shades(id).collect());
            (field.head(id), voxels.concat(), shades.concat())
        };
        field.ids_in_morton_order().into_iter().map(of).collect()
    }

    /// The octants of a block that have observed voxels, found voxel by voxel.
    fn observed_octants(field: &TsdfField, id: u32) -> u8 {
        let block = field.block(id);
        let (scale, edge) = (usize::from(block.scale), 1 << block.scale);
        let mut octants = 0;
        for (i, _) in field.current(block).iter().enumerate().filter(|(_, voxel)| voxel.is_observed()) {
            let low = crate::octree::voxel_coords(i, scale).map(|c| c * edge);
            // Every finest voxel in it: the coarsest voxel is all octants.
            for finest in 0..edge.pow(3) {
                let at = [finest % edge, finest / edge % edge, finest / edge / edge];
                octants |= 1 << (0..3).fold(0, |octant, k| octant | ((low[k] + at[k]) / 4) << k);
            }
        }
        octants
    }

    /// Scans of points around the origin, from places that come and go, so that blocks change their scales both ways.
    fn scans() -> impl Strategy<Value = Vec<([f32; 3], Vec<[f32; 3]>)>> {
        let place = prop::array::uniform3(-20f32..20.0);
        let points = prop::collection::vec(prop::array::uniform3(-3f32..3.0), 1..60);
        prop::collection::vec((place, points), 1..8)
    }

    proptest! {
        #[test]
        fn a_field_that_rests_after_every_scan_holds_the_same_bits(scans in scans(), shaded in any::<bool>(), handed_on in any::<bool>()) {
            let mut integrator = TsdfIntegrator::new(TsdfSettings { voxel: 0.1, ..TsdfSettings::default() });
            let (mut awake, mut resting) = (TsdfField::default(), TsdfField::default());
            for (i, (place, points)) in scans.iter().enumerate() {
                let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
                let t_submap_lidar = Rigid { rotation, translation: *place };
                let points: Vec<[f32; 3]> = points.iter().map(|p| std::array::from_fn(|k| p[k] - place[k])).collect();
                let normals = vec![[0.0; 3]; points.len()];
                let shades: Vec<u8> = (0..points.len()).map(|p| (1 + (7 * p + i) % 255) as u8).collect();
                let shades = if shaded { &shades[..] } else { &[] };
                let returns = Returns { points: &points, normals: &normals, shades, origins: &[], smallest_angle: 0.01 };
                integrator.integrate(&mut awake, &t_submap_lidar, &returns);
                integrator.integrate(&mut resting, &t_submap_lidar, &returns);
                if handed_on {
                    let mut pages = Vec::new();
                    resting.rest_from_the_end(40, &mut pages);
                    resting.adopt(pages);
                } else {
                    resting.rest_all();
                }
                for field in [&awake, &resting] {
                    field.assert_sound();
                    for id in field.ids() {
                        prop_assert_eq!(field.observed_octants(field.block(id)), observed_octants(field, id));
                    }
                }
            }
            let expected = image(&awake);
            prop_assert_eq!(&image(&resting), &expected);
            let mut builder = TsdfBuilder::default();
            expected.iter().for_each(|(head, voxels, shades)| builder.push(*head, voxels, shades).unwrap());
            let built = builder.finish();
            built.assert_sound();
            prop_assert_eq!(image(&built), expected);
        }
    }
}
