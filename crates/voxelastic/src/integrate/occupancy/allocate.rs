//! Allocation: uniform octants learn what was found of them, and blocks are made or refined where voxels are needed.
//!
//! Most of what a scan meets is there already. Threads deal with that side by side, and leave what has to be made to one of them: making changes
//! the tree.

use super::found::{Finds, Found, Spot, What};
use super::model::Steps;
use super::propagate::Touched;
use crate::field::occupancy::{OccupancyField, Summary};
use crate::integrate::scale::{ScaleRule, distance_to_block};
use crate::integrate::select::BlockBeams;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, SCALES, block_coords, prefetch};
use rayon::prelude::*;

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
    /// Some voxels, by the number of their mask.
    Mask(u32),
}

/// A selected block: where it was before the scan made or refined any, and how fine it is to be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    at: Spot,
    block: u32,
    scale: u8,
    /// Whether there is a block that is fine enough.
    is_there: bool,
}

/// Few enough that threads share evenly, many enough that starting anew costs nothing.
const PER_TASK: usize = 4096;

/// Looks where the `selected` blocks are, side by side, because most are far away in memory. `sensor` is in metres.
pub(super) fn look_up(field: &OccupancyField, selected: &[BlockBeams], rule: &ScaleRule, voxel: f32, sensor: [f32; 3]) -> Vec<Wanted> {
    let edge = BLOCK_EDGE as f32 * voxel;
    let mut wanted = vec![Wanted { at: Spot::NOWHERE, block: NONE, scale: 0, is_there: false }; selected.len()];
    wanted.par_chunks_mut(PER_TASK).zip(selected.par_chunks(PER_TASK)).for_each(|(wanted, selected)| {
        let mut cursor = Cursor::new(&field.tree);
        for (wanted, run) in wanted.iter_mut().zip(selected) {
            let Some((group, place)) = cursor.find_at(&field.tree, run.key, 0) else { continue };
            (wanted.at, wanted.block) = (Spot::new((group, place)), field.tree.siblings(group)[place].link);
            if wanted.block != NONE {
                prefetch(&raw const field.blocks[wanted.block]);
            }
        }
        for (wanted, run) in wanted.iter_mut().zip(selected) {
            wanted.scale = rule.fitting(distance_to_block(block_coords(run.key), edge, sensor)) as u8;
            wanted.is_there = wanted.block != NONE && field.blocks[wanted.block].scale <= wanted.scale;
        }
    });
    wanted
}

/// The blocks that a scan touches, each once.
#[derive(Clone, Debug, Default)]
pub(super) struct Touches {
    pub list: Vec<Touch>,
    /// Place in `list` of each block id, if it is touched.
    of: Vec<u32>,
}

/// What a thread dealt with, and what it left.
#[derive(Default)]
struct Share {
    touched: Touched,
    touches: Vec<Touch>,
    left: Vec<Found>,
}

impl Touches {
    /// Applies what was found to uniform octants, and makes or refines the blocks that need voxels: those found, and those selected, which are
    /// `wanted`. Returns the octants that changed.
    pub fn allocate(&mut self, field: &mut OccupancyField, finds: &Finds, selected: &[BlockBeams], wanted: &[Wanted], steps: &Steps) -> Touched {
        self.list.clear();
        let shares = Self::meet(field, &finds.found, steps);
        let mut cursor = Cursor::new(&field.tree);
        let mut touched = Touched::default();
        for share in shares {
            touched.append(&share.touched);
            for touch in share.touches {
                *self.place_of(touch.block) = self.list.len() as u32;
                self.list.push(touch);
            }
            for found in share.left {
                let at = Spot::new(cursor.make_at(&mut field.tree, found.key, found.level()));
                let (scale, free) = match found.what {
                    What::Octant { level } => {
                        let octant = &mut field.tree.siblings_mut(at.group)[at.place()];
                        octant.payload = learn(octant.payload, steps);
                        touched.add(found.key, u32::from(level));
                        continue;
                    }
                    What::Block => (SCALES - 1, Free::All),
                    What::Voxels { mask, scale } => (usize::from(scale), Free::Mask(mask)),
                };
                let block = field.make_in((at.group, at.place()), found.key, scale);
                self.touch(block, at, free);
            }
        }
        for ((run, wanted), known) in selected.iter().zip(wanted).zip(self.known(wanted)) {
            let touch = if !wanted.is_there {
                let at = if wanted.at.is_nowhere() { Spot::new(cursor.make(&mut field.tree, run.key)) } else { wanted.at };
                let block = field.make_in((at.group, at.place()), run.key, wanted.scale.into());
                self.touch(block, at, Free::None)
            } else if known == NONE {
                // No later one is of the same block.
                self.list.push(Touch { block: wanted.block, at: wanted.at, free: Free::None, start: 0, end: 0 });
                let last = self.list.len() - 1;
                &mut self.list[last]
            } else {
                &mut self.list[known as usize]
            };
            (touch.start, touch.end) = (run.start, run.end);
        }
        touched
    }

