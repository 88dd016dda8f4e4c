//! Writing to a TSDF from several threads: each writes to blocks of its own, and decodes or creates bricks on demand.
//!
//! [`TsdfField::write_blocks`] divides a list of distinct blocks among tasks. A task gets a [`BlockWriter`], which gives access to the blocks
//! of its part only, so no block is ever accessed by two threads. Bricks are accessed through [`BrickRef`]s: copies of it may refer to
//! the same brick, so voxels are read and written by value, as in a [`Cell`]. Neither type can be sent to another thread.
#![allow(unsafe_code)]

use super::block::{Array, Block, owner};
use super::brick::{BRICK, BRICKS, Brick, BrickHandle, BrickState, gather};
use super::field::TsdfField;
use super::storage::compressed_store::CompressedStore;
use super::storage::decompress::assemble;
use super::voxel::Voxel;
use crate::octree::{DisjointMut, SlabAllocator, SlotBatch, SlotPtr, assert_distinct, prefetch, prefetch_item};
use bytemuck::Zeroable;
use rayon::prelude::*;
use std::cell::Cell;
use std::marker::PhantomData;
use std::ops::Range;

impl TsdfField {
    /// Runs `task` for consecutive parts of `blocks`, a list of block ids, in parallel; each part has up to `blocks_per_task` blocks. The task
    /// gets the part's range of the list, and write access to its blocks.
    ///
    /// # Panics
    /// If a block does not exist, or occurs more than once.
    pub(crate) fn write_blocks(&mut self, blocks: &[u32], blocks_per_task: usize, task: impl Fn(Range<usize>, &mut BlockWriter<'_>) + Sync) {
        assert_distinct(blocks, self.blocks.capacity_used());
        // A block needs at most the bricks of an array at scale 0, also if it changes its scale.
        let bricks = self.bricks.allocator(blocks.len() * BRICKS, blocks.len().div_ceil(blocks_per_task));
        let shared = Shared { blocks: DisjointMut::new(&mut self.blocks), bricks, compressed: &self.compressed };
        let write = |(number, ids): (usize, &[u32])| {
            let mut writer = BlockWriter { field: &shared, ids, decoded: Vec::new(), batch: SlotBatch::default(), not_send: PhantomData };
            let start = number * blocks_per_task;
            task(start..start + ids.len(), &mut writer);
            (writer.decoded, writer.batch)
        };
        let parts: Vec<(Vec<u32>, SlotBatch)> = blocks.par_chunks(blocks_per_task).enumerate().with_max_len(1).map(write).collect();
        let allocated = shared.bricks.allocated();
        let (decoded, batches): (Vec<Vec<u32>>, Vec<SlotBatch>) = parts.into_iter().unzip();
        let mut decoded = decoded.concat();
        // In descending order, so that a removed brick's slot is never taken by one that is removed later.
        decoded.sort_unstable();
        decoded.into_iter().rev().for_each(|number| self.remove_compressed(number));
        self.bricks.finish(allocated, batches);
    }
}

/// The parts of a field that the tasks of a pass share.
struct Shared<'f> {
    blocks: DisjointMut<'f, Block>,
    bricks: SlabAllocator<'f, Brick>,
    compressed: &'f CompressedStore,
}

/// Write access to some blocks of a [`TsdfField`]. Blocks are addressed by their position in the task's part of the list.
pub(crate) struct BlockWriter<'w> {
    field: &'w Shared<'w>,
    /// The ids of the blocks. No other writer has any of them.
    ids: &'w [u32],
    /// Numbers of the compressed bricks that were decoded.
    decoded: Vec<u32>,
    /// Slots reserved for further bricks.
    batch: SlotBatch,
    /// [`BrickRef`]s must stay on the thread of their writer.
    not_send: PhantomData<*const ()>,
}

impl<'w> BlockWriter<'w> {
    /// Prefetches the head of block number `i`; does nothing beyond the last block.
    #[inline(always)]
    pub fn prefetch_block(&self, i: usize) {
        if let Some(&id) = self.ids.get(i) {
            prefetch_item(self.field.blocks.address(id));
        }
    }

