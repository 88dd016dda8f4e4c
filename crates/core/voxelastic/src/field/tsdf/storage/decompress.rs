//! Reading voxels of a TSDF, whether their bricks are resident or compressed.

use crate::field::tsdf::block::{Array, Block};
use crate::field::tsdf::brick::{BRICK, BrickHandle, BrickState, brick_and_index, spread};
use crate::field::tsdf::field::TsdfField;
use crate::field::tsdf::voxel::Voxel;
use crate::octree::{prefetch_item, voxels_at};
use std::borrow::Borrow;

impl TsdfField {
    /// Bit set of the octants of `block` in which its current array has observed voxels.
    pub(crate) fn observed_octants(&self, block: &Block) -> u8 {
        let bricks = &block.bricks[block.current().bricks()];
        if block.scale == 0 {
            // A brick is an octant.
            let is_observed = |brick: &BrickHandle| match brick.state() {
                BrickState::Absent => false,
                BrickState::Resident(slot) => self.bricks[slot].observed() != 0,
                BrickState::Compressed(number) => self.compressed.get(number).observed() != 0,
            };
            return bricks.iter().zip(0..).fold(0, |octants, (brick, bit)| octants | u8::from(is_observed(brick)) << bit);
        }
        let observed = match bricks[0].state() {
            BrickState::Absent => 0,
            BrickState::Resident(slot) => self.bricks[slot].observed(),
            BrickState::Compressed(number) => self.compressed.get(number).observed(),
        };
        match block.scale {
            1 => (0..8).fold(0, |octants, bit| {
                // An octant is two voxels along each axis.
                let first = 2 * (bit & 1) + 8 * (bit >> 1 & 1) + 32 * (bit >> 2);
                octants | u8::from(observed >> first & 0x33_0033 != 0) << bit
            }),
            2 => observed as u8,
            _ => u8::from(observed != 0) * u8::MAX,
        }
    }

    /// Prefetches the bricks of all arrays of block `id`.
    pub(crate) fn prefetch_stored(&self, id: u32) {
        for brick in &self.block(id).bricks {
            match brick.state() {
                BrickState::Absent => {}
                BrickState::Resident(slot) => prefetch_item(&raw const self.bricks[slot]),
                BrickState::Compressed(number) => self.compressed.prefetch(number),
            }
        }
    }

    /// The voxels of `block` at its current scale, in the order of [`voxel_index`](crate::octree::voxel_index).
    pub fn current(&self, block: &Block) -> Vec<Voxel> {
        self.voxels(block, block.current())
    }

    /// The voxels of an array of `block`.
    pub(crate) fn voxels(&self, block: &Block, array: Array) -> Vec<Voxel> {
        let mut voxels = vec![Voxel::default(); voxels_at(array.scale())];
        self.copy(block, array, &mut voxels);
        voxels
    }

    /// Copies an array of `block` into `voxels`, which has its length.
    #[inline]
    pub(crate) fn copy(&self, block: &Block, array: Array, voxels: &mut [Voxel]) {
        assemble(block, array, |slot| &self.bricks[slot].voxels, |number| self.compressed.get(number).voxels(), voxels);
    }

    /// Voxel `index` of `block` at its current scale, see [`voxel_index`](crate::octree::voxel_index).
    #[inline]
    pub fn voxel(&self, block: &Block, index: usize) -> Voxel {
        let (brick, index) = brick_and_index(usize::from(block.scale), index);
        match block.bricks[block.current().bricks().start + brick].state() {
            BrickState::Absent => Voxel::default(),
            BrickState::Resident(slot) => self.bricks[slot].voxels[index],
            BrickState::Compressed(number) => self.compressed.get(number).voxel(index),
        }
    }

    /// Whether the voxels of `block` have intensities.
    #[inline(always)]
    pub fn has_intensity(&self, block: &Block) -> bool {
        block.has_intensity
    }

    /// Intensity of voxel `index` of `block` at its current scale, 1 to 255; 0 means unknown. The block must have intensities.
    #[inline]
    pub fn intensity(&self, block: &Block, index: usize) -> u8 {
        let (brick, index) = brick_and_index(usize::from(block.scale), index);
        match block.bricks[block.current().bricks().start + brick].state() {
            BrickState::Absent => 0,
            BrickState::Resident(slot) => self.bricks[slot].intensities[index],
            BrickState::Compressed(number) => self.compressed.get(number).intensity(index),
        }
    }

    /// The intensities at `scale` of a block with intensities.
    pub(crate) fn intensities(&self, block: &Block, scale: usize) -> Vec<u8> {
        let mut intensities = vec![0; voxels_at(scale)];
        self.copy_intensities(block, scale, &mut intensities);
        intensities
    }

    /// Copies the intensities at `scale` of a block with intensities into `intensities`, which has their length.
    pub(crate) fn copy_intensities(&self, block: &Block, scale: usize, intensities: &mut [u8]) {
        let resident = |slot| &self.bricks[slot].intensities;
        assemble(block, Array::Data(scale), resident, |number| self.compressed.get(number).intensities(), intensities);
    }
}

/// Assembles an array from its bricks.
#[inline(always)]
pub(crate) fn assemble<T: Copy + Default, R: Borrow<[T; BRICK]>>(
    block: &Block,
    array: Array,
    resident: impl Fn(u32) -> R,
    compressed: impl Fn(u32) -> [T; BRICK],
    values: &mut [T],
) {
    values.fill(T::default());
    for (k, brick) in block.bricks[array.bricks()].iter().enumerate() {
        match brick.state() {
            BrickState::Absent => {}
            BrickState::Resident(slot) => spread(resident(slot).borrow(), k, array.scale(), values),
            BrickState::Compressed(number) => spread(&compressed(number), k, array.scale(), values),
        }
    }
}
