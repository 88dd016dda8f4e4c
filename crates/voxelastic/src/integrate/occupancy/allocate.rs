//! Allocation: uniform octants learn what was found of them, and blocks are made or refined where voxels are needed.
//!
//! Most of what a scan meets is there already. Threads deal with that side by side, and leave what has to be made to one of them: making changes
//! the tree.

use super::found::{Finds, Found, Spot, Stretch, What, clear};
use super::model::Steps;
use super::propagate::Touched;
use crate::field::occupancy::{OccupancyField, Summary};
use crate::integrate::scale::{ScaleRule, distance_to_block};
use crate::integrate::select::BlockBeams;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, SCALES, block_coords, prefetch};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// A block and everything that the scan says about it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    pub block: u32,
    /// Where its octant is.
    pub at: Spot,
    pub free: Free,
    /// Its records among the selection's.
    pub start: u32,
    pub end: u32,
}

/// What the descent found of a block.
#[derive(Clone, Copy, Debug)]
pub(super) enum Free {
    None,
    All,
    /// Some voxels, by the heap and the number of the mask on it.
    Mask {
        heap: u32,
        mask: u32,
    },
}

/// A selected block: where it was before the scan made or refined any, and how fine it is to be.
#[derive(Clone, Copy, Debug)]
struct Wanted {
    at: Spot,
    block: u32,
    scale: u8,
    /// Whether there is a block that is fine enough.
    is_there: bool,
}

/// The runs of beams that blocks were selected for, by block. Each is taken once; between scans there are none.
#[derive(Debug, Default)]
struct Runs(Vec<AtomicU32>);

impl Clone for Runs {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Runs {
    /// Makes room for blocks below `blocks`.
    fn cover(&mut self, blocks: u32) {
        let blocks = (blocks as usize).max(self.0.len());
        self.0.resize_with(blocks, || AtomicU32::new(NONE));
    }

    /// The run of a block, or [`NONE`].
    #[inline(always)]
    fn of(&self, block: u32) -> u32 {
        self.0.get(block as usize).map_or(NONE, |run| run.load(Ordering::Relaxed))
    }

    /// Notes a block's run; [`NONE`] for one that is taken.
    #[inline(always)]
    fn set(&self, block: u32, run: u32) {
        if let Some(known) = self.0.get(block as usize) {
            known.store(run, Ordering::Relaxed);
        }
    }

    /// As [`of`](Self::of), and it is taken.
    #[inline(always)]
    fn take(&self, block: u32) -> u32 {
        let run = self.of(block);
        if run != NONE {
            self.set(block, NONE);
        }
        run
    }
}

/// The blocks that a scan touches, each once.
#[derive(Clone, Debug, Default)]
pub(super) struct Touches {
    pub list: Vec<Touch>,
    /// The selected blocks, and which of them is which block.
    wanted: Vec<Wanted>,
    runs: Runs,
    /// Place in `list` of each block id, if it was made for what the descent found of it.
    made: Vec<u32>,
    /// Memory of tasks.
    shares: Vec<Share>,
}

/// What a task dealt with, and what it left, with the heap that it is on.
#[derive(Clone, Debug, Default)]
struct Share {
    touched: Touched,
    touches: Vec<Touch>,
    left: Vec<(u32, Found)>,
}

/// Selected blocks that one task takes: few enough that threads share evenly, many enough that starting anew costs nothing.
const PER_TASK: usize = 1024;

impl Touches {
    /// Looks where the `selected` blocks are, side by side, because most are far away in memory. `sensor` is in metres.
    pub fn look_up(&mut self, field: &OccupancyField, selected: &[BlockBeams], rule: &ScaleRule, voxel: f32, sensor: [f32; 3]) {
        let edge = BLOCK_EDGE as f32 * voxel;
        self.runs.cover(field.blocks.capacity_used());
        self.wanted.clear();
        self.wanted.resize(selected.len(), Wanted { at: Spot::NOWHERE, block: NONE, scale: 0, is_there: false });
        let (wanted, runs) = (&mut self.wanted, &self.runs);
        wanted.par_chunks_mut(PER_TASK).zip(selected.par_chunks(PER_TASK)).enumerate().for_each(|(chunk, (wanted, selected))| {
            let mut cursor = Cursor::new(&field.tree);
            for (wanted, beams) in wanted.iter_mut().zip(selected) {
                let Some((group, place)) = cursor.find_at(&field.tree, beams.key, 0) else { continue };
                (wanted.at, wanted.block) = (Spot::new((group, place)), field.tree.siblings(group)[place].link);
                if wanted.block != NONE {
                    prefetch(&raw const field.blocks[wanted.block]);
                }
            }
            for ((run, wanted), beams) in (chunk * PER_TASK..).zip(wanted).zip(selected) {
                wanted.scale = rule.fitting(distance_to_block(block_coords(beams.key), edge, sensor)) as u8;
                if wanted.block != NONE {
                    wanted.is_there = field.blocks[wanted.block].scale <= wanted.scale;
                    runs.set(wanted.block, run as u32);
                }
            }
        });
    }

