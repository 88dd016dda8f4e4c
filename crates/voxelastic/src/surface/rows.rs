//! A block's known voxels with a rim of its neighbours', as rows along x: what decides through which cells the surface passes.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::layout::{Around, Layout, neighbour_offset};
use super::samples::{Bits, Samples};

/// Rows from layer to layer: a vector's worth.
pub(super) const LAYER: usize = 16;
/// Rows of a block with its rim, and room for loops that run over.
pub(super) const ROWS: usize = 11 * LAYER;

/// Rows of bits along x: bit x + 1 of row y + 1 in layer z + 1 stands for the voxel at x, y, z, counted from the block's corner.
pub(super) type Rows = [u16; ROWS];

/// Rows of the known voxels, of those behind the surface, and of those far from it.
pub(super) struct Padded {
    pub known: Rows,
    pub behind: Rows,
    pub far: Rows,
}

impl Padded {
    /// The block and its rim, as far as that has the same scale.
    #[inline(always)]
    pub fn native(around: &Around, n: usize, blocks: &[Samples]) -> Self {
        let mut these = [&Samples::EMPTY; 27];
        for i in 0..27 {
            if around.native >> i & 1 == 1 {
                these[i] = &blocks[around.ranks[i] as usize];
            }
        }
        let mut padded = Self { known: [0; ROWS], behind: [0; ROWS], far: [0; ROWS] };
        for side in 0..3 {
            let (count, first, row) = [(1, n - 1, 0), (n, 0, 1), (1, 0, n + 1)][side];
            let of = &these[9 * side..];
            for k in 0..count {
                let (z, to) = (first + k, (row + k) * LAYER);
                let [a, b, c, d, e, f, g, h, i] = [of[0], of[1], of[2], of[3], of[4], of[5], of[6], of[7], of[8]];
                layer(
                    &mut padded.known[to..],
                    n,
                    [[a.known[z], b.known[z], c.known[z]], [d.known[z], e.known[z], f.known[z]], [g.known[z], h.known[z], i.known[z]]],
                );
                layer(
                    &mut padded.behind[to..],
                    n,
                    [[a.behind[z], b.behind[z], c.behind[z]], [d.behind[z], e.behind[z], f.behind[z]], [g.behind[z], h.behind[z], i.behind[z]]],
                );
                layer(&mut padded.far[to..], n, [[a.far[z], b.far[z], c.far[z]], [d.far[z], e.far[z], f.far[z]], [g.far[z], h.far[z], i.far[z]]]);
            }
        }
        padded
    }

    /// Adds what the coarser blocks around know to the rim: each of their voxels stands for the finer ones in it.
    pub fn add_coarser(&mut self, around: &Around, n: usize, layout: &Layout, blocks: &[Samples]) {
        for i in (0..27).filter(|i| around.coarser >> i & 1 == 1) {
            let rank = around.ranks[i] as usize;
            let coarser = n.trailing_zeros() - layout.heads[rank].edge().trailing_zeros();
            let samples = &blocks[rank];
            // In each axis the first voxel of the rim there, how many there are, and where they lie in their block.
            let [xs, ys, zs] = neighbour_offset(i).map(|side| match side {
                -1 => (0, 1, n - 1),
                0 => (1, n, 0),
                _ => (n + 1, 1, 0),
            });
            for (z, y) in (0..zs.1).flat_map(|z| (0..ys.1).map(move |y| (z, y))) {
                let row = (ys.0 + y) + LAYER * (zs.0 + z);
                let (layer, line) = ((zs.2 + z) >> coarser, 8 * ((ys.2 + y) >> coarser));
                let spread =
                    |bits: &Bits| (0..xs.1).fold(0, |row, x| row | ((bits[layer] >> (line + ((xs.2 + x) >> coarser)) & 1) as u16) << (xs.0 + x));
                self.known[row] |= spread(&samples.known);
                self.behind[row] |= spread(&samples.behind);
                self.far[row] |= spread(&samples.far);
            }
        }
    }
}

/// Writes the rows of one layer from those of the nine blocks that it passes through, x fastest.
#[inline(always)]
fn layer(rows: &mut [u16], n: usize, of: [[u64; 3]; 3]) {
    let ([before, here, beyond], last) = (of[1], n - 1);
    for y in 0..8 {
        rows[1 + y] = row(before, here, beyond, 8 * y, last);
    }
    rows[0] = row(of[0][0], of[0][1], of[0][2], 8 * last, last);
    rows[n + 1] = row(of[2][0], of[2][1], of[2][2], 0, last);
}

/// A row from the layers of three blocks, beginning there at bit `at`.
#[inline(always)]
fn row(before: u64, here: u64, beyond: u64, at: usize, last: usize) -> u16 {
    (before >> (at + last) & 1) as u16 | ((here >> at & 0xff) << 1) as u16 | ((beyond >> at & 1) << (last + 2)) as u16
}
