//! MultiresTSDF integration (paper Sec. III-A, III-B): walk each beam through its truncation band, from the true point.
//!
//! A scan goes through five phases: *transform* the beams into the submap, *select* the blocks that their bands touch,
//! *allocate* what is missing (in bulk, in Morton order, choosing each block's scale), *update* each block's voxels from
//! its beams in beam order, and *release* what scale changes left over. Blocks are independent in the update, so threads
//! share nothing and change nothing but the time.

use super::band::{Band, Hits};
use super::scale::ScaleRule;
use super::select::{BlockBeams, MAX_BEAMS, MAX_REACH, Selection, beam_of};
use super::transform::{Beam, Returns, ToSubmap, to_submap};
use super::walk::{LANES, Line, Lines, Trace};
use crate::dispatch::{Kernel, dispatch};
use crate::field::StoreCells;
use crate::field::tsdf::propagate::{propagate_delta_down, propagate_down, propagate_up};
use crate::field::tsdf::{Block, TsdfField, Voxel, WEIGHT_ONE};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, Place, Pool, SCALES, block_coords, prefetch};
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Least sine of the angle at which a walk leaves its local plane. On the campus 90 % of the surface is there without it, 95 % with
/// 0.3 to 0.5; beyond that walks beside each other no longer touch.
const LEAST_SLOPE: f32 = 0.4;

/// How scans update a TSDF.
#[derive(Clone, Debug, PartialEq)]
pub struct TsdfSettings {
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
    /// Largest range that is integrated, metres.
    pub max_range: f32,
    /// Half the width of the truncation band in voxels of the integration scale, 1 to 8.
    pub truncation_voxels: f32,
    /// Observations after which a voxel's mean becomes a moving one.
    pub max_weight: f32,
    /// Coarsest integration scale, 0 to 3.
    pub max_scale: usize,
    /// How many times farther than its cone demands a block stays at the finer scale it already has.
    pub coarser_factor: f32,
}

impl Default for TsdfSettings {
    fn default() -> Self {
        Self { voxel: 0.065, max_range: 60.0, truncation_voxels: 3.0, max_weight: 100.0, max_scale: SCALES - 1, coarser_factor: 1.5 }
    }
}

/// Time spent in each phase of one integration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TsdfPhases {
    /// Beams into the submap frame.
    pub transform: Duration,
    /// Blocks touched, grouped.
    pub select: Duration,
    /// Octants and arrays made, scales chosen.
    pub allocate: Duration,
    /// Voxels updated, propagation between scales included.
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

#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    None,
    Coarser,
    /// To an array that was there before.
    Finer,
    /// To a new array.
    FinerNew,
}

/// A block and the beams that touch it.
#[derive(Clone, Copy, Debug)]
struct Run {
    block: u32,
    start: u32,
    end: u32,
    change: Change,
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
        let settings = self.settings.clone();
        let rule = self.scale_rule(returns.smallest_angle);
        let reach = self.reach().min(MAX_REACH);
        let count = returns.points.len().min(MAX_BEAMS);
        let returns = Returns { points: &returns.points[..count], normals: &returns.normals[..count], ..*returns };

        let clock = Instant::now();
        let how = ToSubmap { t_submap_lidar: *t_submap_lidar, voxel: settings.voxel, least_slope: LEAST_SLOPE };
        to_submap(&returns, &how, |range| rule.fitting(range), &mut self.beams);
        let limit = settings.max_range / settings.voxel;
        self.beams.retain(|beam| beam.range <= limit);
        let transformed = Instant::now();

        let sensor = t_submap_lidar.translation.map(|c| c / settings.voxel);
        let band = |beam: &Beam| settings.truncation_voxels * (1 << beam.scale) as f32;
        self.selection.select(&self.beams, sensor, reach, |beam| (band(beam), band(beam)));
        let selected = Instant::now();

