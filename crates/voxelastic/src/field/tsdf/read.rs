//! Reading a TSDF's voxels, whether they are awake or at rest.

use super::blocks::{Array, Block, TsdfField};
use super::brick::{BRICK, Handle, Whereabouts, place_of, spread};
use super::voxel::Voxel;
use crate::octree::voxels_at;

impl TsdfField {
    /// The octants of `block` in which its current array has observed voxels, a bit each.
    pub(crate) fn observed_octants(&self, block: &Block) -> u8 {
        let bricks = &block.bricks[block.current().bricks()];
        if block.scale == 0 {
            // A brick is an octant, and at rest if it holds anything.
            let is_observed = |brick: &Handle| match brick.whereabouts() {
                Whereabouts::Nowhere => false,
                Whereabouts::Awake(slot) => self.bricks[slot].observed() != 0,
                Whereabouts::Resting(_) => true,
            };
            return bricks.iter().zip(0..).fold(0, |octants, (brick, bit)| octants | u8::from(is_observed(brick)) << bit);
        }
        let held = match bricks[0].whereabouts() {
            Whereabouts::Nowhere => 0,
            Whereabouts::Awake(slot) => self.bricks[slot].observed(),
            Whereabouts::Resting(piece) => self.pieces.get(piece).held(),
        };
        match block.scale {
            1 => (0..8).fold(0, |octants, bit| {
                // Two voxels along each axis.
                let first = 2 * (bit & 1) + 8 * (bit >> 1 & 1) + 32 * (bit >> 2);
                octants | u8::from(held >> first & 0x33_0033 != 0) << bit
            }),
            2 => held as u8,
            _ => u8::from(held != 0) * u8::MAX,
        }
    }

    /// The array that `block` is integrated into.
    pub fn current(&self, block: &Block) -> Vec<Voxel> {
        self.voxels(block, block.current())
    }

    /// An array of `block`.
    pub(crate) fn voxels(&self, block: &Block, array: Array) -> Vec<Voxel> {
        let mut voxels = vec![Voxel::default(); voxels_at(array.scale())];
        self.copy(block, array, &mut voxels);
        voxels
    }

    /// Copies an array of `block` into `voxels`, which is as long.
    #[inline]
    pub(crate) fn copy(&self, block: &Block, array: Array, voxels: &mut [Voxel]) {
        assemble(block, array, |slot| &self.bricks[slot].voxels, |piece| self.pieces.get(piece).voxels(), voxels);
    }

    /// Voxel `index` of the array that `block` is integrated into.
    #[inline]
    pub fn voxel(&self, block: &Block, index: usize) -> Voxel {
        let (brick, place) = place_of(usize::from(block.scale), index);
        match block.bricks[block.current().bricks().start + brick].whereabouts() {
            Whereabouts::Nowhere => Voxel::default(),
            Whereabouts::Awake(slot) => self.bricks[slot].voxels[place],
            Whereabouts::Resting(piece) => self.pieces.get(piece).voxel(place),
        }
    }

    /// Whether the scans that made `block` had intensities.
    #[inline(always)]
    pub fn is_shaded(&self, block: &Block) -> bool {
        block.shaded
    }

    /// Intensity of voxel `index` of the array that a block with intensities is integrated into, 1 to 255; 0 where it is unknown.
    #[inline]
    pub fn shade(&self, block: &Block, index: usize) -> u8 {
        let (brick, place) = place_of(usize::from(block.scale), index);
        match block.bricks[block.current().bricks().start + brick].whereabouts() {
            Whereabouts::Nowhere => 0,
            Whereabouts::Awake(slot) => self.bricks[slot].shades[place],
            Whereabouts::Resting(piece) => self.pieces.get(piece).shade(place),
        }
    }

    /// Intensities of the array of a block with intensities at `scale`.
    pub(crate) fn shades(&self, block: &Block, scale: usize) -> Vec<u8> {
        let mut shades = vec![0; voxels_at(scale)];
        self.copy_shades(block, scale, &mut shades);
        shades
    }

    /// Copies the intensities of the array of a block with intensities at `scale` into `shades`, which is as long.
    pub(crate) fn copy_shades(&self, block: &Block, scale: usize, shades: &mut [u8]) {
        let awake = |slot| &self.bricks[slot].shades;
        assemble(block, Array::Data(scale), awake, |piece| self.pieces.get(piece).shades(), shades);
    }
}

/// Puts an array together from its bricks.
#[inline(always)]
pub(super) fn assemble<'a, T: Copy + Default + 'a>(
    block: &Block,
    array: Array,
    awake: impl Fn(u32) -> &'a [T; BRICK],
    resting: impl Fn(u32) -> [T; BRICK],
    values: &mut [T],
) {
    values.fill(T::default());
    for (k, brick) in block.bricks[array.bricks()].iter().enumerate() {
        match brick.whereabouts() {
            Whereabouts::Nowhere => {}
            Whereabouts::Awake(slot) => spread(awake(slot), k, array.scale(), values),
            Whereabouts::Resting(piece) => spread(&resting(piece), k, array.scale(), values),
        }
    }
}
