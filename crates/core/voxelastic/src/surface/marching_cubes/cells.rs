//! The dual cells of a block that the surface crosses, and their corners.
//!
//! A cell's corners are the eight voxels that meet at a corner of the grid; cell `c` lies between the voxels `c - 1` and `c`.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use crate::field::tsdf::DISTANCE_STEPS;
use crate::octree::BLOCK_EDGE;
use crate::surface::blocks::block_grid::{BlockHead, CENTRE, Neighbours, neighbour_offset};
use crate::surface::blocks::block_masks::{MAX_SLOPE, MaskKind, coords, mask_index};
use crate::surface::blocks::fill_holes::FilledField;
use crate::surface::blocks::padding::{LAYER, PaddedBlock, PaddedRows, ROWS};

/// The cells of a block that the surface crosses.
pub(crate) struct SurfaceCells {
    /// Bit c of row y in layer z for the cell at (c, y, z).
    pub rows: PaddedRows,
    /// The voxels behind the surface, as in [`PaddedBlock`].
    pub behind: PaddedRows,
}

impl SurfaceCells {
    /// Finds the cells whose corners are all known, not all on one side, and without a crossing that is too steep. None if there is no such cell.
    #[inline(always)]
    pub fn find(padded: &PaddedBlock<'_>, filled: &FilledField<'_>, neighbours: &Neighbours, head: &BlockHead) -> Option<Self> {
        let (known, behind) = (padded.rows(MaskKind::Known), padded.rows(MaskKind::Behind));
        let mut rows = [0; ROWS];
        let mut found = 0;
        for i in 0..9 * LAYER {
            let k = known[i] & known[i + 1] & known[i + LAYER] & known[i + LAYER + 1];
            let any = behind[i] | behind[i + 1] | behind[i + LAYER] | behind[i + LAYER + 1];
            let all = behind[i] & behind[i + 1] & behind[i + LAYER] & behind[i + LAYER + 1];
            rows[i] = k & k >> 1 & (any | any >> 1) & !(all & all >> 1);
            found |= rows[i];
        }
        if found == 0 {
            return None;
        }
        let far = padded.rows(MaskKind::Far);
        let mut may_be_steep = 0;
        for i in 0..9 * LAYER {
            let distant = far[i] | far[i + 1] | far[i + LAYER] | far[i + LAYER + 1];
            may_be_steep |= rows[i] & (distant | distant >> 1);
        }
        let mut cells = Self { rows, behind };
        if may_be_steep != 0 {
            cells.remove_steep(&known, &far, filled, neighbours, head);
        }
        Some(cells)
    }

    /// The corners of cell `x` of row `i` that are behind the surface, as a case of marching cubes.
    #[inline(always)]
    pub fn case(&self, i: usize, x: usize) -> usize {
        let [a, b, c, d] = [self.behind[i], self.behind[i + 1], self.behind[i + LAYER], self.behind[i + LAYER + 1]];
        usize::from((a >> x & 3) | (b >> x & 3) << 2 | (c >> x & 3) << 4 | (d >> x & 3) << 6)
    }