    /// Applies what was found to uniform octants, and makes or refines the blocks that need voxels: those found, and those selected, which were
    /// [looked up](Self::look_up). Returns the octants that changed.
    pub fn allocate(&mut self, field: &mut OccupancyField, finds: &Finds, selected: &[BlockBeams], steps: &Steps) -> Touched {
        let mut touched = Touched::default();
        self.list.clear();
        let mut shares = std::mem::take(&mut self.shares);
        let parts = self.meet(field, finds, selected, steps, &mut shares);
        for share in &shares[..parts] {
            touched.append(&share.touched);
            self.list.extend_from_slice(&share.touches);
        }
        let mut cursor = Cursor::new(&field.tree);
        for (heap, found) in shares[..parts].iter().flat_map(|share| &share.left) {
            let at = Spot::new(cursor.make_at(&mut field.tree, found.key, found.level()));
            let Some((scale, free)) = found.needs(*heap) else {
                let octant = &mut field.tree.siblings_mut(at.group)[at.place()];
                octant.payload = learn(octant.payload, steps);
                touched.add(found.key, found.level());
                continue;
            };
            let run = self.runs.take(found.block) as usize;
            let scale = self.wanted.get(run).map_or(scale, |wanted| scale.min(wanted.scale.into()));
            let block = field.make_in((at.group, at.place()), found.key, scale);
            *self.made_at(block) = self.list.len() as u32;
            self.list.push(Touch::new(block, at, free, selected.get(run)));
        }
        for (wanted, beams) in self.wanted.iter().zip(selected).filter(|(wanted, _)| !wanted.is_there) {
            if wanted.block != NONE && self.runs.take(wanted.block) == NONE {
                continue; // refined above
            }
            let at = if wanted.at.is_nowhere() { Spot::new(cursor.make(&mut field.tree, beams.key)) } else { wanted.at };
            let block = field.make_in((at.group, at.place()), beams.key, wanted.scale.into());
            let made = self.made.get(block as usize).and_then(|&place| self.list.get_mut(place as usize));
            match made.filter(|touch| touch.block == block) {
                Some(touch) => (touch.start, touch.end) = (beams.start, beams.end),
                None => self.list.push(Touch::new(block, at, Free::None, Some(beams))),
            }
        }
        let parts = self.rest(selected, &mut shares);
        shares[..parts].iter().for_each(|share| self.list.extend_from_slice(&share.touches));
        self.shares = shares;
        touched
    }