        let new_blocks = self.allocate(field, &rule, t_submap_lidar.translation, !returns.shades.is_empty());
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
    fn allocate(&mut self, field: &mut TsdfField, rule: &ScaleRule, sensor: [f32; 3], shaded: bool) -> usize {
        let block_edge = BLOCK_EDGE as f32 * self.settings.voxel;
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        for run in &self.selection.blocks {
            let c = block_coords(run.key);
            low = std::array::from_fn(|k| low[k].min(c[k]));
            high = std::array::from_fn(|k| high[k].max(c[k]));
        }
        if !self.selection.blocks.is_empty() {
            field.tree.grow_to(crate::octree::block_key(low));
            field.tree.grow_to(crate::octree::block_key(high));
        }
        let found = self.find(field, rule, |c| (0..3).map(|k| ((c[k] as f32 + 0.5) * block_edge - sensor[k]).powi(2)).sum::<f32>().sqrt());
        field.wake(self.runs.iter().filter(|run| run.block != NONE).map(|run| run.block));
        let mut cursor = Cursor::new(&field.tree);
        let mut new_blocks = 0;
        for ((run, &BlockBeams { key, .. }), scale) in self.runs.iter_mut().zip(&self.selection.blocks).zip(found) {
            match run.change {
                _ if run.block == NONE => {
                    run.block = field.make(&mut cursor, key, scale, shaded).0;
                    new_blocks += 1;
                }
                Change::None => {}
                Change::Coarser => field.reserve_coarser(run.block),
                Change::Finer | Change::FinerNew => field.reserve_finer(run.block),
            }
        }
        new_blocks
    }

    /// Finds the selected blocks that exist, in parallel, and decides on their scales; returns the scale that fits each.
    fn find(&mut self, field: &TsdfField, rule: &ScaleRule, distance: impl Fn([i32; 3]) -> f32 + Sync) -> Vec<u8> {
        /// Few enough that threads share evenly, many enough that a cursor seldom starts anew.
        const BLOCKS_PER_TASK: usize = 1024;
        let blocks = &self.selection.blocks;
        let mut fitting = vec![0; blocks.len()];
        self.runs.clear();
        self.runs.resize(blocks.len(), Run { block: NONE, start: 0, end: 0, change: Change::None });
        let tasks = (self.runs.par_chunks_mut(BLOCKS_PER_TASK), fitting.par_chunks_mut(BLOCKS_PER_TASK), blocks.par_chunks(BLOCKS_PER_TASK));
        tasks.into_par_iter().for_each(|(runs, fitting, blocks)| {
            let mut cursor = Cursor::new(&field.tree);
            // Heads are asked for long before they are read: few of them are near.
            for (run, &BlockBeams { key, start, end }) in runs.iter_mut().zip(blocks) {
                let block = cursor.block(&field.tree, key);
                *run = Run { block: block.unwrap_or(NONE), start, end, change: Change::None };
                if let Some(id) = block {
                    prefetch(&raw const field.blocks[id]);
                }
            }
            for ((run, fitting), &BlockBeams { key, .. }) in runs.iter_mut().zip(fitting).zip(blocks) {
                let distance = distance(block_coords(key));
                *fitting = rule.fitting(distance) as u8;
                if run.block != NONE {
                    run.change = scale_change(&field.blocks[run.block], rule, distance);
                }
            }
        });
        fitting
    }

    fn update(&mut self, field: &mut TsdfField) {
        /// Few enough that threads share evenly, many enough that handing them out costs nothing.
        const RUNS_PER_TASK: usize = 64;
        let band = Band {
            truncation: self.settings.truncation_voxels,
            weight: f32::from(WEIGHT_ONE),
            max_weight: (self.settings.max_weight * f32::from(WEIGHT_ONE)).min(f32::from(u16::MAX)),
        };
        let task = BlockUpdate {
            blocks: &field.blocks,
            voxels: field.voxels.cells(),
            shades: field.shades.cells(),
            beams: &self.beams,
            records: &self.selection.records,
            band,
        };
        self.runs.par_chunks(RUNS_PER_TASK).for_each(|runs| dispatch(Runs { runs, task: &task }));
    }
}

/// Decides whether `block`, `distance` metres from the sensor, changes scale.
fn scale_change(block: &Block, rule: &ScaleRule, distance: f32) -> Change {
    let (current, finest) = (usize::from(block.scale), usize::from(block.finest));
    match rule.next(current, distance) {
        next if next > current => Change::Coarser,
        next if next == current => Change::None,
        next if next < finest => Change::FinerNew,
        _ => Change::Finer,
    }
}