    /// Removes the cells around every crossed edge that is too steep to be a surface, see [`MAX_SLOPE`].
    fn remove_steep(&mut self, known: &PaddedRows, far: &PaddedRows, filled: &FilledField<'_>, neighbours: &Neighbours, head: &BlockHead) {
        let behind = &self.behind;
        let mut may_be_steep = [0; ROWS];
        for i in 0..10 * LAYER {
            let along = known[i] >> 1 & (behind[i] ^ behind[i] >> 1) & (far[i] | far[i] >> 1);
            let across = known[i + 1] & (behind[i] ^ behind[i + 1]) & (far[i] | far[i + 1]);
            let upward = known[i + LAYER] & (behind[i] ^ behind[i + LAYER]) & (far[i] | far[i + LAYER]);
            may_be_steep[i] = known[i] & (along | across | upward);
        }
        for i in (0..10 * LAYER).filter(|&i| may_be_steep[i] != 0) {
            // Bit c for the edge from the voxel at bit c to the next one along each axis.
            let beyond = |rows: &PaddedRows| [rows[i] >> 1, rows[i + 1], rows[i + LAYER]];
            let [known_there, behind_there, far_there] = [beyond(known), beyond(behind), beyond(far)];
            for axis in 0..3 {
                let mut left = known[i] & known_there[axis] & (behind[i] ^ behind_there[axis]) & (far[i] | far_there[axis]);
                while left != 0 {
                    let x = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let here = [x as i32 - 1, (i % LAYER) as i32 - 1, (i / LAYER) as i32 - 1];
                    if is_too_steep(here, axis, filled, neighbours, head) {
                        let at = (1 << x) | if axis == 0 { 0 } else { (1 << x) >> 1 };
                        for dy in 0..1 + usize::from(axis != 1) {
                            for dz in 0..1 + usize::from(axis != 2) {
                                // Beyond the first row and layer there is no cell.
                                if let Some(row) = i.checked_sub(dy + LAYER * dz) {
                                    self.rows[row] &= !at;
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Whether the crossing between voxel `here` and the next one along `axis` is too steep.
fn is_too_steep(here: [i32; 3], axis: usize, filled: &FilledField<'_>, neighbours: &Neighbours, head: &BlockHead) -> bool {
    let mut there = here;
    there[axis] += 1;
    let [a, b] = [here, there].map(|c| Corner::at(c, filled, neighbours, head));
    let spacing = (0..3).map(|k| (a.centre[k] - b.centre[k]).powi(2)).sum::<f32>().sqrt();
    (a.distance - b.distance).abs() > MAX_SLOPE * spacing
}

/// Neighbours that the cells of each zone touch. In each axis a cell may lie between the block and the one before it (0), in the
/// block (1), or between the block and the one beyond (2); zones are numbered x fastest.
const TOUCHED: [u32; 27] = {
    let mut touched = [0; 27];
    let mut zone = 0;
    while zone < 27 {
        let mut block = 0;
        while block < 27 {
            let (z, b) = ([zone % 3, zone / 3 % 3, zone / 9], [block % 3, block / 3 % 3, block / 9]);
            let mut k = 0;
            let mut within = true;
            while k < 3 {
                within &= b[k] == 1 || b[k] == z[k];
                k += 1;
            }
            touched[zone] |= (within as u32) << block;
            block += 1;
        }
        zone += 1;
    }
    touched
};

/// The cells between blocks of different scales that a block owns, as rows like those of [`SurfaceCells`]: none of the blocks that meet there
/// is finer, and it is the first in z, y, x order of those of its scale.
pub(crate) fn owned_seams(neighbours: &Neighbours, n: usize) -> Option<PaddedRows> {
    let (native, coarser) = (neighbours.native, neighbours.coarser);
    let before = (1 << CENTRE) - 1;
    let owned = |touched: u32| touched & !(native | coarser) == 0 && touched & coarser != 0 && touched & native & before == 0;
    let zones = (0..27).filter(|&zone| owned(TOUCHED[zone])).fold(0u32, |zones, zone| zones | 1 << zone);
    if zones == 0 {
        return None;
    }
    let parts = [1, ((1u32 << n) - 2) as u16, 1 << n];
    let mut rows = [0; ROWS];
    let zone_of = |v: usize| usize::from(v > 0) + usize::from(v == n);
    for (z, y) in (0..=n).flat_map(|z| (0..=n).map(move |y| (z, y))) {
        let first = 3 * zone_of(y) + 9 * zone_of(z);
        rows[y + LAYER * z] = (0..3).filter(|x| zones >> (first + x) & 1 == 1).fold(0, |row, x| row | parts[x]);
    }
    Some(rows)
}

/// A voxel at a corner of a cell.
#[derive(Clone, Copy)]
pub(crate) struct Corner {
    pub rank: u32,
    pub mask_index: u16,
    pub scale: u8,
    /// Centre and distance, in finest voxels.
    pub centre: [f32; 3],
    pub distance: f32,
}

/// A cell whose corners are known.
pub(crate) struct Cell {
    pub corners: [Corner; 8],
}

impl Cell {
    /// Looks up the corners of cell `c` of a block.
    pub fn at(c: [i32; 3], filled: &FilledField<'_>, neighbours: &Neighbours, head: &BlockHead) -> Self {
        Self { corners: corners(c).map(|voxel| Corner::at(voxel, filled, neighbours, head)) }
    }
}

impl Corner {
    /// Looks up voxel `c` of a block or of a neighbour that is not finer.
    #[inline(always)]
    pub fn at(c: [i32; 3], filled: &FilledField<'_>, neighbours: &Neighbours, head: &BlockHead) -> Self {
        let n = head.edge() as i32;
        let side = c.map(|v| usize::from(v >= 0) + usize::from(v >= n));
        let neighbour = side[0] + 3 * side[1] + 9 * side[2];
        let rank = neighbours.ranks[neighbour];
        let scale = filled.grid.heads[rank as usize].scale;
        let mask_index = mask_index(c.map(|v| (v & (n - 1)) as usize >> (scale - head.scale)));
        let (origin, offset, edge) = (head.origin(), neighbour_offset(neighbour), (1u32 << scale) as f32);
        let local = coords(mask_index);
        Self {
            rank,
            mask_index: mask_index as u16,
            scale,
            centre: std::array::from_fn(|k| (origin[k] + offset[k] * BLOCK_EDGE as i32) as f32 + (local[k] as f32 + 0.5) * edge),
            distance: filled.steps(rank as usize, mask_index) * (edge / DISTANCE_STEPS),
        }
    }
}

/// The voxels at the corners of cell `c`.
#[inline(always)]
pub(crate) fn corners(c: [i32; 3]) -> [[i32; 3]; 8] {
    std::array::from_fn(|i| [c[0] - 1 + (i & 1) as i32, c[1] - 1 + (i >> 1 & 1) as i32, c[2] - 1 + (i >> 2) as i32])
}