    /// Prefetches the compressed bricks of the current array of block number `i`; does nothing beyond the last block.
    #[inline(always)]
    pub fn prefetch_compressed(&self, i: usize) {
        if i < self.ids.len() {
            let block = self.block(i);
            for brick in &block.bricks[block.current().bricks()] {
                if let BrickState::Compressed(number) = brick.state() {
                    self.field.compressed.prefetch(number);
                }
            }
        }
    }

    /// Block number `i`.
    #[inline(always)]
    pub fn block(&self, i: usize) -> &Block {
        // SAFETY: the block exists, only this writer has it, and while the writer is borrowed it makes no mutable reference to it.
        unsafe { &*self.field.blocks.address(self.ids[i]) }
    }

    /// Block number `i`, mutable.
    #[inline(always)]
    pub fn block_mut(&mut self, i: usize) -> &mut Block {
        // SAFETY: only this writer has the block, and it is borrowed while the reference lives.
        unsafe { self.field.blocks.get(self.ids[i]) }
    }

    /// The bricks of the current array of block number `i`; compressed ones are [`BrickRef::NOT_RESIDENT`], absent ones
    /// [`BrickRef::MISSING`].
    #[inline(always)]
    pub fn bricks(&self, i: usize) -> [BrickRef<'w>; BRICKS] {
        let block = self.block(i);
        let mut bricks = [BrickRef::NOT_RESIDENT; BRICKS];
        for (reference, brick) in bricks.iter_mut().zip(&block.bricks[block.current().bricks()]) {
            // Branch-free, because which bricks a block has is unpredictable.
            let resident = self.brick_at(brick.slot().unwrap_or(0));
            let other = if *brick == BrickHandle::ABSENT { BrickRef::MISSING } else { BrickRef::NOT_RESIDENT };
            *reference = if brick.slot().is_some() { resident } else { other };
        }
        bricks
    }

    /// Brick `brick` of block number `i`. It is decoded or created if it is not resident.
    #[cold]
    #[inline(never)]
    pub fn brick(&mut self, i: usize, brick: usize) -> BrickRef<'w> {
        let block = self.block(i);
        let (handle, has_intensity) = (block.bricks[brick], block.brick_has_intensity(brick));
        if let Some(slot) = handle.slot() {
            return self.brick_at(slot);
        }
        let slot = self.field.bricks.allocate(owner(self.ids[i], brick), &mut self.batch);
        let mut content = Brick::zeroed();
        if let BrickState::Compressed(number) = handle.state() {
            let encoded = self.field.compressed.get(number);
            content.voxels = encoded.voxels();
            if has_intensity {
                content.intensities = encoded.intensities();
            }
            self.decoded.push(number);
        }
        self.block_mut(i).bricks[brick] = BrickHandle::resident(slot);
        let reference = self.brick_at(slot);
        reference.write(&content);
        reference
    }

    /// Copies an array of block number `i` into `voxels`, which has its length.
    pub fn copy(&self, i: usize, array: Array, voxels: &mut [Voxel]) {
        let resident = |slot| self.brick_at(slot).read().voxels;
        assemble(self.block(i), array, resident, |number| self.field.compressed.get(number).voxels(), voxels);
    }

    /// Copies the intensities of block number `i` at `scale` into `intensities`, which has their length.
    pub fn copy_intensities(&self, i: usize, scale: usize, intensities: &mut [u8]) {
        let resident = |slot| self.brick_at(slot).read().intensities;
        assemble(self.block(i), Array::Data(scale), resident, |number| self.field.compressed.get(number).intensities(), intensities);
    }

    /// Replaces the content of `array` of block number `i` by `voxels` and `intensities`, which are zero in a block without intensities.
    pub fn store(&mut self, i: usize, array: Array, voxels: &[Voxel], intensities: &[u8]) {
        for (k, brick) in array.bricks().enumerate() {
            let values = Brick { voxels: gather(voxels, array.scale(), k), intensities: gather(intensities, array.scale(), k) };
            if values != Brick::zeroed() || self.block(i).bricks[brick] != BrickHandle::ABSENT {
                self.brick(i, brick).write(&values);
            }
        }
    }

    /// The brick in `slot`, which is one of this writer's blocks.
    #[inline(always)]
    fn brick_at(&self, slot: u32) -> BrickRef<'w> {
        BrickRef { brick: self.field.bricks.items().slot_ptr(slot), writer: PhantomData }
    }
}

