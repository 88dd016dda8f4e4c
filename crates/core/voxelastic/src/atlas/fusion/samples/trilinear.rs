//! Trilinear interpolation among eight voxels, some of which may be unobserved; many points at a time.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::points::{LANES, Points};
use crate::field::tsdf::{DISTANCE_STEPS, Voxel};
use crate::octree::{BLOCK_SHIFT, edge_at};
use crate::simd::{Kernel, larger, smaller};

/// Corners of a cell whose distances differ by more than this many voxels belong to different surfaces (the band in front of one and the
/// band behind another) and are not interpolated. The distance to one surface changes by at most the cell's diagonal, 1.73.
pub(crate) const MAX_DIFFERENCE: f32 = 2.5;

/// Largest share of the interpolation weights at unobserved corners. With one half the observed region grows as much as it shrinks, but
/// lines of single voxels, left by single beams, break up; with this value they remain.
pub(crate) const MAX_MISSING: f32 = 0.55;

/// Where the voxels of cells lie.
#[derive(Clone, Copy)]
pub(crate) struct CellArrays<'a> {
    pub scale: usize,
    /// The lowest voxel of the window, and its size in blocks.
    pub low: [i32; 3],
    pub blocks: [u32; 3],
    /// First voxel of the array of each block of the window, x fastest.
    pub starts: &'a [u32],
    /// Voxels of all arrays: distance in the low half, weight in the high one.
    pub voxels: &'a [u32],
    /// Intensities of all arrays, 0 where unknown; empty if there are none.
    pub intensities: &'a [u8],
}

/// The samples of a block: voxels of its scale, unobserved where there is none, and intensities.
pub(crate) struct Samples<'a> {
    pub voxels: &'a mut [Voxel],
    pub intensities: &'a mut [u8],
    /// Bit set of the observed voxels, 64 to a word.
    pub observed: &'a mut [u64; 8],
    pub has_intensity: &'a mut bool,
}

/// Interpolates at points among the voxels of `cells` and writes the samples that exist.
///
/// Trilinear where all eight corners are observed. Otherwise the observed ones are extrapolated to the point along the gradient between them, which
/// is exact for planes; nothing where too many are unobserved. Between two surfaces, the values of the nearest corner.
pub(crate) struct Interpolate<'a> {
    pub cells: CellArrays<'a>,
    /// All inside of the window.
    pub points: &'a Points,
    /// Scale of the samples.
    pub scale: usize,
    pub samples: Samples<'a>,
    pub group: &'a mut Group,
}

/// A number for each point of a group.
type Lane<T> = [T; LANES];

/// What is known of a group of points while they are interpolated; kept, because clearing it takes time.
pub(crate) struct Group {
    /// The eight voxels around each point. Bit k of a corner's number is its side along axis k.
    corners: [Lane<u32>; 8],
    values: [Lane<f32>; 8],
    /// 1 for observed corners.
    observed: [Lane<f32>; 8],
    /// Interpolation weight of each corner; they sum to 1.
    shares: [Lane<f32>; 8],
    /// By axis and side: the factor of the corner's share.
    along: [[Lane<f32>; 2]; 3],
    gradient: [Lane<f32>; 3],
    /// Distances in voxels of the cells' scale, and weights, 0 where there is no sample.
    distance: Lane<f32>,
    weight: Lane<f32>,
    /// The observed corner with the largest share.
    nearest: Lane<u32>,
}

impl Group {
    pub fn new() -> Self {
        Self {
            corners: [[0; LANES]; 8],
            values: [[0.0; LANES]; 8],
            observed: [[0.0; LANES]; 8],
            shares: [[0.0; LANES]; 8],
            along: [[[0.0; LANES]; 2]; 3],
            gradient: [[0.0; LANES]; 3],
            distance: [0.0; LANES],
            weight: [0.0; LANES],
            nearest: [0; LANES],
        }
    }
}

impl Kernel for Interpolate<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { cells, points, scale, samples, group } = self;
        let (to_edge, edge) = ((1 << cells.scale) as f32, (1 << scale) as f32);
        let mut first = 0;
        while first < points.len() {
            let n = points.lanes(first).min(LANES);
            load(group, &cells, points, first, n);
            interpolate(group, n);
            let (mut steps, mut weights) = ([0i32; LANES], [0i32; LANES]);
            for l in 0..n {
                let d = (group.distance[l] * to_edge / edge * DISTANCE_STEPS).round();
                steps[l] = whole(larger(smaller(d, f32::from(i16::MAX)), f32::from(i16::MIN)));
                weights[l] = whole(larger(smaller(group.weight[l].round(), f32::from(u16::MAX)), 1.0));
            }
            for l in 0..LANES.min(points.len() - first) {
                if group.weight[l] > 0.0 {
                    let i = usize::from(points.voxel[first + l]);
                    samples.voxels[i] = Voxel { distance: steps[l] as i16, weight: weights[l] as u16 };
                    samples.observed[i / 64 % 8] |= 1 << (i % 64);
                    if !cells.intensities.is_empty() {
                        let intensity = cells.intensities[cells.corner(points.cell(first + l), group.nearest[l])];
                        samples.intensities[i] = intensity;
                        *samples.has_intensity |= intensity > 0;
                    }
                }
            }
            first += LANES;
        }
    }
}

/// `x` as an integer; it is one, and its magnitude is below 2^22. A cast would saturate and handle NaN.
#[inline(always)]
fn whole(x: f32) -> i32 {
    const MAGIC: f32 = 12_582_912.0; // 1.5 * 2^23
    (x + MAGIC).to_bits() as i32 - MAGIC.to_bits() as i32
}