    /// Deals with what was found that is there.
    #[allow(unsafe_code)]
    fn meet(field: &mut OccupancyField, found: &[Found], steps: &Steps) -> Vec<Share> {
        /// How many octants and blocks ahead one is asked for.
        const AHEAD: usize = 8;
        let (octants, blocks) = (field.tree.cells(), &field.blocks);
        let meet = |found: &[Found]| {
            let mut share = Share { touches: Vec::with_capacity(found.len() / 2), ..Share::default() };
            for (i, &one) in found.iter().enumerate() {
                if let Some(next) = found.get(i + AHEAD) {
                    match next.what {
                        What::Octant { .. } if next.at.is_nowhere() => {}
                        What::Octant { .. } => prefetch(next.at.within(&octants).address()),
                        _ if next.block == NONE => {}
                        _ => prefetch(&raw const blocks[next.block]),
                    }
                }
                let (scale, free) = match one.what {
                    What::Octant { .. } if one.at.is_nowhere() => {
                        share.left.push(one);
                        continue;
                    }
                    What::Octant { level } => {
                        // SAFETY: an octant is found once, and of a group only that one octant is referred to.
                        let octant = unsafe { one.at.within(&octants).get() };
                        octant.payload = learn(octant.payload, steps);
                        share.touched.add(one.key, u32::from(level));
                        continue;
                    }
                    What::Block => (SCALES - 1, Free::All),
                    What::Voxels { mask, scale } => (usize::from(scale), Free::Mask(mask)),
                };
                if one.block != NONE && usize::from(blocks[one.block].scale) <= scale {
                    share.touches.push(Touch { block: one.block, at: one.at, free, start: 0, end: 0 });
                } else {
                    share.left.push(one);
                }
            }
            share
        };
        found.par_chunks(PER_TASK).map(meet).collect()
    }

    /// The places in the list of those blocks that are wanted and there, if they are touched.
    fn known(&self, wanted: &[Wanted]) -> Vec<u32> {
        let place = |wanted: &Wanted| {
            let place = self.of.get(wanted.block as usize).copied().unwrap_or(NONE);
            let is_known = self.list.get(place as usize).is_some_and(|touch| touch.block == wanted.block);
            if is_known { place } else { NONE }
        };
        wanted.par_iter().with_min_len(PER_TASK).map(place).collect()
    }

    /// Place in the list of block `id`, or of another one, or none.
    #[inline(always)]
    fn place_of(&mut self, id: u32) -> &mut u32 {
        let id = id as usize;
        if id >= self.of.len() {
            self.of.resize(id + 1, NONE);
        }
        &mut self.of[id]
    }

    /// The touch of a block; a new one if there is none.
    #[inline(always)]
    fn touch(&mut self, block: u32, at: Spot, free: Free) -> &mut Touch {
        let next = self.list.len();
        let place = *self.place_of(block) as usize;
        let is_known = self.list.get(place).is_some_and(|touch| touch.block == block);
        if !is_known {
            *self.place_of(block) = next as u32;
            self.list.push(Touch { block, at, free, start: 0, end: 0 });
        }
        &mut self.list[if is_known { place } else { next }]
    }
}

/// What a uniform octant is after it was found free.
#[inline(always)]
fn learn(summary: Summary, steps: &Steps) -> Summary {
    Summary::uniform(steps.add(summary.value, steps.free))
}
