//! Hole filling: an unobserved voxel between two observed ones on opposite sides gets their mean.
//!
//! Beams leave gaps of single voxels, and marching cubes, which needs all eight corners of a cell, makes a hole of each. Distances are
//! interpolated between observed voxels and never extrapolated, so that the surface does not grow.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::block_grid::{BlockGrid, CENTRE, Neighbours, PART, neighbour_offset, part_of};
use super::block_masks::{Bits, BlockDistances, BlockMasks, FAR, MaskedField, coords, mask_index, valid};
use crate::field::tsdf::DISTANCE_STEPS;
use crate::octree::voxels_at;
use crate::simd::bits::rank;
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// Neighbours that differ by more than this many steps belong to different surfaces: a distance changes by at most one voxel.
const MAX_STEP: f32 = 1.5 * DISTANCE_STEPS;
/// The column of voxels at x = 0 in a layer, and the row at y = 0.
const COLUMN: u64 = 0x0101_0101_0101_0101;
const ROW: u64 = 0xff;

/// A field with its holes filled.
pub(crate) struct FilledField<'a> {
    field: &'a MaskedField,
    pub grid: &'a BlockGrid,
    /// Masks by rank, including filled voxels; `start` and `before` refer to the filled distances.
    pub blocks: Vec<BlockMasks>,
    /// Distances of filled voxels, by part.
    filled: Vec<Vec<f32>>,
}

impl<'a> FilledField<'a> {
    /// Fills the holes of each block from voxels of its own scale; fills none unless `wanted`.
    ///
    /// A voxel must be the same for all blocks that read it, so voxels next to finer blocks are not filled.
    pub fn new(field: &'a MaskedField, grid: &'a BlockGrid, wanted: bool) -> Self {
        let mut blocks: Vec<BlockMasks> = bytemuck::allocation::zeroed_vec(field.blocks.len());
        let parts = blocks.par_chunks_mut(PART).enumerate().map(|(part, blocks)| {
            let mut filled = Vec::new();
            dispatch(FillHoles { field, grid, wanted, first: part * PART, blocks, filled: &mut filled });
            filled
        });
        let filled = parts.collect();
        Self { field, grid, blocks, filled }
    }

    /// Distance of the known voxel with `mask_index` in block `rank`, in steps of its scale.
    #[inline(always)]
    pub fn steps(&self, rank: usize, mask_index: usize) -> f32 {
        self.steps_in(self.field.of(rank), rank, mask_index)
    }

    /// Measured distances of block `rank`.
    #[inline(always)]
    pub fn measured(&self, rank: usize) -> BlockDistances<'_> {
        self.field.of(rank)
    }

    /// As [`steps`](Self::steps), with the measured distances of the block given.
    #[inline(always)]
    pub fn steps_in(&self, measured: BlockDistances<'_>, rank: usize, mask_index: usize) -> f32 {
        match measured.steps(mask_index) {
            Some(steps) => f32::from(steps),
            None => self.filled_steps(rank, mask_index),
        }
    }

    fn filled_steps(&self, rank: usize, mask_index: usize) -> f32 {
        let masks = &self.blocks[rank];
        let (layer, bit) = (mask_index >> 6, mask_index & 63);
        let filled = masks.known[layer] & !self.field.blocks[rank].known[layer];
        let index = masks.start as usize + usize::from(masks.before[layer]) + self::rank(filled, bit);
        self.filled[part_of(rank)][index]
    }
}

/// Fills the holes of a part's blocks.
struct FillHoles<'a> {
    field: &'a MaskedField,
    grid: &'a BlockGrid,
    wanted: bool,
    /// Rank of the first block.
    first: usize,
    blocks: &'a mut [BlockMasks],
    filled: &'a mut Vec<f32>,
}

impl Kernel for FillHoles<'_> {
    #[inline(always)]
    fn run(self) {
        for i in 0..self.blocks.len() {
            let (neighbours, n) = (&self.grid.neighbours[self.first + i], self.grid.heads[self.first + i].edge());
            let masks = &mut self.blocks[i];
            *masks = BlockMasks { start: self.filled.len() as u32, before: [0; 8], ..self.field.blocks[self.first + i] };
            if self.wanted && n > 1 {
                self.field.fill(self.grid, neighbours, n, masks, self.filled);
            }
        }
    }
}

impl MaskedField {
    #[inline(always)]
    fn fill(&self, grid: &BlockGrid, neighbours: &Neighbours, n: usize, masks: &mut BlockMasks, filled: &mut Vec<f32>) {
        let mut gaps = self.gaps(neighbours, n);
        if neighbours.finer != 0 {
            let finer = next_to_finer(neighbours, n);
            for z in 0..8 {
                gaps[z] &= !finer[z];
            }
        }
        if gaps == [0; 8] {
            return;
        }
        let mut here = [f32::NAN; voxels_at(0)];
        self.of(neighbours.ranks[CENTRE] as usize).spread(&mut here);
        let first = filled.len();
        for z in 0..n {
            masks.before[z] = (filled.len() - first) as u16;
            let mut left = gaps[z];
            while left != 0 {
                let bit = left.trailing_zeros() as usize;
                left &= left - 1;
                let Some(steps) = self.between(grid, neighbours, n, &here, 64 * z + bit) else { continue };
                filled.push(steps);
                masks.known[z] |= 1 << bit;
                masks.behind[z] |= u64::from(steps < 0.0) << bit;
                masks.far[z] |= u64::from(steps.abs() > f32::from(FAR)) << bit;
            }
        }
    }

