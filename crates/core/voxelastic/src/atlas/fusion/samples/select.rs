//! Which voxels of a block of the target can be sampled.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::points::LANES;
use super::sample_grid::SampleGrid;
use super::window::CellRows;
use crate::octree::voxels_at;
use crate::simd::bits::lowest_bits;
use crate::simd::{Kernel, gather};

/// Voxels of a block at the finest scale.
const CAPACITY: usize = voxels_at(0);

/// Finds the voxels of a block around which anything is observed: one bit test each.
pub(crate) struct Select<'a> {
    pub grid: &'a SampleGrid,
    /// Number of voxels in the block.
    pub count: usize,
    pub cells: CellRows<'a>,
    /// Bit set of the voxels found, 64 to a word; voxels whose cells are outside of `cells` are not among them.
    pub found: &'a mut [u64; CAPACITY / 64],
}

impl Kernel for Select<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { grid, count, cells, found } = self;
        *found = [0; CAPACITY / 64];
        let lanes = count.min(LANES);
        let mut first = 0;
        while first < count {
            let (mut at, mut bit, mut is_inside) = ([0u32; LANES], [0u32; LANES], [0u32; LANES]);
            let base = [0, 1, 2].map(|k| &grid.base[k][first..first + lanes]);
            for l in 0..lanes {
                (at[l], bit[l], is_inside[l]) = cells.place([base[0][l], base[1][l], base[2][l]]);
            }
            let mut word = [0; LANES];
            gather(cells.words(), &at[..lanes], &mut word[..lanes]);
            let mut flags = [0u8; LANES];
            for l in 0..LANES {
                flags[l] = (word[l] >> bit[l] & is_inside[l]) as u8;
            }
            for (i, b) in flags.chunks_exact(8).enumerate() {
                found[first / 64 % 8] |= lowest_bits(u64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]])) << (8 * i);
            }
            first += LANES;
        }
    }
}
