//! The TSDF of a submap: an octree of [`Block`]s over bricks of voxels, and how it changes the scale and the arrays of a block.

use super::block::{Array, Block, block_and_brick, owner};
use super::brick::{Brick, BrickHandle, BrickState};
use super::colour::ColourLayer;
use super::storage::brick_codec::EncodedArray;
use super::storage::change_log::ChangeLog;
use super::storage::compressed_store::CompressedStore;
use crate::octree::{Cursor, NONE, Octree, Pool, SCALES, Slab};
use std::ops::Range;

/// A truncated signed distance field over an octree of blocks, in the frame of a submap.
#[derive(Clone, Debug, Default)]
pub struct TsdfField {
    pub(crate) tree: Octree<()>,
    pub(crate) blocks: Pool<Block>,
    /// Decoded bricks, the only ones that can be written to. Owners are encoded by [`owner`].
    pub(crate) bricks: Slab<Brick>,
    /// Compressed bricks, with the same owners.
    pub(crate) compressed: CompressedStore,
    pub(crate) change_log: ChangeLog,
    pub(crate) colours: ColourLayer,
}

impl TsdfField {
    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.blocks.live()
    }

    /// Whether the field has no blocks.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Morton keys of the blocks that scans changed after the count of changes was `clock`.
    pub(crate) fn changed_since(&self, clock: u32) -> impl Iterator<Item = u64> {
        self.ids().map(|id| self.block(id)).filter(move |block| block.changed.wrapping_sub(clock) as i32 > 0).map(|block| block.key)
    }

    /// The octree over the blocks.
    pub fn tree(&self) -> &Octree<()> {
        &self.tree
    }

    /// The block with id `id`.
    #[inline(always)]
    pub fn block(&self, id: u32) -> &Block {
        &self.blocks[id]
    }

    /// Ids of all blocks. They are consecutive, because blocks are never removed.
    pub fn ids(&self) -> Range<u32> {
        0..self.blocks.capacity_used()
    }

    /// The id of the block with Morton key `key`, if it exists.
    pub fn find(&self, key: u64) -> Option<u32> {
        self.tree.block(key)
    }

    /// The colour layer; empty if no scan had colours.
    pub fn colours(&self) -> &ColourLayer {
        &self.colours
    }

    /// Returns the id of block `key`, which is created at `scale` if it does not exist, and whether it is new. The tree's root must cover
    /// the key.
    pub(crate) fn find_or_create(&mut self, cursor: &mut Cursor, key: u64, scale: u8, has_intensity: bool) -> (u32, bool) {
        let (group, index) = cursor.find_or_create(&mut self.tree, key);
        let link = self.tree.siblings(group)[index].link;
        if link != NONE {
            return (link, false);
        }
        let id = self.blocks.insert(Block::new(key, scale, scale, has_intensity));
        self.tree.siblings_mut(group)[index].link = id;
        (id, true)
    }

    /// Makes block `id` one scale coarser. The caller fills its data and base arrays there.
    pub(crate) fn go_coarser(&mut self, id: u32) {
        self.blocks[id].scale += 1;
    }

    /// Makes block `id` one scale finer. The caller fills its data array there if it is new, and then calls
    /// [`release_coarser`](Self::release_coarser).
    pub(crate) fn go_finer(&mut self, id: u32) {
        let block = &mut self.blocks[id];
        block.scale -= 1;
        block.finest = block.finest.min(block.scale);
    }

    /// Frees the arrays of block `id` that are coarser than its scale.
    pub(crate) fn release_coarser(&mut self, id: u32) {
        for scale in usize::from(self.blocks[id].scale) + 1..SCALES {
            self.clear_array(id, Array::Data(scale));
            self.clear_array(id, Array::Base(scale));
        }
    }

    /// Frees all bricks of `array` of block `id`.
    pub(crate) fn clear_array(&mut self, id: u32, array: Array) {
        for brick in array.bricks() {
            let handle = std::mem::replace(&mut self.blocks[id].bricks[brick], BrickHandle::ABSENT);
            self.release_brick(handle);
        }
    }

    /// Frees the storage of a brick.
    fn release_brick(&mut self, handle: BrickHandle) {
        match handle.state() {
            BrickState::Absent => {}
            BrickState::Resident(slot) => self.bricks.remove(slot),
            BrickState::Compressed(number) => self.remove_compressed(number),
        }
    }

    /// Removes compressed brick `number`, which no block refers to any more.
    pub(crate) fn remove_compressed(&mut self, number: u32) {
        if let Some(moved) = self.compressed.remove(number) {
            let (id, brick) = block_and_brick(moved);
            self.blocks[id].bricks[brick] = BrickHandle::compressed(number);
        }
    }

    /// Replaces the content of `array` of block `id` by `encoded`, as compressed bricks. `encoded` has intensities if the block has and
    /// `array` is a data array.
    pub(crate) fn store(&mut self, id: u32, array: Array, encoded: &EncodedArray) {
        self.clear_array(id, array);
        for (brick, words) in array.bricks().zip(encoded.bricks()).filter(|(_, words)| !words.is_empty()) {
            self.blocks[id].bricks[brick] = BrickHandle::compressed(self.compressed.insert(owner(id, brick), words));
        }
    }

    /// Makes `encoded` the only array of block `id`, at `scale`.
    pub(crate) fn install(&mut self, id: u32, scale: usize, encoded: &EncodedArray) {
        (0..SCALES).for_each(|scale| self.clear_array(id, Array::Data(scale)));
        (1..SCALES).for_each(|scale| self.clear_array(id, Array::Base(scale)));
        let block = &mut self.blocks[id];
        (block.scale, block.finest, block.has_intensity) = (scale as u8, scale as u8, encoded.has_intensity());
        self.store(id, Array::Data(scale), encoded);
    }

    /// Number of arrays at each scale, base arrays included.
    pub fn arrays(&self) -> [usize; SCALES] {
        let mut arrays = [0; SCALES];
        for id in self.ids() {
            let (scale, finest) = (usize::from(self.blocks[id].scale), usize::from(self.blocks[id].finest));
            arrays[finest..=scale].iter_mut().for_each(|count| *count += 1);
            arrays[finest + 1..=scale].iter_mut().for_each(|count| *count += 1);
        }
        arrays
    }

    /// Number of blocks whose current scale is each of the scales.
    pub fn blocks_by_scale(&self) -> [usize; SCALES] {
        let mut counts = [0; SCALES];
        self.ids().for_each(|id| counts[usize::from(self.blocks[id].scale)] += 1);
        counts
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.tree.bytes() + self.blocks.bytes() + self.bricks.bytes() + self.compressed.bytes() + self.change_log.bytes() + self.colours.bytes()
    }

    /// A field of `count` blocks at scale 0 with intensities and without bricks.
    #[cfg(test)]
    pub(crate) fn of_empty_blocks(count: u64) -> Self {
        let mut field = Self::default();
        field.tree.grow_over(0..count);
        let mut cursor = Cursor::new(&field.tree);
        for key in 0..count {
            field.find_or_create(&mut cursor, key, 0, true);
        }
        field
    }

    /// Fails unless every stored brick belongs to an array that its block has.
    #[cfg(test)]
    pub(crate) fn assert_invariants(&self) {
        let (mut resident, mut compressed) = (0, 0);
        for id in self.ids() {
            let block = self.block(id);
            let (scale, finest) = (usize::from(block.scale), usize::from(block.finest));
            let has = |array: Array| (finest + usize::from(matches!(array, Array::Base(_)))..=scale).contains(&array.scale());
            for array in (0..SCALES).map(Array::Data).chain((1..SCALES).map(Array::Base)) {
                for brick in array.bricks() {
                    let handle = block.bricks[brick];
                    assert!(has(array) || handle == BrickHandle::ABSENT, "{array:?} of a block with scales {finest} to {scale}");
                    match handle.state() {
                        BrickState::Absent => {}
                        BrickState::Resident(slot) => {
                            assert_eq!(self.bricks.owner(slot), Some(owner(id, brick)));
                            resident += 1;
                        }
                        BrickState::Compressed(_) => compressed += 1,
                    }
                }
            }
        }
        assert_eq!([self.bricks.live(), self.compressed.live()], [resident, compressed]);
    }
}