    /// Deals with what was found that is there; returns how many `shares` that makes.
    #[allow(unsafe_code)]
    fn meet(&self, field: &mut OccupancyField, finds: &Finds, selected: &[BlockBeams], steps: &Steps, shares: &mut Vec<Share>) -> usize {
        /// As for [`PER_TASK`]; a stretch has some sixty finds.
        const STRETCHES_PER_TASK: usize = 32;
        /// How many octants and blocks ahead one is asked for.
        const AHEAD: usize = 8;
        let (octants, blocks) = (field.tree.cells(), &field.blocks);
        let meet = |(stretches, share): (&[Stretch], &mut Share)| {
            let all = stretches.iter().flat_map(|stretch| finds.of(stretch).iter().map(|found| (stretch.heap, found)));
            let mut ahead = all.clone().skip(AHEAD);
            share.clear();
            for (heap, one) in all {
                match ahead.next().map(|(_, next)| next) {
                    Some(next) if next.block != NONE => {
                        prefetch(&raw const blocks[next.block]);
                        prefetch(&raw const self.runs.0[next.block as usize]);
                    }
                    Some(next) if !next.at.is_nowhere() => prefetch(next.at.within(&octants).address()),
                    _ => {}
                }
                match one.needs(heap) {
                    None if !one.at.is_nowhere() => {
                        // SAFETY: an octant is found once, and of a group only that one octant is referred to.
                        let octant = unsafe { one.at.within(&octants).get() };
                        octant.payload = learn(octant.payload, steps);
                        share.touched.add(one.key, one.level());
                    }
                    Some((scale, free)) if one.block != NONE && usize::from(blocks[one.block].scale) <= scale => {
                        let run = self.runs.of(one.block) as usize;
                        if self.wanted.get(run).is_none_or(|wanted| wanted.is_there) {
                            share.touches.push(Touch::new(one.block, one.at, free, selected.get(run)));
                            self.runs.set(one.block, NONE);
                        } else {
                            share.left.push((heap, *one));
                        }
                    }
                    _ => share.left.push((heap, *one)),
                }
            }
        };
        let parts = share_out(shares, finds.stretches.len(), STRETCHES_PER_TASK);
        finds.stretches.par_chunks(STRETCHES_PER_TASK).zip(parts.par_iter_mut()).for_each(meet);
        parts.len()
    }

    /// The selected blocks that are there and of which nothing was found; returns how many `shares` that makes.
    fn rest(&self, selected: &[BlockBeams], shares: &mut Vec<Share>) -> usize {
        let touch = |(wanted, beams): (&Wanted, &BlockBeams)| {
            let is_left = wanted.is_there && self.runs.take(wanted.block) != NONE;
            is_left.then(|| Touch::new(wanted.block, wanted.at, Free::None, Some(beams)))
        };
        let parts = share_out(shares, self.wanted.len(), PER_TASK);
        self.wanted.par_chunks(PER_TASK).zip(selected.par_chunks(PER_TASK)).zip(parts.par_iter_mut()).for_each(|((wanted, selected), share)| {
            clear(&mut share.touches);
            share.touches.extend(wanted.iter().zip(selected).filter_map(touch));
        });
        parts.len()
    }

    /// Place in the list of a block that was made, whatever it is so far.
    #[inline(always)]
    fn made_at(&mut self, block: u32) -> &mut u32 {
        let block = block as usize;
        if block >= self.made.len() {
            self.made.resize(block + 1, NONE);
        }
        &mut self.made[block]
    }
}

impl Share {
    fn clear(&mut self) {
        self.touched.clear();
        clear(&mut self.touches);
        clear(&mut self.left);
    }
}

/// As many shares as tasks that do `each` of `all`.
fn share_out(shares: &mut Vec<Share>, all: usize, each: usize) -> &mut [Share] {
    let parts = all.div_ceil(each);
    if shares.len() < parts {
        shares.resize_with(parts, Share::default);
    }
    &mut shares[..parts]
}

impl Touch {
    #[inline(always)]
    fn new(block: u32, at: Spot, free: Free, beams: Option<&BlockBeams>) -> Self {
        let (start, end) = beams.map_or((0, 0), |beams| (beams.start, beams.end));
        Self { block, at, free, start, end }
    }
}

impl Found {
    /// The coarsest scale that a block must have for what was found of it, which is on `heap`; nothing of octants that need no block.
    #[inline(always)]
    fn needs(&self, heap: u32) -> Option<(usize, Free)> {
        match self.what {
            What::Octant { .. } => None,
            What::Block => Some((SCALES - 1, Free::All)),
            What::Voxels { mask, scale } => Some((scale.into(), Free::Mask { heap, mask })),
        }
    }
}

/// What a uniform octant is after it was found free.
#[inline(always)]
fn learn(summary: Summary, steps: &Steps) -> Summary {
    Summary::uniform(steps.add(summary.value, steps.free))
}
