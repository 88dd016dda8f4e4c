//! Coming to rest: bricks of blocks that no scan has touched for a while become [pieces](super::pieces); a scan that comes back to one
//! wakes it ([`OpenField`](super::OpenField)).

use super::blocks::{TsdfField, owned, owner};
use super::brick::{Brick, Handle};
use super::packed::Packed;
use crate::dispatch::{Kernel, dispatch};
use crate::octree::{Slab, ask_for_all};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Changes, scans that is, after which a block that none of them touched comes to rest.
const CHANGES_AWAKE: usize = 8;
/// Blocks that are laid to rest beside a scan, at most: nobody waits for them.
const MOST_AT_ONCE: usize = 2048;
/// Bricks that are packed before any of them is put away.
const BATCH: usize = 8192;
/// Bricks that a thread packs at a time: one is too little to hand out.
const BRICKS_PER_TASK: usize = 256;
/// Words of a brick packed, about.
const TYPICAL: usize = 24;
/// How far ahead blocks and bricks are asked for.
const AHEAD: usize = 4;

/// Memory of bricks, on its way from one field to another.
pub(crate) type BrickPages = Vec<Vec<Brick>>;

/// The blocks of the last changes, oldest first, and when they were.
#[derive(Clone, Debug, Default)]
pub(super) struct Recent {
    changes: VecDeque<(u32, Vec<u32>)>,
    /// Counts changes.
    clock: u32,
}

impl Recent {
    pub fn bytes(&self) -> usize {
        self.changes.iter().map(|(_, ids)| 4 * ids.capacity()).sum()
    }
}

impl TsdfField {
    /// Notes that a scan has just changed blocks `ids`, and lays those to rest that none of the last ones touched.
    pub(crate) fn note_changed(&mut self, ids: Vec<u32>) {
        self.recent.clock = self.recent.clock.wrapping_add(1);
        let clock = self.recent.clock;
        ids.iter().for_each(|&id| self.blocks[id].changed = clock);
        self.recent.changes.push_back((clock, ids));
        let mut most = MOST_AT_ONCE;
        while self.recent.changes.len() > CHANGES_AWAKE && most > 0 {
            let Some((clock, mut ids)) = self.recent.changes.pop_front() else { return };
            ids.retain(|&id| self.blocks[id].changed == clock);
            if ids.len() > most {
                self.recent.changes.push_front((clock, ids.split_off(most)));
            }
            most -= ids.len();
            let mut awake = Vec::with_capacity(4 * ids.len());
            for (i, &id) in ids.iter().enumerate() {
                ids.get(i + AHEAD).into_iter().for_each(|&next| ask_for_all(&raw const self.blocks[next]));
                let block = &self.blocks[id];
                let bricks = block.bricks.iter().enumerate().filter_map(|(k, brick)| Some((k, brick.slot()?)));
                awake.extend(bricks.map(|(k, slot)| Awake { owner: owner(id, k), slot, shaded: block.is_shaded(k) }));
            }
            self.lay_to_rest(&awake);
        }
    }

    /// Lays at most `most` bricks to rest, the last in memory first, and moves pages that hold nothing any more to `pages`. Returns how many
    /// bricks that were.
    pub(crate) fn rest_from_the_end(&mut self, most: usize, pages: &mut BrickPages) -> usize {
        let owned = (0..self.bricks.capacity_used()).rev().filter_map(|slot| Some((slot, self.bricks.owner(slot)?)));
        let awake: Vec<Awake> = owned.take(most).map(|(slot, owner)| Awake { owner, slot, shaded: self.is_owner_shaded(owner) }).collect();
        self.lay_to_rest(&awake);
        self.bricks.give_away(pages);
        if self.is_at_rest() {
            self.recent.changes = VecDeque::new();
        }
        awake.len()
    }

    /// Whether all of the field is at rest.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.bricks.live() == 0
    }

    /// Takes over memory that another field gave away, as much as it may soon need.
    pub(crate) fn adopt(&mut self, pages: BrickPages) {
        /// Bricks of two or three scans of a new place.
        const SPARE: usize = 16384;
        self.bricks.adopt(pages, SPARE);
    }

    /// Lays all of the field to rest.
    pub(crate) fn rest_all(&mut self) {
        self.recent.changes.clear();
        while self.rest_from_the_end(BATCH, &mut Vec::new()) > 0 {}
    }

    fn is_owner_shaded(&self, owner: u32) -> bool {
        let (id, brick) = owned(owner);
        self.blocks[id].is_shaded(brick)
    }

    fn lay_to_rest(&mut self, awake: &[Awake]) {
        for awake in awake.chunks(BATCH) {
            let tasks: Vec<Packs> = awake
                .par_chunks(BRICKS_PER_TASK)
                .map(|awake| {
                    let mut packs = Packs::default();
                    dispatch(Pack { bricks: &self.bricks, awake, packs: &mut packs });
                    packs
                })
                .collect();
            for (awake, packs) in awake.chunks(BRICKS_PER_TASK).zip(tasks) {
                let mut words = &packs.words[..];
                for (awake, &length) in awake.iter().zip(&packs.lengths) {
                    let (id, brick) = owned(awake.owner);
                    let (own, others) = words.split_at(length.into());
                    words = others;
                    self.blocks[id].bricks[brick] =
                        if own.is_empty() { Handle::NOWHERE } else { Handle::resting(self.pieces.insert(awake.owner, own)) };
                    self.bricks.remove(awake.slot);
                }
            }
        }
    }
}

/// A brick that is awake, and whether it has intensities.
#[derive(Clone, Copy)]
struct Awake {
    owner: u32,
    slot: u32,
    shaded: bool,
}

/// Bricks packed end to end.
#[derive(Default)]
struct Packs {
    words: Vec<u32>,
    /// Words of each brick; none for one that holds nothing.
    lengths: Vec<u8>,
}

/// Packs bricks that are awake.
struct Pack<'a> {
    bricks: &'a Slab<Brick>,
    awake: &'a [Awake],
    packs: &'a mut Packs,
}

impl Kernel for Pack<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { bricks, awake, packs } = self;
        packs.words.reserve(awake.len() * TYPICAL);
        packs.lengths.reserve(awake.len());
        let mut packed = Packed::EMPTY;
        for (i, brick) in awake.iter().enumerate() {
            if let Some(later) = awake.get(i + AHEAD) {
                ask_for_all(&raw const bricks[later.slot]);
            }
            packed.pack(&bricks[brick.slot], brick.shaded);
            let words = if packed.is_empty() { &[] } else { packed.words() };
            packs.words.extend_from_slice(words);
            packs.lengths.push(words.len() as u8);
        }
    }
}