/// Everything that a thread needs to update blocks.
struct BlockUpdate<'a> {
    blocks: &'a Pool<Block>,
    voxels: StoreCells<'a, Voxel>,
    shades: StoreCells<'a, u8>,
    beams: &'a [Beam],
    records: &'a [u64],
    band: Band,
}

/// A share of the blocks.
struct Runs<'a> {
    runs: &'a [Run],
    task: &'a BlockUpdate<'a>,
}

impl Kernel for Runs<'_> {
    /// Lines fly in formation through whatever blocks come next; while one formation's voxels are on their way from memory,
    /// the one before is applied.
    #[inline(always)]
    #[allow(unsafe_code)]
    fn run(self) {
        let Self { runs, task } = self;
        let mut formations = [Formation::new(), Formation::new()];
        let mut next = 0;
        // Loops, because a closure would not be inlined and then not be compiled for the wide instructions.
        for (i, run) in runs.iter().enumerate() {
            if let Some(later) = runs.get(i + 6) {
                prefetch(&raw const task.blocks[later.block]);
            }
            let block = &task.blocks[run.block];
            if run.change != Change::None {
                task.change_scale(block, run.change);
            }
            let home = task.home(block);
            for record in run.start as usize..run.end as usize {
                if let Some(&later) = task.records.get(record + BEAMS_AHEAD) {
                    ask_for_all(&task.beams[beam_of(later)]);
                }
                formations[next].push(&home, &task.beams[beam_of(task.records[record])], task.band.truncation);
                if formations[next].lines.len() == LANES {
                    formations[next].walk(&task.band);
                    next = 1 - next;
                    // SAFETY: each block occurs in one run only, so in one thread only, and arrays belong to one block only.
                    unsafe { formations[next].apply(&task.band) };
                }
            }
        }
        formations[next].walk(&task.band);
        for formation in [1 - next, next] {
            // SAFETY: as above.
            unsafe { formations[formation].apply(&task.band) };
        }
    }
}

/// How far ahead a beam is asked for: records follow blocks, beams lie in the order of the scan.
const BEAMS_AHEAD: usize = 24;

/// Asks for all cache lines of `item`.
#[inline(always)]
fn ask_for_all<T>(item: &T) {
    let first = std::ptr::from_ref(item).cast::<u8>();
    prefetch(first);
    prefetch(first.wrapping_add(size_of::<T>() - 1));
}

/// The block that beams are walked through.
struct Home {
    scale: u32,
    /// Its smallest corner, finest voxels.
    corner: [f32; 3],
    voxels: Place<Voxel>,
    shades: Place<u8>,
}

/// Beams that are walked together, each through a block of its own or one that it shares.
struct Formation {
    lines: Lines,
    trace: Trace,
    hits: Hits,
    voxels: [Place<Voxel>; LANES],
    shades: [Place<u8>; LANES],
    shade: [u8; LANES],
}

impl Formation {
    fn new() -> Self {
        let (voxels, shades) = ([Place::NOWHERE; LANES], [Place::NOWHERE; LANES]);
        Self { lines: Lines::new(), trace: Trace::new(), hits: Hits::new(), voxels, shades, shade: [0; LANES] }
    }

    #[inline(always)]
    fn push(&mut self, home: &Home, beam: &Beam, truncation: f32) {
        let lane = self.lines.len() % LANES;
        (self.voxels[lane], self.shades[lane], self.shade[lane]) = (home.voxels, home.shades, beam.shade as u8);
        self.lines.push(&Line {
            point: beam.point,
            direction: beam.direction,
            gradient: beam.normal,
            corner: home.corner,
            scale: home.scale,
            reach: [-truncation, truncation],
        });
    }

    /// Finds out what the lines pass, and asks for it to be brought near.
    #[inline(always)]
    fn walk(&mut self, band: &Band) {
        self.trace.walk(&self.lines);
        band.collect(&self.trace, &mut self.hits);
        for i in 0..self.hits.len {
            let (lane, index) = self.hits.target(i);
            prefetch(self.voxels[lane].address(index));
            prefetch(self.shades[lane].address(index));
        }
    }

