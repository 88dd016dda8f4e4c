//! A brick: 4 x 4 x 4 voxels of a block, what is stored and comes to rest as one.
//!
//! A surface with its band passes through a block, it does not fill it: of the eight bricks of a fine array, four or five are ever met. A
//! block at scale 0 has eight, at any coarser scale one. Bricks that hold nothing are not there.

use super::voxel::Voxel;
use crate::octree::voxels_at;
use bytemuck::{Pod, Zeroable};

/// Voxels of a brick.
pub(crate) const BRICK: usize = 64;
/// Bricks of an array at scale 0.
pub(crate) const BRICKS: usize = voxels_at(0) / BRICK;

/// The voxels of a brick and their intensities, x fastest; those of the scales 2 and 3 are the first ones.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Brick {
    pub voxels: [Voxel; BRICK],
    pub shades: [u8; BRICK],
}

impl Brick {
    /// Which voxels are observed, a bit each.
    #[inline]
    pub fn observed(&self) -> u64 {
        self.voxels.iter().rev().fold(0, |observed, voxel| observed << 1 | u64::from(voxel.is_observed()))
    }
}

/// Where a brick is: nowhere, among those that are awake, or among those at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Handle(u32);

/// What a [`Handle`] says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Whereabouts {
    /// The brick holds nothing.
    Nowhere,
    /// In a slot of the slab of bricks.
    Awake(u32),
    /// Among the pieces.
    Resting(u32),
}

impl Handle {
    const AT_REST: u32 = 1 << 31;
    /// Pieces are numbered below this, slots below twice as much.
    pub const MOST: u32 = Self::AT_REST - 1;
    pub const NOWHERE: Self = Self(u32::MAX);

    #[inline(always)]
    pub fn awake(slot: u32) -> Self {
        debug_assert!(slot < Self::MOST);
        Self(slot)
    }

    #[inline(always)]
    pub fn resting(piece: u32) -> Self {
        debug_assert!(piece < Self::MOST);
        Self(piece | Self::AT_REST)
    }

    #[inline(always)]
    pub fn whereabouts(self) -> Whereabouts {
        match self.0 {
            u32::MAX => Whereabouts::Nowhere,
            slot if slot < Self::AT_REST => Whereabouts::Awake(slot),
            piece => Whereabouts::Resting(piece & !Self::AT_REST),
        }
    }

    /// Its slot, if it is awake.
    #[inline(always)]
    pub fn slot(self) -> Option<u32> {
        (self.0 < Self::AT_REST).then_some(self.0)
    }
}

/// Bits of a voxel's place among all bricks of its array: its place in its brick, and the brick above that.
pub(crate) const PLACE_BITS: u32 = (BRICK * BRICKS).ilog2();

/// Where voxel `index` of an array lies: its brick times [`BRICK`], and its place there. `fine` has all bits set for an array at scale 0, and none for
/// others, which have one brick. Shifts and masks only, for lanes of vectors.
#[inline(always)]
pub(crate) const fn place(fine: u32, index: u32) -> u32 {
    // Of three bits an axis, the lower two are the place in the brick and the highest one the brick's.
    let x = index & 0o3 | (index & 0o4) << 4;
    let y = (index & 0o30) >> 1 | (index & 0o40) << 2;
    let z = (index & 0o300) >> 2 | index & 0o400;
    (x | y | z) & fine | index & !fine
}

/// Where voxel `index` of an array at `scale` lies: brick, and place in it.
#[inline(always)]
pub(crate) fn place_of(scale: usize, index: usize) -> (usize, usize) {
    let place = place(u32::from(scale == 0).wrapping_neg(), index as u32) as usize;
    (place / BRICK, place % BRICK)
}

/// Where the row of four voxels numbered `row` of brick `brick` begins in an array at scale 0.
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

/// Copies the values of brick `brick` from an array at `scale`; those that the scale does not have become zero.
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
    fn bricks_hold_every_voxel_once() {
        for scale in 0..SCALES {
            let array: Vec<u32> = (0..voxels_at(scale) as u32).collect();
            let bricks: Vec<[u32; BRICK]> = (0..voxels_at(scale).div_ceil(BRICK)).map(|b| gather(&array, scale, b)).collect();
            let mut back = vec![u32::MAX; array.len()];
            bricks.iter().enumerate().for_each(|(b, values)| spread(values, b, scale, &mut back));
            assert_eq!(back, array);
            for (i, value) in array.iter().enumerate() {
                let (brick, place) = place_of(scale, i);
                assert_eq!(bricks[brick][place], *value, "scale {scale}, voxel {i}");
            }
        }
    }

    #[test]
    fn handles_tell_where_a_brick_is() {
        assert_eq!(Handle::NOWHERE.whereabouts(), Whereabouts::Nowhere);
        assert_eq!(Handle::NOWHERE.slot(), None);
        for i in [0, 5, Handle::MOST - 1] {
            assert_eq!(Handle::awake(i).whereabouts(), Whereabouts::Awake(i));
            assert_eq!(Handle::resting(i).whereabouts(), Whereabouts::Resting(i));
            assert_eq!([Handle::awake(i).slot(), Handle::resting(i).slot()], [Some(i), None]);
        }
    }
}
