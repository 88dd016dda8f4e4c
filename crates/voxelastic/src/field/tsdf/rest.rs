//! Blocks at rest: arrays that no scan has touched for a while are [packed](super::packed), and unpacked when one comes back to them.

use super::blocks::{Block, TsdfField};
use super::packed::Packed;
use super::voxel::Voxel;
use crate::dispatch::{Kernel, dispatch};
use crate::field::{Spare, StoreCells};
use crate::octree::{Cursor, NONE, Pool, prefetch, voxels_at};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Coarsest scale whose arrays rest packed: those of coarser ones are smaller than their administration.
pub(crate) const COARSEST_PACKED: usize = 1;
/// Changes, scans or steps of a fusion, after which a block that none of them touched comes to rest.
const CHANGES_AWAKE: usize = 8;
/// Stands for the slot of intensities that lie with their packed voxels.
pub(super) const PACKED_TOO: u32 = 0;
/// Blocks that are laid to rest beside a scan, at most: nobody waits for them.
const MOST_AT_ONCE: usize = 2048;
/// Blocks that a thread takes at a time: each is a fraction of a microsecond.
const BLOCKS_PER_TASK: usize = 64;

/// Bytes of a cache line.
pub(super) const LINE: usize = 64;

/// What is at rest, and what may be next.
#[derive(Clone, Debug, Default)]
pub(crate) struct Resting {
    pub(super) arrays: Pool<Packed>,
    bytes: usize,
    /// The blocks of the last changes, oldest first, and when they were.
    recent: VecDeque<(u32, Vec<u32>)>,
    /// Counts changes.
    clock: u32,
}

impl Resting {
    pub(super) fn bytes(&self) -> usize {
        self.bytes + self.arrays.bytes() + self.recent.iter().map(|(_, ids)| 4 * ids.capacity()).sum::<usize>()
    }

    fn insert(&mut self, packed: Packed) -> u32 {
        self.bytes += packed.bytes();
        self.arrays.insert(packed)
    }

    fn remove(&mut self, slot: u32) -> Packed {
        let packed = std::mem::take(&mut self.arrays[slot]);
        self.bytes -= packed.bytes();
        self.arrays.remove(slot);
        packed
    }
}

/// An array on its way from rest.
struct Waking {
    scale: usize,
    packed: Packed,
    voxels: u32,
    shades: u32,
}

/// The arrays of a block, packed, on their way to rest.
type Packs = [Option<Packed>; COARSEST_PACKED + 1];

impl TsdfField {
    /// Unpacks whatever blocks `ids` have at rest; each is named once.
    pub(crate) fn wake(&mut self, ids: impl IntoIterator<Item = u32>) {
        let mut waking = Vec::new();
        for id in ids {
            let block = &mut self.blocks[id];
            for scale in (0..=COARSEST_PACKED).filter(|&scale| std::mem::take(&mut block.packed[scale])) {
                let packed = self.resting.remove(block.data[scale]);
                block.data[scale] = self.voxels.claim(scale);
                if block.shade[scale] != NONE {
                    block.shade[scale] = self.shades.claim(scale);
                }
                waking.push(Waking { scale, packed, voxels: block.data[scale], shades: block.shade[scale] });
            }
        }
        let (voxels, shades) = (self.voxels.cells(), self.shades.cells());
        waking.par_chunks(BLOCKS_PER_TASK).for_each(|waking| dispatch(Unpack { waking, voxels: &voxels, shades: &shades }));
        // Giving so many small pieces of memory back takes as long as unpacking them.
        waking.into_par_iter().with_min_len(BLOCKS_PER_TASK).for_each(drop);
    }

    /// Notes that blocks `ids` have just been changed, and lays those to rest that none of the last changes touched.
    pub(crate) fn note_changed(&mut self, ids: Vec<u32>) {
        self.resting.clock = self.resting.clock.wrapping_add(1);
        let clock = self.resting.clock;
        ids.iter().for_each(|&id| self.blocks[id].changed = clock);
        self.resting.recent.push_back((clock, ids));
        self.rest(CHANGES_AWAKE, MOST_AT_ONCE);
    }

    /// Gives `block` an array at `scale` that it does not have yet: at rest if arrays of that scale can be.
    pub(in crate::field) fn put(&mut self, block: &mut Block, scale: usize, packed: Packed, shaded: bool) {
        if scale <= COARSEST_PACKED {
            (block.data[scale], block.packed[scale]) = (self.resting.insert(packed), true);
            block.shade[scale] = if shaded { PACKED_TOO } else { NONE };
            return;
        }
        block.data[scale] = self.voxels.insert(scale);
        packed.unpack(scale, self.voxels.get_mut(scale, block.data[scale]));
        if shaded {
            block.shade[scale] = self.shades.insert(scale);
            packed.unpack_shades(scale, self.shades.get_mut(scale, block.shade[scale]));
        }
    }

    /// Makes block `key`, which is not there yet, of an array at `scale`. The tree's root must cover the key.
    pub(crate) fn add(&mut self, cursor: &mut Cursor, key: u64, scale: u8, packed: Packed, shaded: bool) -> u32 {
        let mut block = Block::new(key, scale, scale);
        self.put(&mut block, scale.into(), packed, shaded);
        self.hang(cursor, block)
    }

