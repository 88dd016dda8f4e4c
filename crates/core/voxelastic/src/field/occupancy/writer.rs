//! Writing to an occupancy field from several threads: tasks write the voxels of blocks of their own, and any thread may write octants.
//!
//! [`OccupancyField::write_blocks`] divides a list of distinct blocks among tasks, each with a [`BlockWriter`]. Octants are smaller than a cache line and written once each
//! in no order that tasks could own, so [`SharedOctants`] reads and writes them as relaxed atomics: plain moves for the processor, and no data race whatever tasks do.
#![allow(unsafe_code)]

use super::field::{OccupancyBlock, OccupancyField};
use super::value::Summary;
use crate::field::block_store::BlockStore;
use crate::octree::{DisjointMut, Octant, Octree, Pool, assert_distinct, prefetch, voxels_at};
use rayon::prelude::*;
use std::mem::offset_of;
use std::sync::atomic::{AtomicBool, AtomicI8, AtomicU32, Ordering::Relaxed};

impl OccupancyField {
    /// Runs `task` for consecutive parts of `blocks`, a list of block ids, each of up to `blocks_per_task`, in parallel. The task gets the part's item of
    /// `outputs` and write access to the part's blocks.
    ///
    /// # Panics
    /// If a block does not exist, or occurs more than once.
    pub(crate) fn write_blocks<O: Send>(
        &mut self,
        blocks: &[u32],
        blocks_per_task: usize,
        outputs: impl IndexedParallelIterator<Item = O>,
        task: impl Fn(BlockWriter<'_>, O) + Sync + Send,
    ) {
        assert_distinct(blocks, self.blocks.capacity_used());
        let (blocks_of_field, voxels) = (&self.blocks, VoxelArrays::new(&mut self.voxels));
        let parts = blocks.par_chunks(blocks_per_task).zip(outputs).with_max_len(1);
        parts.for_each(|(ids, output)| task(BlockWriter { blocks: blocks_of_field, voxels: &voxels, ids }, output));
    }
}

/// Write access to the voxels of some blocks of an [`OccupancyField`]. Blocks are addressed by their position in the task's part of the list.
pub(crate) struct BlockWriter<'w> {
    blocks: &'w Pool<OccupancyBlock>,
    voxels: &'w VoxelArrays<'w>,
    /// The ids of the blocks. No other writer has any of them.
    ids: &'w [u32],
}

impl BlockWriter<'_> {
    /// Block number `i`.
    #[inline(always)]
    pub fn block(&self, i: usize) -> &OccupancyBlock {
        &self.blocks[self.ids[i]]
    }

    /// The voxels of block number `i` at its scale, as [`OccupancyField::values`].
    #[inline(always)]
    pub fn values_mut(&mut self, i: usize) -> &mut [i8] {
        let OccupancyBlock { scale, slot, .. } = *self.block(i);
        // SAFETY: an array belongs to one block, the block to this writer, and the writer is borrowed while the reference lives.
        unsafe { self.voxels.get(scale.into(), slot) }
    }
}

/// The arrays of a [`BlockStore`], borrowed for writing to different ones from several threads.
struct VoxelArrays<'f> {
    fine: DisjointMut<'f, [i8; voxels_at(0)]>,
    half: DisjointMut<'f, [i8; voxels_at(1)]>,
    quarter: DisjointMut<'f, [i8; voxels_at(2)]>,
    single: DisjointMut<'f, [i8; voxels_at(3)]>,
}

impl<'f> VoxelArrays<'f> {
    fn new(store: &'f mut BlockStore<i8>) -> Self {
        Self {
            fine: DisjointMut::new(&mut store.fine),
            half: DisjointMut::new(&mut store.half),
            quarter: DisjointMut::new(&mut store.quarter),
            single: DisjointMut::new(&mut store.single),
        }
    }

    /// The array in `slot` at `scale`.
    ///
    /// # Safety
    /// As for [`DisjointMut::get`]: no other reference to the same array may be obtained while this one lives.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    unsafe fn get(&self, scale: usize, slot: u32) -> &mut [i8] {
        // SAFETY: the caller's promise is that of `DisjointMut::get`.
        unsafe {
            match scale {
                0 => self.fine.get(slot),
                1 => self.half.get(slot),
                2 => self.quarter.get(slot),
                _ => self.single.get(slot),
            }
        }
    }
}

/// The octants of a tree, borrowed for reading and writing from several threads. What a thread reads while another writes the same octant may be of both, old and new.
pub(crate) struct SharedOctants<'f>(DisjointMut<'f, [Octant<Summary>; 8]>);

/// An octant as atomics.
#[repr(C)]
struct AtomicOctant {
    link: AtomicU32,
    value: AtomicI8,
    max: AtomicI8,
    observed: AtomicBool,
}

const _: () = {
    type Plain = Octant<Summary>;
    assert!(size_of::<AtomicOctant>() == size_of::<Plain>() && align_of::<AtomicOctant>() == align_of::<Plain>());
    assert!(offset_of!(AtomicOctant, link) == offset_of!(Plain, link));
    assert!(offset_of!(AtomicOctant, value) == offset_of!(Plain, payload) + offset_of!(Summary, value));
    assert!(offset_of!(AtomicOctant, max) == offset_of!(Plain, payload) + offset_of!(Summary, max));
    assert!(offset_of!(AtomicOctant, observed) == offset_of!(Plain, payload) + offset_of!(Summary, observed));
};