/// A resident brick of a block that a [`BlockWriter`] has, or one of two sentinels.
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct BrickRef<'w> {
    brick: SlotPtr<Brick>,
    writer: PhantomData<&'w Cell<Brick>>,
}

/// The voxels of a resident brick, see [`Brick`].
#[repr(C)]
pub(crate) struct BrickCells {
    pub voxels: [Cell<Voxel>; BRICK],
    pub intensities: [Cell<u8>; BRICK],
}

const _: () = assert!(size_of::<BrickCells>() == size_of::<Brick>() && align_of::<BrickCells>() == align_of::<Brick>());

impl<'w> BrickRef<'w> {
    /// Sentinel: the brick is compressed.
    pub const NOT_RESIDENT: Self = Self { brick: SlotPtr::NOT_RESIDENT, writer: PhantomData };
    /// Sentinel: the brick does not exist.
    pub const MISSING: Self = Self { brick: SlotPtr::MISSING, writer: PhantomData };

    /// The brick's voxels; none for a sentinel.
    #[inline(always)]
    pub fn cells(self) -> Option<&'w BrickCells> {
        // SAFETY: a brick belongs to one block, that block to one writer, and both stay on its thread; the writer accesses bricks as cells
        // only. They are laid out like the bricks, which neither move nor end during 'w.
        self.brick.is_item().then(|| unsafe { &*self.brick.address().cast::<BrickCells>() })
    }

    fn read(self) -> Brick {
        self.cells().map_or(Brick::zeroed(), |cells| Brick {
            voxels: std::array::from_fn(|i| cells.voxels[i].get()),
            intensities: std::array::from_fn(|i| cells.intensities[i].get()),
        })
    }

    fn write(self, brick: &Brick) {
        if let Some(cells) = self.cells() {
            cells.voxels.iter().zip(brick.voxels).for_each(|(cell, voxel)| cell.set(voxel));
            cells.intensities.iter().zip(brick.intensities).for_each(|(cell, intensity)| cell.set(intensity));
        }
    }
}

impl BrickCells {
    /// Prefetches voxel `index`, and its intensity if `with_intensity`.
    #[inline(always)]
    pub fn prefetch(&self, index: usize, with_intensity: bool) {
        prefetch(self.voxels[index].as_ptr());
        if with_intensity {
            prefetch(self.intensities[index].as_ptr());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_write_to_blocks_of_their_own() {
        let mut field = TsdfField::of_empty_blocks(100);
        let ids: Vec<u32> = (0..100).filter(|id| id % 3 != 1).rev().collect();
        for round in 0..3u16 {
            field.write_blocks(&ids, 7, |range, writer| {
                for (i, &id) in ids[range].iter().enumerate() {
                    let cells = writer.brick(i, id as usize % BRICKS).cells().expect("a resident brick");
                    let Voxel { weight, .. } = cells.voxels[5].get();
                    assert_eq!(weight, if round == 0 { 0 } else { id as u16 + round });
                    cells.voxels[5].set(Voxel { distance: 7, weight: id as u16 + round + 1 });
                    cells.intensities[5].set(3);
                    writer.block_mut(i).changed = u32::from(round);
                }
            });
            field.assert_invariants();
            if round == 1 {
                field.compact_all();
            }
        }
        for id in field.ids() {
            let observed: Vec<Voxel> = field.current(field.block(id)).into_iter().filter(|voxel| voxel.is_observed()).collect();
            let expected = if id % 3 == 1 { vec![] } else { vec![Voxel { distance: 7, weight: id as u16 + 3 }] };
            assert_eq!(observed, expected);
        }
    }

    #[test]
    #[should_panic(expected = "block 3 is written to twice")]
    fn a_block_cannot_be_written_to_twice() {
        TsdfField::of_empty_blocks(9).write_blocks(&[2, 3, 5, 3], 2, |_, _| {});
    }

    #[test]
    #[should_panic(expected = "block 9 does not exist")]
    fn a_missing_block_cannot_be_written_to() {
        TsdfField::of_empty_blocks(9).write_blocks(&[9], 2, |_, _| {});
    }
}