    /// Goes on to lay the field to rest, while it is not changed itself.
    pub(crate) fn rest_a_step(&mut self) {
        self.rest(0, MOST_AT_ONCE);
    }

    /// Lays all of the field to rest.
    pub(crate) fn rest_all(&mut self) {
        self.rest(0, usize::MAX);
    }

    /// Lays blocks to rest, the longest untouched first, until those of `awake` changes are left or `most` have been.
    fn rest(&mut self, awake: usize, mut most: usize) {
        while self.resting.recent.len() > awake && most > 0 {
            let Some((clock, mut ids)) = self.resting.recent.pop_front() else { return };
            ids.retain(|&id| self.blocks[id].changed == clock);
            if ids.len() > most {
                self.resting.recent.push_front((clock, ids.split_off(most)));
            }
            most -= ids.len();
            self.lay_to_rest(ids);
        }
    }

    fn lay_to_rest(&mut self, ids: Vec<u32>) {
        let mut packs: Vec<Packs> = vec![[const { None }; COARSEST_PACKED + 1]; ids.len()];
        let tasks = packs.par_chunks_mut(BLOCKS_PER_TASK).zip(ids.par_chunks(BLOCKS_PER_TASK));
        tasks.for_each(|(packs, ids)| dispatch(Pack { field: self, ids, packs }));
        for (id, packs) in ids.into_iter().zip(packs) {
            let block = &mut self.blocks[id];
            for (scale, packed) in packs.into_iter().enumerate() {
                let Some(packed) = packed else { continue };
                self.voxels.remove(scale, block.data[scale]);
                if block.shade[scale] != NONE {
                    self.shades.remove(scale, block.shade[scale]);
                    block.shade[scale] = PACKED_TOO;
                }
                (block.data[scale], block.packed[scale]) = (self.resting.insert(packed), true);
            }
        }
    }

    /// Takes the memory that holds nothing: while the field changes what it has to spare, and all when it has come to rest.
    pub(crate) fn take_spare(&mut self) -> (Spare<Voxel>, Spare<u8>) {
        (self.voxels.take_spare(), self.shades.take_spare())
    }

    /// Adds memory to spare, taken from another field.
    pub(crate) fn lend(&mut self, (voxels, shades): (Spare<Voxel>, Spare<u8>)) {
        self.voxels.lend(voxels);
        self.shades.lend(shades);
    }
}

/// Unpacks arrays, each into slots of its own.
struct Unpack<'a> {
    waking: &'a [Waking],
    voxels: &'a StoreCells<'a, Voxel>,
    shades: &'a StoreCells<'a, u8>,
}

impl Kernel for Unpack<'_> {
    #[inline(always)]
    #[allow(unsafe_code)]
    fn run(self) {
        for (i, array) in self.waking.iter().enumerate() {
            if let Some(next) = self.waking.get(i + 1) {
                next.packed.ask_for();
                for line in 0..(size_of::<Voxel>() * voxels_at(next.scale)).div_ceil(LINE) {
                    prefetch(self.voxels.address(next.scale, next.voxels).cast::<u8>().wrapping_add(LINE * line));
                }
            }
            // SAFETY: every slot was handed out just now, for one array each.
            unsafe {
                array.packed.unpack(array.scale, self.voxels.get(array.scale, array.voxels));
                if array.shades != NONE {
                    array.packed.unpack_shades(array.scale, self.shades.get(array.scale, array.shades));
                }
            }
        }
    }
}

/// Packs the arrays of blocks.
struct Pack<'a> {
    field: &'a TsdfField,
    ids: &'a [u32],
    packs: &'a mut [Packs],
}

impl Kernel for Pack<'_> {
    #[inline(always)]
    fn run(self) {
        let TsdfField { blocks, voxels, shades, .. } = self.field;
        for (i, (&id, packs)) in self.ids.iter().zip(self.packs).enumerate() {
            if let Some(&next) = self.ids.get(i + 1) {
                ask_for(self.field, &blocks[next]);
            }
            let block = &blocks[id];
            for (scale, pack) in packs.iter_mut().enumerate() {
                if block.data[scale] != NONE && !block.packed[scale] {
                    let shades = if block.shade[scale] == NONE { None } else { Some(shades.get(scale, block.shade[scale])) };
                    *pack = Some(Packed::new(voxels.get(scale, block.data[scale]), shades));
                }
            }
        }
    }
}

/// Asks for the arrays of `block` to be brought near.
#[inline(always)]
fn ask_for(field: &TsdfField, block: &Block) {
    for scale in 0..=COARSEST_PACKED {
        if block.data[scale] != NONE && !block.packed[scale] {
            for line in field.voxels.get(scale, block.data[scale]).chunks(LINE / size_of::<Voxel>()) {
                prefetch(line.as_ptr());
            }
            if block.shade[scale] != NONE {
                for line in field.shades.get(scale, block.shade[scale]).chunks(LINE) {
                    prefetch(line.as_ptr());
                }
            }
        }
    }
}