impl<'f> SharedOctants<'f> {
    /// Borrows the octants of `tree`.
    pub fn new(tree: &'f mut Octree<Summary>) -> Self {
        Self(tree.disjoint_mut())
    }

    /// The octant number `index` of group `group`.
    ///
    /// # Panics
    /// If the group was never allocated, or `index` is not below 8.
    #[inline(always)]
    fn octant(&self, (group, index): (u32, usize)) -> &AtomicOctant {
        assert!(index < 8);
        let octant = self.0.item(group).cast::<AtomicOctant>().wrapping_add(index);
        // SAFETY: the octant exists while the tree is borrowed, is laid out as an `AtomicOctant`, and is accessed as one only.
        unsafe { &*octant }
    }

    /// Prefetches an octant; does nothing for one that does not exist.
    #[inline(always)]
    pub fn prefetch(&self, (group, index): (u32, usize)) {
        prefetch(self.0.address(group).cast::<AtomicOctant>().wrapping_add(index));
    }

    /// The summary of an octant.
    #[inline(always)]
    pub fn summary(&self, at: (u32, usize)) -> Summary {
        let octant = self.octant(at);
        Summary { value: octant.value.load(Relaxed), max: octant.max.load(Relaxed), observed: octant.observed.load(Relaxed) }
    }

    /// Sets the summary of an octant.
    #[inline(always)]
    pub fn set_summary(&self, at: (u32, usize), summary: Summary) {
        let octant = self.octant(at);
        octant.value.store(summary.value, Relaxed);
        octant.max.store(summary.max, Relaxed);
        octant.observed.store(summary.observed, Relaxed);
    }

    /// Sets the link of an octant.
    #[inline(always)]
    pub fn set_link(&self, at: (u32, usize), link: u32) {
        self.octant(at).link.store(link, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{Cursor, NONE};

    /// A field with a block for each key below `count`, at scales that take turns, and the ids of the blocks.
    fn field_of(count: u64) -> (OccupancyField, Vec<u32>) {
        let mut field = OccupancyField::default();
        field.tree.grow_over(0..count);
        let mut cursor = Cursor::new(&field.tree);
        let ids = (0..count).map(|key| field.find_or_create(&mut cursor, key, (key % 4) as usize)).collect();
        (field, ids)
    }

    #[test]
    fn tasks_write_to_blocks_of_their_own() {
        let (mut field, ids) = field_of(200);
        let (mut slow, _) = field_of(200);
        let written: Vec<u32> = ids.iter().copied().filter(|id| id % 3 != 1).rev().collect();
        let value = |key: u64, voxel: usize| (key as usize * 7 + voxel) as i8;
        let mut keys = vec![Vec::new(); written.len().div_ceil(7)];
        field.write_blocks(&written, 7, keys.par_iter_mut(), |mut writer, keys| {
            for i in 0..writer.ids.len() {
                let key = writer.block(i).key;
                writer.values_mut(i).iter_mut().enumerate().for_each(|(voxel, v)| *v = value(key, voxel));
                keys.push(key);
            }
        });
        for &id in &written {
            let OccupancyBlock { key, slot, scale } = slow.blocks[id];
            slow.voxels.get_mut(scale.into(), slot).iter_mut().enumerate().for_each(|(voxel, v)| *v = value(key, voxel));
        }
        assert!(ids.iter().all(|&id| field.values(field.block(id)) == slow.values(slow.block(id))));
        assert_eq!(keys.concat(), written.iter().map(|&id| slow.block(id).key).collect::<Vec<_>>());
    }

    #[test]
    #[should_panic(expected = "is written to twice")]
    fn a_block_cannot_be_written_to_twice() {
        let (mut field, ids) = field_of(9);
        let twice = [ids[2], ids[5], ids[2]];
        field.write_blocks(&twice, 2, (0..2usize).into_par_iter(), |_, _| {});
    }

    #[test]
    fn octants_written_by_threads_equal_those_written_by_one() {
        let (mut field, _) = field_of(512);
        let mut slow = field.clone();
        let summary =
            |group: u32, index: usize| Summary { value: group as i8, max: index as i8, observed: (group as usize + index).is_multiple_of(2) };
        let groups = 64;
        let octants = SharedOctants::new(&mut field.tree);
        (0..groups).into_par_iter().for_each(|group| {
            for index in (0..8).filter(|index| index % 3 != 1) {
                octants.set_summary((group, index), summary(group, index));
                assert_eq!(octants.summary((group, index)), summary(group, index));
                octants.set_link((group, index), NONE);
            }
        });
        for group in 0..groups {
            for index in (0..8).filter(|index| index % 3 != 1) {
                slow.tree.siblings_mut(group)[index] = Octant { link: NONE, payload: summary(group, index) };
            }
        }
        assert!((0..groups).all(|group| field.tree.siblings(group) == slow.tree.siblings(group)));
    }

    #[test]
    #[should_panic(expected = "never allocated")]
    fn a_missing_octant_is_refused() {
        let (mut field, _) = field_of(9);
        SharedOctants::new(&mut field.tree).summary((1 << 24, 0));
    }
}
