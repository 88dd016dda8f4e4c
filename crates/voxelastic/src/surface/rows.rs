//! A block's known voxels with a rim of its neighbours', as rows along x: what decides through which cells the surface passes.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::gaps::Closed;
use super::layout::{Around, neighbour_offset};
use super::samples::{Samples, Which};

/// Rows from layer to layer: a vector's worth.
pub(super) const LAYER: usize = 16;
/// Rows of a block with its rim, and room for loops that run over.
pub(super) const ROWS: usize = 11 * LAYER;

/// Rows of bits along x: bit x + 1 of row y + 1 in layer z + 1 stands for the voxel at x, y, z, counted from the block's corner.
pub(super) type Rows = [u16; ROWS];

/// The blocks that rows are made of.
pub(super) struct Padded<'a> {
    n: usize,
    around: &'a Around,
    closed: &'a Closed<'a>,
    /// The 27 blocks around as far as they have the same scale.
    native: [&'a Samples; 27],
    /// Whether coarser ones count too: each of their voxels stands for the finer ones in it.
    coarser: bool,
}

impl<'a> Padded<'a> {
    /// A block with an edge of `n` and those around that have the same scale.
    #[inline(always)]
    pub fn native(around: &'a Around, n: usize, closed: &'a Closed<'a>) -> Self {
        let mut native = [&Samples::EMPTY; 27];
        for i in 0..27 {
            if around.native >> i & 1 == 1 {
                native[i] = &closed.blocks[around.ranks[i] as usize];
            }
        }
        Self { n, around, closed, native, coarser: false }
    }

    /// The same with the coarser blocks around.
    #[inline(always)]
    pub fn with_coarser(self) -> Self {
        Self { coarser: true, ..self }
    }

    /// The rows of the block with its rim.
    #[inline(always)]
    pub fn rows(&self, which: Which) -> Rows {
        let (n, last) = (self.n, self.n - 1);
        let mut of = [&Samples::EMPTY.known; 27];
        for i in 0..27 {
            of[i] = self.native[i].bits(which);
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
            // The rims in front and behind, for all layers at once.
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
            self.add_coarser(which, &mut rows);
        }
        rows
    }

    fn add_coarser(&self, which: Which, rows: &mut Rows) {
        let n = self.n;
        for i in (0..27).filter(|i| self.around.coarser >> i & 1 == 1) {
            let rank = self.around.ranks[i] as usize;
            let coarser = n.trailing_zeros() - self.closed.layout.heads[rank].edge().trailing_zeros();
            let bits = self.closed.blocks[rank].bits(which);
            // In each axis the first row of the rim there, how many there are, and where they lie in their block.
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

/// A row from the layers of three blocks, beginning there at bit `at`.
#[inline(always)]
fn row(before: u64, here: u64, beyond: u64, at: usize, last: usize) -> u16 {
    (before >> (at + last) & 1) as u16 | ((here >> at & 0xff) << 1) as u16 | ((beyond >> at & 1) << (last + 2)) as u16
}