impl CellArrays<'_> {
    /// Index of corner `corner` of a cell.
    #[inline(always)]
    fn corner(&self, cell: [i32; 3], corner: u32) -> usize {
        let (shift, mask) = (BLOCK_SHIFT - self.scale as u32, edge_at(self.scale) as u32 - 1);
        let [x, y, z] = [0, 1, 2].map(|k| (cell[k] - self.low[k]) as u32 + (corner >> k & 1));
        let block = (x >> shift) + self.blocks[0] * ((y >> shift) + self.blocks[1] * (z >> shift));
        (self.starts[block as usize] + (x & mask | (y & mask) << shift | (z & mask) << (2 * shift))) as usize
    }
}

/// Reads the voxels around the points from `first` on, and the fractions. One by one: processors gather no faster than they load.
#[inline(always)]
fn load(group: &mut Group, cells: &CellArrays<'_>, points: &Points, first: usize, n: usize) {
    let (row, mask) = (edge_at(cells.scale), edge_at(cells.scale) as i32 - 1);
    let plane = row * row;
    for l in 0..n {
        let cell = points.cell(first + l);
        // The lowest voxel of the window is the first one of a block.
        let is_within_block = [0, 1, 2].iter().all(|&k| cell[k] & mask < mask);
        let start = cells.corner(cell, 0);
        if is_within_block && let Some(voxels) = cells.voxels.get(start..start + plane + row + 2) {
            for i in 0..8 {
                group.corners[i][l] = voxels[(i & 1) + (i >> 1 & 1) * row + (i >> 2) * plane];
            }
        } else {
            for i in 0..8 {
                group.corners[i][l] = cells.voxels[cells.corner(cell, i as u32)];
            }
        }
    }
    for k in 0..3 {
        let fraction = &points.fraction[k][first..first + n];
        for l in 0..n {
            (group.along[k][0][l], group.along[k][1][l]) = (1.0 - fraction[l], fraction[l]);
        }
    }
}

/// Distances, weights and nearest corners of `n` points.
#[inline(always)]
fn interpolate(group: &mut Group, n: usize) {
    let Group { corners, values, observed, shares, along, gradient, distance, weight, nearest } = group;
    let (mut missing, mut known, mut mean, mut sum) = ([0f32; LANES], [0f32; LANES], [0f32; LANES], [0f32; LANES]);
    let (mut low, mut high, mut all) = ([f32::MAX; LANES], [f32::MIN; LANES], [1f32; LANES]);
    // Share, value and weight of the nearest corner so far.
    let (mut best, mut nearest_value, mut nearest_weight) = ([-1f32; LANES], [0f32; LANES], [0f32; LANES]);
    for i in 0..8 {
        for l in 0..n {
            let share = along[0][i & 1][l] * along[1][i >> 1 & 1][l] * along[2][i >> 2][l];
            let value = ((corners[i][l] as i32) << 16 >> 16) as f32 / DISTANCE_STEPS;
            let w = (corners[i][l] >> 16) as i32 as f32;
            let is_observed = if w > 0.0 { 1.0 } else { 0.0 };
            (values[i][l], observed[i][l], shares[i][l]) = (value, is_observed, share);
            missing[l] += if w > 0.0 { 0.0 } else { share };
            known[l] += share * is_observed;
            mean[l] += share * value;
            sum[l] += share * w;
            all[l] *= is_observed;
            low[l] = smaller(low[l], if w > 0.0 { value } else { f32::MAX });
            high[l] = larger(high[l], if w > 0.0 { value } else { f32::MIN });
            let candidate = if w > 0.0 { share } else { -1.0 };
            let is_better = candidate > best[l];
            best[l] = if is_better { candidate } else { best[l] };
            nearest[l] = if is_better { i as u32 } else { nearest[l] };
            nearest_value[l] = if is_better { value } else { nearest_value[l] };
            nearest_weight[l] = if is_better { w } else { nearest_weight[l] };
        }
    }
    for k in 0..3 {
        let (mut change, mut count) = ([0f32; LANES], [0f32; LANES]);
        for i in 0..8 {
            if i >> k & 1 == 0 {
                let j = i | 1 << k;
                for l in 0..n {
                    let both = observed[i][l] * observed[j][l];
                    change[l] += if both > 0.0 { values[j][l] - values[i][l] } else { 0.0 };
                    count[l] += both;
                }
            }
        }
        for l in 0..n {
            gradient[k][l] = change[l] / larger(count[l], 1.0);
        }
    }
    let mut extrapolated = [0f32; LANES];
    for i in 0..8 {
        for l in 0..n {
            let mut beyond = gradient[0][l] * (along[0][1][l] - (i & 1) as f32);
            beyond += gradient[1][l] * (along[1][1][l] - (i >> 1 & 1) as f32);
            beyond += gradient[2][l] * (along[2][1][l] - (i >> 2) as f32);
            let value = values[i][l] + beyond;
            extrapolated[l] += shares[i][l] * if observed[i][l] > 0.0 { value } else { 0.0 };
        }
    }
    for l in 0..n {
        let is_whole = all[l] > 0.0;
        let d = if is_whole { mean[l] } else { extrapolated[l] / known[l] };
        let w = if is_whole { sum[l] } else { sum[l] / known[l] };
        let is_between = high[l] - low[l] > MAX_DIFFERENCE;
        distance[l] = if is_between { nearest_value[l] } else { d };
        let w = if is_between { nearest_weight[l] } else { w };
        weight[l] = if missing[l] <= MAX_MISSING { w } else { 0.0 };
    }
}