    /// Unknown voxels between two known ones.
    #[inline(always)]
    fn gaps(&self, neighbours: &Neighbours, n: usize) -> Bits {
        let here = self.native(neighbours, CENTRE);
        let [left, right, front, back] = [
            self.native(neighbours, CENTRE - 1),
            self.native(neighbours, CENTRE + 1),
            self.native(neighbours, CENTRE - 3),
            self.native(neighbours, CENTRE + 3),
        ];
        let (below, above) = (self.native(neighbours, CENTRE - 9)[n - 1], self.native(neighbours, CENTRE + 9)[0]);
        let (valid, last) = (valid(n), n - 1);
        let mut upright = [0; 10];
        upright[0] = below;
        upright[1..9].copy_from_slice(here);
        upright[n + 1] = above;
        let mut gaps = [0; 8];
        for z in 0..8 {
            let k = here[z];
            let along = (k << 1 & !COLUMN | left[z] >> last & COLUMN) & (k >> 1 & !(COLUMN << last) | (right[z] & COLUMN) << last);
            let across = (k << 8 | front[z] >> (8 * last)) & (k >> 8 | (back[z] & ROW) << (8 * last));
            gaps[z] = (along | across | upright[z] & upright[z + 2]) & !k & valid;
        }
        gaps
    }

    /// The known voxels of one of the blocks around if it has the same scale.
    #[inline(always)]
    fn native(&self, neighbours: &Neighbours, neighbour: usize) -> &Bits {
        if neighbours.native >> neighbour & 1 == 1 { &self.blocks[neighbours.ranks[neighbour] as usize].known } else { &BlockMasks::EMPTY.known }
    }

    /// Mean of the pairs of known voxels on opposite sides of a hole, unless it differs too much from a neighbour. Distances `here` in the block are
    /// by mask index, NaN where unknown.
    #[inline(always)]
    fn between(&self, grid: &BlockGrid, neighbours: &Neighbours, n: usize, here: &[f32; voxels_at(0)], gap: usize) -> Option<f32> {
        let c = coords(gap);
        let mut sides = [[f32::NAN; 2]; 3];
        let (mut sum, mut count) = (0.0, 0.0);
        for k in 0..3 {
            let (step, offset) = (1 << (3 * k), [1, 3, 9][k]);
            let (before, beyond) = (CENTRE - offset, CENTRE + offset);
            let (first, last) = (c[k] == 0, c[k] + 1 == n);
            sides[k][0] = if first { self.outside(grid, neighbours, before, c, k, n - 1) } else { here[(gap - step) % here.len()] };
            sides[k][1] = if last { self.outside(grid, neighbours, beyond, c, k, 0) } else { here[(gap + step) % here.len()] };
            let native = !(first & (neighbours.native >> before & 1 == 0) | last & (neighbours.native >> beyond & 1 == 0));
            let pair = sides[k][0] + sides[k][1];
            if native & !pair.is_nan() {
                sum += pair;
                count += 2.0;
            }
        }
        let mean = sum / count;
        for k in 0..3 {
            // Comparisons with NaN (unknown) are false.
            if (sides[k][0] - mean).abs() > MAX_STEP || (sides[k][1] - mean).abs() > MAX_STEP {
                return None;
            }
        }
        Some(mean)
    }

    /// Distance of the voxel next to `c` in a neighbouring block, at `at` along `axis` there: in steps of the block's own scale, NaN if unknown.
    #[inline(always)]
    fn outside(&self, grid: &BlockGrid, neighbours: &Neighbours, neighbour: usize, mut c: [usize; 3], axis: usize, at: usize) -> f32 {
        if (neighbours.native | neighbours.coarser) >> neighbour & 1 == 0 {
            return f32::NAN;
        }
        c[axis] = at;
        let rank = neighbours.ranks[neighbour] as usize;
        let (scale, own) = (grid.heads[rank].scale, grid.heads[neighbours.ranks[CENTRE] as usize].scale);
        let coarser = scale - own;
        let mask_index = mask_index([c[0] >> coarser, c[1] >> coarser, c[2] >> coarser]);
        self.of(rank).steps(mask_index).map_or(f32::NAN, f32::from) * (1u32 << coarser) as f32
    }
}

/// The voxels next to a finer block.
fn next_to_finer(neighbours: &Neighbours, n: usize) -> Bits {
    let mut mask = [0; 8];
    for i in (0..27).filter(|i| neighbours.finer >> i & 1 == 1) {
        let [columns, rows, layers] = neighbour_offset(i).map(|offset| match offset {
            -1 => 1u8,
            0 => u8::MAX,
            _ => 1 << (n - 1),
        });
        let layer = (0..8).filter(|y| rows >> y & 1 == 1).fold(0, |layer, y| layer | u64::from(columns) << (8 * y));
        (0..8).filter(|z| layers >> z & 1 == 1).for_each(|z| mask[z] |= layer);
    }
    mask
}
