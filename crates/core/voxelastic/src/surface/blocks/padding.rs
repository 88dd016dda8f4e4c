//! A block's masks with a margin of its neighbours' voxels, as rows of bits along x.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::block_grid::{Neighbours, neighbour_offset};
use super::block_masks::{BlockMasks, MaskKind};
use super::fill_holes::FilledField;

/// Rows per layer: one vector.
pub(crate) const LAYER: usize = 16;
/// Rows of a block with its margin, and spare rows for loops that overrun.
pub(crate) const ROWS: usize = 11 * LAYER;

/// Rows of bits along x: bit x + 1 of row y + 1 in layer z + 1 stands for the voxel at x, y, z, counted from the block's corner.
pub(crate) type PaddedRows = [u16; ROWS];

/// A block and its neighbours.
pub(crate) struct PaddedBlock<'a> {
    n: usize,
    neighbours: &'a Neighbours,
    filled: &'a FilledField<'a>,
    /// Masks of the neighbours with the same scale; empty for others.
    native: [&'a BlockMasks; 27],
    /// Whether coarser neighbours are included: each of their voxels represents the finer ones in it.
    coarser: bool,
}

impl<'a> PaddedBlock<'a> {
    /// A block with an edge of `n` voxels and the neighbours with the same scale.
    #[inline(always)]
    pub fn native(neighbours: &'a Neighbours, n: usize, filled: &'a FilledField<'a>) -> Self {
        let mut native = [&BlockMasks::EMPTY; 27];
        for i in 0..27 {
            if neighbours.native >> i & 1 == 1 {
                native[i] = &filled.blocks[neighbours.ranks[i] as usize];
            }
        }
        Self { n, neighbours, filled, native, coarser: false }
    }

    /// The same with the coarser neighbours.
    #[inline(always)]
    pub fn with_coarser(self) -> Self {
        Self { coarser: true, ..self }
    }

    /// The rows of the block with its margin.
    #[inline(always)]
    pub fn rows(&self, kind: MaskKind) -> PaddedRows {
        let (n, last) = (self.n, self.n - 1);
        let mut of = [&BlockMasks::EMPTY.known; 27];
        for i in 0..27 {
            of[i] = self.native[i].bits(kind);
        }
        let mut rows = [0; ROWS];
        for side in 0..3 {
            let (count, first, to) = [(1, last, 0), (n, 0, 1), (1, 0, n + 1)][side];
            let of = &of[9 * side..9 * side + 9];
            for k in 0..count {
                let z = first + k;
                let (before, here, beyond) = (of[3][z].to_le_bytes(), of[4][z].to_le_bytes(), of[5][z].to_le_bytes());
                let rows = &mut rows[(to + k) * LAYER..][..9];
                for y in 0..8 {
                    rows[1 + y] = u16::from(before[y]) >> last | u16::from(here[y]) << 1 | (u16::from(beyond[y]) & 1) << (last + 2);
                }
            }
            // The margins in front and behind, for all layers at once.
            let (mut front, mut back) = ([0; 8], [0; 8]);
            for z in 0..8 {
                front[z] = row(of[0][z], of[1][z], of[2][z], 8 * last, last);
                back[z] = row(of[6][z], of[7][z], of[8][z], 0, last);
            }
            for k in 0..count {
                rows[(to + k) * LAYER] = front[first + k];
                rows[(to + k) * LAYER + n + 1] = back[first + k];
            }
        }
        if self.coarser {
            self.add_coarser(kind, &mut rows);
        }
        rows
    }

    fn add_coarser(&self, kind: MaskKind, rows: &mut PaddedRows) {
        let n = self.n;
        for i in (0..27).filter(|i| self.neighbours.coarser >> i & 1 == 1) {
            let rank = self.neighbours.ranks[i] as usize;
            let coarser = n.trailing_zeros() - self.filled.grid.heads[rank].edge().trailing_zeros();
            let bits = self.filled.blocks[rank].bits(kind);
            // For each axis the first padded row, the number of rows, and their first index in the neighbour.
            let [xs, ys, zs] = neighbour_offset(i).map(|side| match side {
                -1 => (0, 1, n - 1),
                0 => (1, n, 0),
                _ => (n + 1, 1, 0),
            });
            for (z, y) in (0..zs.1).flat_map(|z| (0..ys.1).map(move |y| (z, y))) {
                let line = bits[(zs.2 + z) >> coarser] >> (8 * ((ys.2 + y) >> coarser));
                let row = (0..xs.1).fold(0, |row, x| row | (line >> ((xs.2 + x) >> coarser) & 1) << (xs.0 + x));
                rows[(ys.0 + y) + LAYER * (zs.0 + z)] |= row as u16;
            }
        }
    }
}

/// A row from the layers of three blocks, beginning at bit `at` there.
#[inline(always)]
fn row(before: u64, here: u64, beyond: u64, at: usize, last: usize) -> u16 {
    (before >> (at + last) & 1) as u16 | ((here >> at & 0xff) << 1) as u16 | ((beyond >> at & 1) << (last + 2)) as u16
}
