//! Closing gaps: a voxel that no beam met, between two on opposite sides that were, is given the mean of them.
//!
//! Beams leave gaps of a voxel everywhere; marching cubes, which needs all eight corners of a cell, makes a hole of each. What
//! lies between two observed voxels is interpolated, never extrapolated, so that the surface grows nowhere.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::layout::{Around, CENTRE, Layout, PART, neighbour_offset, part_of};
use super::samples::{Bits, FAR, Field, Measured, Samples, coords, place, valid};
use crate::dispatch::{Kernel, dispatch};
use crate::field::tsdf::DISTANCE_STEPS;
use crate::geometry::bits::rank;
use crate::octree::voxels_at;
use rayon::prelude::*;

/// Neighbours that differ by more than this many steps belong to different surfaces: a distance changes by one voxel at most.
const MOST_STEP: f32 = 1.5 * DISTANCE_STEPS;
/// The column of voxels at x = 0 in a layer, and the row at y = 0.
const COLUMN: u64 = 0x0101_0101_0101_0101;
const ROW: u64 = 0xff;

/// A field with its gaps closed.
pub(super) struct Closed<'a> {
    field: &'a Field,
    pub layout: &'a Layout,
    /// What is known of each block now, by rank. The values that go with it are those of voxels that were gaps.
    pub blocks: Vec<Samples>,
    /// Distances of the voxels that were gaps, by part.
    filled: Vec<Vec<f32>>,
}

impl<'a> Closed<'a> {
    /// Closes gaps, each block's from what was observed at its own scale; none at all unless `wanted`.
    ///
    /// Blocks that see the same voxel must agree on it, so nothing is closed next to finer blocks, which cannot know.
    pub fn new(field: &'a Field, layout: &'a Layout, wanted: bool) -> Self {
        let mut blocks: Vec<Samples> = bytemuck::allocation::zeroed_vec(field.blocks.len());
        let parts = blocks.par_chunks_mut(PART).enumerate().map(|(part, blocks)| {
            let mut filled = Vec::new();
            dispatch(Close { field, layout, wanted, first: part * PART, blocks, filled: &mut filled });
            filled
        });
        let filled = parts.collect();
        Self { field, layout, blocks, filled }
    }

    /// Distance of the known voxel at `place` in block `rank`, in steps of its scale.
    #[inline(always)]
    pub fn steps(&self, rank: usize, place: usize) -> f32 {
        self.steps_in(self.field.of(rank), rank, place)
    }

    /// What was measured in block `rank`.
    #[inline(always)]
    pub fn measured(&self, rank: usize) -> Measured<'_> {
        self.field.of(rank)
    }

    /// As [`steps`](Self::steps), with what was measured in the block at hand.
    #[inline(always)]
    pub fn steps_in(&self, measured: Measured<'_>, rank: usize, place: usize) -> f32 {
        match measured.steps(place) {
            Some(steps) => f32::from(steps),
            None => self.filled_steps(rank, place),
        }
    }

    fn filled_steps(&self, rank: usize, place: usize) -> f32 {
        let samples = &self.blocks[rank];
        let (layer, bit) = (place >> 6, place & 63);
        let filled = samples.known[layer] & !self.field.blocks[rank].known[layer];
        let index = samples.start as usize + usize::from(samples.before[layer]) + self::rank(filled, bit);
        self.filled[part_of(rank)][index]
    }
}

/// Closes the gaps of a part's blocks.
struct Close<'a> {
    field: &'a Field,
    layout: &'a Layout,
    wanted: bool,
    /// Rank of the first block.
    first: usize,
    blocks: &'a mut [Samples],
    filled: &'a mut Vec<f32>,
}

impl Kernel for Close<'_> {
    #[inline(always)]
    fn run(self) {
        for i in 0..self.blocks.len() {
            let (around, n) = (&self.layout.around[self.first + i], self.layout.heads[self.first + i].edge());
            let samples = &mut self.blocks[i];
            *samples = Samples { start: self.filled.len() as u32, before: [0; 8], ..self.field.blocks[self.first + i] };
            if self.wanted && n > 1 {
                self.field.close(self.layout, around, n, samples, self.filled);
            }
        }
    }
}

