//! Which dual cells of a block the surface passes through.
//!
//! A cell's corners are the eight voxels that meet at a corner of the grid; cell `c` lies between the voxels `c - 1` and `c`.

use super::cases::EDGES;
use super::padded::{CENTRE, Padded, neighbour_offset};
use crate::octree::BLOCK_EDGE;

/// A distance between neighbouring voxels that changes faster than this many times their spacing is no surface, but the
/// place where the band in front of one surface meets the band behind another.
const MAX_SLOPE: f32 = 4.0;

/// Cells along an edge of a block, those that it shares with its neighbours included.
const WIDTH: usize = BLOCK_EDGE + 1;

/// The cells of a block that have a piece of the surface: a mask per row along x, bit c for the cell at c.
pub(super) struct Cells {
    rows: [u16; WIDTH * WIDTH],
}

impl Cells {
    /// Finds the cells whose corners are all known, not all on one side, and no two of them too far apart to be one surface.
    pub fn find(padded: &Padded) -> Self {
        let n = padded.edge as i32;
        let mut cells = Self { rows: [0; WIDTH * WIDTH] };
        for z in 0..=n {
            for y in 0..=n {
                let rows = rows_around(y, z);
                let [known, any, all] = rows.iter().fold([u16::MAX, 0, u16::MAX], |[known, any, all], &row| {
                    [known & padded.known[row], any | padded.behind[row], all & padded.behind[row]]
                });
                let both = (known & known >> 1) & (any | any >> 1) & !(all & all >> 1);
                // Bit `bit(c - 1)` of `both` is the cell at c.
                let mut active = both >> Padded::bit(-1) & ((1 << (n + 1)) - 1);
                for x in bits(active) {
                    if too_steep(padded, [x, y, z]) {
                        active &= !(1 << x);
                    }
                }
                cells.rows[y as usize + z as usize * WIDTH] = active;
            }
        }
        cells
    }

    /// Mask of the cells at `y` and `z`.
    #[inline(always)]
    pub fn row(&self, y: i32, z: i32) -> u16 {
        self.rows[y as usize + z as usize * WIDTH]
    }
}

/// The positions of the bits that are set.
#[inline(always)]
pub(super) fn bits(mut mask: u16) -> impl Iterator<Item = i32> {
    std::iter::from_fn(move || {
        let bit = mask.trailing_zeros();
        (mask != 0).then(|| {
            mask &= mask - 1;
            bit as i32
        })
    })
}

/// Rows of samples that the cells at `y` and `z` lie between, in the order of a cell's corners.
#[inline(always)]
fn rows_around(y: i32, z: i32) -> [usize; 4] {
    [Padded::row(y - 1, z - 1), Padded::row(y, z - 1), Padded::row(y - 1, z), Padded::row(y, z)]
}

/// The voxels at the corners of cell `c`.
#[inline(always)]
pub(super) fn corners(c: [i32; 3]) -> [[i32; 3]; 8] {
    std::array::from_fn(|i| [c[0] - 1 + (i & 1) as i32, c[1] - 1 + (i >> 1 & 1) as i32, c[2] - 1 + (i >> 2) as i32])
}

/// The case of cell `c`: a bit for each corner behind the surface.
#[inline(always)]
pub(super) fn case(padded: &Padded, c: [i32; 3]) -> usize {
    rows_around(c[1], c[2]).iter().rev().fold(0, |case, &row| case << 2 | usize::from(padded.behind[row] >> Padded::bit(c[0] - 1) & 3))
}

/// Of the finest blocks that meet in a cell, the first in z, y, x order owns it. Finer neighbours were excluded before.
pub(super) fn is_owned(padded: &Padded, c: [i32; 3]) -> bool {
    if padded.uniform {
        return c.iter().all(|&v| v > 0);
    }
    corners(c).iter().all(|&corner| {
        let neighbour = padded.neighbour(corner);
        if neighbour == CENTRE || usize::from(padded.scales[neighbour]) != padded.scale {
            return true;
        }
        let [x, y, z] = neighbour_offset(neighbour);
        (z, y, x) > (0, 0, 0)
    })
}

/// Whether a crossing of the cell is too steep to be a surface, see [`MAX_SLOPE`].
fn too_steep(padded: &Padded, c: [i32; 3]) -> bool {
    let corners = corners(c);
    let samples = corners.map(Padded::at);
    let (low, high) =
        samples.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &s| (low.min(padded.distances[s]), high.max(padded.distances[s])));
    if high - low <= MAX_SLOPE * (1 << padded.scale) as f32 {
        return false;
    }
    EDGES.iter().any(|&[i, j]| {
        let (a, b) = (samples[i], samples[j]);
        padded.crosses(a, b) && {
            let spacing = if padded.uniform {
                (1 << padded.scale) as f32
            } else {
                let (p, q) = (padded.position(padded.corner(corners[i])), padded.position(padded.corner(corners[j])));
                (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>().sqrt()
            };
            (padded.distances[a] - padded.distances[b]).abs() > MAX_SLOPE * spacing
        }
    })
}
