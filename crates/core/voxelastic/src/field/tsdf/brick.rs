//! A brick: 4 x 4 x 4 voxels of a block, the unit of storage and compression.
//!
//! An array at scale 0 has eight bricks, a coarser one has one. A surface with its truncation band does not fill a block: of the eight
//! bricks of a fine array, four or five are ever written to. The others are not stored.

use super::voxel::Voxel;
use crate::octree::voxels_at;
use bytemuck::{Pod, Zeroable};

/// Number of voxels in a brick.
pub(crate) const BRICK: usize = 64;
/// Number of bricks in an array at scale 0.
pub(crate) const BRICKS: usize = voxels_at(0) / BRICK;

/// The voxels of a brick and their intensities, x fastest. Arrays at scales 2 and 3 use only the first 8 and 1.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Brick {
    pub voxels: [Voxel; BRICK],
    pub intensities: [u8; BRICK],
}

impl Brick {
    /// Bit set of the observed voxels.
    #[inline]
    pub fn observed(&self) -> u64 {
        self.voxels.iter().rev().fold(0, |observed, voxel| observed << 1 | u64::from(voxel.is_observed()))
    }
}

/// Reference to a stored brick: none, a slot of the field's slab, or a number in its compressed store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BrickHandle(u32);

/// A decoded [`BrickHandle`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BrickState {
    /// The brick is not stored: its voxels are all unobserved.
    Absent,
    /// Decoded, in this slot of the slab.
    Resident(u32),
    /// Encoded, with this number in the compressed store.
    Compressed(u32),
}

impl BrickHandle {
    const COMPRESSED_BIT: u32 = 1 << 31;
    /// Slots and numbers of compressed bricks are below this.
    pub const MAX: u32 = Self::COMPRESSED_BIT - 1;
    /// Handle of a brick that is not stored.
    pub const ABSENT: Self = Self(u32::MAX);

    /// Handle of the brick in `slot`.
    #[inline(always)]
    pub fn resident(slot: u32) -> Self {
        debug_assert!(slot < Self::MAX);
        Self(slot)
    }

    /// Handle of compressed brick `number`.
    #[inline(always)]
    pub fn compressed(number: u32) -> Self {
        debug_assert!(number < Self::MAX);
        Self(number | Self::COMPRESSED_BIT)
    }

    /// Where the brick is stored.
    #[inline(always)]
    pub fn state(self) -> BrickState {
        match self.0 {
            u32::MAX => BrickState::Absent,
            slot if slot < Self::COMPRESSED_BIT => BrickState::Resident(slot),
            number => BrickState::Compressed(number & !Self::COMPRESSED_BIT),
        }
    }

    /// The brick's slot, if it is resident.
    #[inline(always)]
    pub fn slot(self) -> Option<u32> {
        (self.0 < Self::COMPRESSED_BIT).then_some(self.0)
    }
}

/// Bits of a voxel's address within its array: its index in its brick, and the brick above that.
pub(crate) const ADDRESS_BITS: u32 = (BRICK * BRICKS).ilog2();

/// Address of voxel `index` of an array: its brick times [`BRICK`] plus its index in the brick. `fine` has all bits set for an array at
/// scale 0, and none for coarser ones, which have one brick. Shifts and masks only, so that it vectorises.
#[inline(always)]
pub(crate) const fn brick_address(fine: u32, index: u32) -> u32 {
    // Of the three bits of an axis, the lower two count within the brick, and the highest one selects the brick.
    let x = index & 0o3 | (index & 0o4) << 4;
    let y = (index & 0o30) >> 1 | (index & 0o40) << 2;
    let z = (index & 0o300) >> 2 | index & 0o400;
    (x | y | z) & fine | index & !fine
}

/// Brick of voxel `index` of an array at `scale`, and the voxel's index in it.
#[inline(always)]
pub(crate) fn brick_and_index(scale: usize, index: usize) -> (usize, usize) {
    let address = brick_address(u32::from(scale == 0).wrapping_neg(), index as u32) as usize;
    (address / BRICK, address % BRICK)
}

/// Index in an array at scale 0 of the first voxel of row `row` of brick `brick`; a row is four voxels along x.
#[inline(always)]
const fn row_start(brick: usize, row: usize) -> usize {
    let (x, y, z) = (4 * (brick & 1), 4 * (brick >> 1 & 1) + row % 4, 4 * (brick >> 2) + row / 4);
    x | y << 3 | z << 6
}

/// Copies the values of brick `brick` into an array at `scale`.
#[inline(always)]
pub(crate) fn spread<T: Copy>(values: &[T; BRICK], brick: usize, scale: usize, array: &mut [T]) {
    if scale > 0 {
        array.copy_from_slice(&values[..array.len()]);
        return;
    }
    for (row, values) in values.chunks_exact(4).enumerate() {
        array[row_start(brick, row)..][..4].copy_from_slice(values);
    }
}

/// Copies the values of brick `brick` from an array at `scale`; values beyond the end of a coarse array are the default.
#[inline(always)]
pub(crate) fn gather<T: Copy + Default>(array: &[T], scale: usize, brick: usize) -> [T; BRICK] {
    let mut values = [T::default(); BRICK];
    if scale > 0 {
        values[..array.len()].copy_from_slice(array);
        return values;
    }
    for (row, values) in values.chunks_exact_mut(4).enumerate() {
        values.copy_from_slice(&array[row_start(brick, row)..][..4]);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::SCALES;

    #[test]
    fn every_voxel_is_in_one_brick() {
        for scale in 0..SCALES {
            let array: Vec<u32> = (0..voxels_at(scale) as u32).collect();
            let bricks: Vec<[u32; BRICK]> = (0..voxels_at(scale).div_ceil(BRICK)).map(|b| gather(&array, scale, b)).collect();
            let mut back = vec![u32::MAX; array.len()];
            bricks.iter().enumerate().for_each(|(b, values)| spread(values, b, scale, &mut back));
            assert_eq!(back, array);
            for (i, value) in array.iter().enumerate() {
                let (brick, index) = brick_and_index(scale, i);
                assert_eq!(bricks[brick][index], *value, "scale {scale}, voxel {i}");
            }
        }
    }

    #[test]
    fn handles_encode_slots_and_numbers() {
        assert_eq!(BrickHandle::ABSENT.state(), BrickState::Absent);
        assert_eq!(BrickHandle::ABSENT.slot(), None);
        for i in [0, 5, BrickHandle::MAX - 1] {
            assert_eq!(BrickHandle::resident(i).state(), BrickState::Resident(i));
            assert_eq!(BrickHandle::compressed(i).state(), BrickState::Compressed(i));
            assert_eq!([BrickHandle::resident(i).slot(), BrickHandle::compressed(i).slot()], [Some(i), None]);
        }
    }
}