impl Field {
    #[inline(always)]
    fn close(&self, layout: &Layout, around: &Around, n: usize, samples: &mut Samples, filled: &mut Vec<f32>) {
        let mut gaps = self.gaps(around, n);
        if around.finer != 0 {
            let finer = beside_finer(around, n);
            for z in 0..8 {
                gaps[z] &= !finer[z];
            }
        }
        if gaps == [0; 8] {
            return;
        }
        let mut here = [f32::NAN; voxels_at(0)];
        self.of(around.ranks[CENTRE] as usize).spread(&mut here);
        let first = filled.len();
        for z in 0..n {
            samples.before[z] = (filled.len() - first) as u16;
            let mut left = gaps[z];
            while left != 0 {
                let bit = left.trailing_zeros() as usize;
                left &= left - 1;
                let Some(steps) = self.between(layout, around, n, &here, 64 * z + bit) else { continue };
                filled.push(steps);
                samples.known[z] |= 1 << bit;
                samples.behind[z] |= u64::from(steps < 0.0) << bit;
                samples.far[z] |= u64::from(steps.abs() > f32::from(FAR)) << bit;
            }
        }
    }

    /// Unknown voxels between two known ones.
    #[inline(always)]
    fn gaps(&self, around: &Around, n: usize) -> Bits {
        let here = self.native(around, CENTRE);
        let [left, right, front, back] =
            [self.native(around, CENTRE - 1), self.native(around, CENTRE + 1), self.native(around, CENTRE - 3), self.native(around, CENTRE + 3)];
        let (below, above) = (self.native(around, CENTRE - 9)[n - 1], self.native(around, CENTRE + 9)[0]);
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
    fn native(&self, around: &Around, neighbour: usize) -> &Bits {
        if around.native >> neighbour & 1 == 1 { &self.blocks[around.ranks[neighbour] as usize].known } else { &Samples::EMPTY.known }
    }

    /// The mean of the pairs of known voxels on opposite sides of a gap, unless it is far from one of the neighbours. Distances `here` in the block
    /// are by place, NaN where unknown.
    #[inline(always)]
    fn between(&self, layout: &Layout, around: &Around, n: usize, here: &[f32; voxels_at(0)], gap: usize) -> Option<f32> {
        let c = coords(gap);
        let mut beside = [[f32::NAN; 2]; 3];
        let (mut sum, mut count) = (0.0, 0.0);
        for k in 0..3 {
            let (step, offset) = (1 << (3 * k), [1, 3, 9][k]);
            let (before, beyond) = (CENTRE - offset, CENTRE + offset);
            let (first, last) = (c[k] == 0, c[k] + 1 == n);
            beside[k][0] = if first { self.outside(layout, around, before, c, k, n - 1) } else { here[(gap - step) % here.len()] };
            beside[k][1] = if last { self.outside(layout, around, beyond, c, k, 0) } else { here[(gap + step) % here.len()] };
            let native = !(first & (around.native >> before & 1 == 0) | last & (around.native >> beyond & 1 == 0));
            let pair = beside[k][0] + beside[k][1];
            if native & !pair.is_nan() {
                sum += pair;
                count += 2.0;
            }
        }
        let mean = sum / count;
        for k in 0..3 {
            // Comparisons with NaN, the unknown, are false.
            if (beside[k][0] - mean).abs() > MOST_STEP || (beside[k][1] - mean).abs() > MOST_STEP {
                return None;
            }
        }
        Some(mean)
    }

    /// Distance of the voxel beside `c` in one of the blocks around, there at `at` along `axis`: in steps of the block's own scale, NaN where it
    /// is unknown.
    #[inline(always)]
    fn outside(&self, layout: &Layout, around: &Around, neighbour: usize, mut c: [usize; 3], axis: usize, at: usize) -> f32 {
        if (around.native | around.coarser) >> neighbour & 1 == 0 {
            return f32::NAN;
        }
        c[axis] = at;
        let rank = around.ranks[neighbour] as usize;
        let (scale, own) = (layout.heads[rank].scale, layout.heads[around.ranks[CENTRE] as usize].scale);
        let coarser = scale - own;
        let place = place([c[0] >> coarser, c[1] >> coarser, c[2] >> coarser]);
        self.of(rank).steps(place).map_or(f32::NAN, f32::from) * (1u32 << coarser) as f32
    }
}

/// The voxels beside a finer block.
fn beside_finer(around: &Around, n: usize) -> Bits {
    let mut beside = [0; 8];
    for i in (0..27).filter(|i| around.finer >> i & 1 == 1) {
        let [columns, rows, layers] = neighbour_offset(i).map(|offset| match offset {
            -1 => 1u8,
            0 => u8::MAX,
            _ => 1 << (n - 1),
        });
        let layer = (0..8).filter(|y| rows >> y & 1 == 1).fold(0, |layer, y| layer | u64::from(columns) << (8 * y));
        (0..8).filter(|z| layers >> z & 1 == 1).for_each(|z| beside[z] |= layer);
    }
    beside
}