    /// Updates the voxels that the lines pass, and disbands the formation.
    ///
    /// # Safety
    /// No other thread may touch the arrays of the blocks that the lines were pushed for, and none of them may have gone since.
    #[inline(always)]
    #[allow(unsafe_code)]
    unsafe fn apply(&mut self, band: &Band) {
        let Self { lines, hits, voxels, shades, shade, .. } = self;
        for i in 0..hits.len {
            let (lane, index) = hits.target(i);
            // SAFETY: the caller's promise; a trace's indices lie within the array of its line's block.
            band.observe(hits, i, unsafe { voxels[lane].at(index) });
        }
        for i in 0..hits.len {
            let (lane, index) = hits.target(i);
            if !shades[lane].is_nowhere() {
                // SAFETY: as above; intensities are as many as voxels.
                hits.observe_shade(i, unsafe { shades[lane].at(index) }, shade[lane]);
            }
        }
        hits.len = 0;
        lines.clear();
    }
}

impl BlockUpdate<'_> {
    #[inline(always)]
    fn home(&self, block: &Block) -> Home {
        let [x, y, z] = block_coords(block.key);
        let (edge, scale) = (BLOCK_EDGE as i32, usize::from(block.scale));
        Home {
            scale: u32::from(block.scale),
            corner: [(x * edge) as f32, (y * edge) as f32, (z * edge) as f32],
            voxels: self.voxels.place(scale, block.data[scale]),
            shades: if block.shade[scale] == NONE { Place::NOWHERE } else { self.shades.place(scale, block.shade[scale]) },
        }
    }

    /// Fills the array of the block's new scale from the one that it leaves (paper Sec. III-A, propagation).
    #[allow(unsafe_code)]
    fn change_scale(&self, block: &Block, change: Change) {
        /// What an interpolated voxel weighs: little, because it is a guess from voxels twice as large, which a measurement at
        /// its own scale must outweigh at once.
        const INTERPOLATED_WEIGHT: u16 = WEIGHT_ONE / 4;
        let scale = usize::from(block.scale);
        // SAFETY: these arrays belong to this block alone, which no other thread touches, and differ in scale or slot.
        unsafe {
            let voxels = self.voxels.get(scale, block.data[scale]);
            match change {
                Change::None => {}
                Change::Coarser => {
                    propagate_up(self.voxels.get(scale - 1, block.data[scale - 1]), voxels, scale - 1);
                    self.voxels.get(scale, block.past[scale]).copy_from_slice(voxels);
                }
                Change::Finer => {
                    let now = self.voxels.get(scale + 1, block.data[scale + 1]);
                    let past = self.voxels.get(scale + 1, block.past[scale + 1]);
                    propagate_delta_down(now, past, voxels, scale, [self.band.max_weight as u16, INTERPOLATED_WEIGHT]);
                }
                Change::FinerNew => {
                    propagate_down(self.voxels.get(scale + 1, block.data[scale + 1]), voxels, scale, INTERPOLATED_WEIGHT);
                }
            }
            if block.shade[scale] != NONE {
                self.change_shade_scale(block, change, self.shades.get(scale, block.shade[scale]));
            }
        }
    }

    /// Intensities move between scales by plain copy and mean of what is known.
    #[allow(unsafe_code)]
    unsafe fn change_shade_scale(&self, block: &Block, change: Change, shades: &mut [u8]) {
        use crate::field::tsdf::propagate::children;
        let scale = usize::from(block.scale);
        match change {
            Change::Coarser => {
                // SAFETY: as in `change_scale`.
                let fine = unsafe { self.shades.get(scale - 1, block.shade[scale - 1]) };
                for (i, shade) in shades.iter_mut().enumerate() {
                    let known = || children(i, scale - 1).map(|c| u32::from(fine[c])).filter(|&s| s > 0);
                    *shade = (known().sum::<u32>() / known().count().max(1) as u32) as u8;
                }
            }
            Change::FinerNew => {
                // SAFETY: as in `change_scale`.
                let coarse = unsafe { self.shades.get(scale + 1, block.shade[scale + 1]) };
                for (i, &shade) in coarse.iter().enumerate() {
                    children(i, scale).for_each(|c| shades[c] = shade);
                }
            }
            Change::None | Change::Finer => {}
        }
    }
}
