//! A block of the TSDF and the arrays of voxels that it holds.
//!
//! A block is integrated at one scale at a time. Going coarser keeps the finer array and stores the initial value of the coarse one
//! ([`Array::Base`]); going finer again applies only the difference to the finer array, so that detail is never lost.

use super::brick::{BRICKS, BrickHandle};
use super::observation_count::ObservationCount;
use super::voxel::Voxel;
use crate::octree::{SCALES, voxels_at};
use std::ops::Range;

/// Number of bricks in all arrays that a block can have.
const HANDLES: usize = BRICKS + 2 * (SCALES - 1);

/// One block of 8 x 8 x 8 finest voxels: its position, its scale and handles to its bricks.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Morton key of its position in the submap frame, see [`crate::octree::block_key`].
    pub key: u64,
    /// The current integration scale, 0 to 3: the edge of its voxels is 2^scale finest voxels.
    pub scale: u8,
    /// The finest scale at which it has an array, at most `scale`.
    pub finest: u8,
    /// Whether its voxels have intensities, because the scan that created it had.
    pub(crate) has_intensity: bool,
    /// Number of beams integrated into it. Not saved with a map: a loaded block starts from zero.
    pub(crate) observation_count: ObservationCount,
    /// The field's change count at its last change.
    pub(crate) changed: u32,
    /// The bricks of all its arrays, in the order of [`Array::bricks`].
    pub(in crate::field) bricks: [BrickHandle; HANDLES],
}

/// One of a block's arrays of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Array {
    /// The voxels at a scale between the block's finest and its current one.
    Data(usize),
    /// The initial value of the data array at a scale coarser than the finest, from when the block was coarsened to it. Has no intensities.
    Base(usize),
}

impl Array {
    /// The array's scale.
    #[inline(always)]
    pub fn scale(self) -> usize {
        let (Self::Data(scale) | Self::Base(scale)) = self;
        scale
    }

    /// Indices of the array's bricks among the bricks of its block.
    #[inline(always)]
    pub fn bricks(self) -> Range<usize> {
        let one = |i: usize| i..i + 1;
        match self {
            Self::Data(0) | Self::Base(0) => 0..BRICKS,
            Self::Data(scale) => one(BRICKS + scale - 1),
            Self::Base(scale) => one(BRICKS + SCALES - 1 + scale - 1),
        }
    }
}

impl Block {
    /// A block without bricks.
    pub(crate) fn new(key: u64, scale: u8, finest: u8, has_intensity: bool) -> Self {
        Self { key, scale, finest, has_intensity, observation_count: ObservationCount::default(), changed: 0, bricks: [BrickHandle::ABSENT; HANDLES] }
    }

    /// Whether brick `brick` has intensities: those of base arrays never do.
    #[inline(always)]
    pub(crate) fn brick_has_intensity(&self, brick: usize) -> bool {
        self.has_intensity && brick < BRICKS + SCALES - 1
    }

    /// The array at the current scale, which scans are integrated into.
    #[inline(always)]
    pub(crate) fn current(&self) -> Array {
        Array::Data(usize::from(self.scale))
    }
}

/// A buffer for the largest array of a block.
pub(crate) type VoxelBuffer = [Voxel; voxels_at(0)];

/// Encodes brick `brick` of block `id` as the owner of a stored brick.
#[inline(always)]
pub(crate) fn owner(id: u32, brick: usize) -> u32 {
    debug_assert!(id >> 28 == 0);
    id << 4 | brick as u32
}

/// Inverse of [`owner`]: block id and brick.
#[inline(always)]
pub(crate) fn block_and_brick(owner: u32) -> (u32, usize) {
    (owner >> 4, (owner & 15) as usize)
}
