//! What a mesh needs of a block's voxels: bit masks of where they are known and on which side, and the distances of the known ones.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::layout::{Layout, PART, part_of};
use super::view::View;
use crate::dispatch::{Kernel, dispatch};
use crate::field::tsdf::{DISTANCE_STEPS, Voxel, VoxelBuffer};
use crate::geometry::bits::{lowest_bits, rank};
use crate::octree::{edge_at, voxel_index, voxels_at};
use bytemuck::Zeroable;
use rayon::prelude::*;

/// A bit per voxel of a block: bit x + 8 y of layer z, whatever the block's scale. The bit's number over all layers is the voxel's *place*.
pub(super) type Bits = [u64; 8];

/// The bits of a layer that a block with an edge of `n` voxels has.
#[inline(always)]
pub(super) fn valid(n: usize) -> u64 {
    (u64::MAX >> (64 - 8 * n)) & (0x0101_0101_0101_0101 * ((1 << n) - 1))
}

/// The place of a voxel.
#[inline(always)]
pub(super) fn place(c: [usize; 3]) -> usize {
    c[0] | c[1] << 3 | c[2] << 6
}

/// The voxel at a place.
#[inline(always)]
pub(super) fn coords(place: usize) -> [usize; 3] {
    [place & 7, place >> 3 & 7, place >> 6]
}

/// A distance between neighbouring voxels that changes faster than this many times their spacing is no surface, but the
/// place where the band in front of one surface meets the band behind another.
pub(super) const MAX_SLOPE: f32 = 4.0;
/// Only between voxels of which one is farther away than this does a distance change that fast, in steps.
pub(super) const FAR: u16 = (MAX_SLOPE / 2.0 * DISTANCE_STEPS) as u16;

/// The voxels of a block that count. In lines of a cache, because blocks around are asked for little.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Samples {
    /// Those that were observed often enough, or lie in gaps that were closed.
    pub known: Bits,
    /// Those of them behind the surface.
    pub behind: Bits,
    /// Those of them that are farther from it than [`FAR`].
    pub far: Bits,
    /// Where the values that go with them begin in the part's list, and how many there are before those of each layer.
    pub start: u32,
    pub before: [u16; 8],
}

impl Samples {
    /// One of the three.
    #[inline(always)]
    pub fn bits(&self, which: Which) -> &Bits {
        match which {
            Which::Known => &self.known,
            Which::Behind => &self.behind,
            Which::Far => &self.far,
        }
    }

    pub const EMPTY: Self = Self { known: [0; 8], behind: [0; 8], far: [0; 8], start: 0, before: [0; 8] };
}

/// Names the bits of [`Samples`].
#[derive(Clone, Copy)]
pub(super) enum Which {
    Known,
    Behind,
    Far,
}

/// What was measured in a block.
#[derive(Clone, Copy)]
pub(super) struct Measured<'a> {
    samples: &'a Samples,
    distances: &'a [i16],
}

impl Measured<'_> {
    /// Writes all distances to their places.
    #[inline(always)]
    pub fn spread(&self, steps: &mut [f32; voxels_at(0)]) {
        let mut next = 0;
        for z in 0..8 {
            let mut left = self.samples.known[z];
            while left != 0 {
                steps[64 * z + left.trailing_zeros() as usize] = f32::from(self.distances[next]);
                next += 1;
                left &= left - 1;
            }
        }
    }

    /// Distance of the voxel at `place` in steps of its scale; none where nothing was measured.
    #[inline(always)]
    pub fn steps(&self, place: usize) -> Option<i16> {
        let (layer, bit) = (place >> 6 & 7, place & 63);
        let known = self.samples.known[layer];
        (known >> bit & 1 == 1).then(|| self.distances[usize::from(self.samples.before[layer]) + rank(known, bit)])
    }
}

/// The measured voxels of all blocks, by rank.
pub(super) struct Field {
    pub blocks: Vec<Samples>,
    /// Their distances in steps of the block's scale, by part, block and place.
    distances: Vec<Vec<i16>>,
}

impl Field {
    /// Takes from all blocks the voxels of at least `min_weight`.
    pub fn take(view: &View<'_>, layout: &Layout, min_weight: u16) -> Self {
        let mut blocks: Vec<Samples> = bytemuck::allocation::zeroed_vec(layout.heads.len());
        let parts = blocks.par_chunks_mut(PART).zip(layout.heads.par_chunks(PART));
        let distances = parts.map(|(blocks, heads)| {
            let mut distances = Vec::with_capacity(PART * voxels_at(0) / 4);
            let mut voxels = [Voxel::default(); voxels_at(0)];
            for (samples, head) in blocks.iter_mut().zip(heads) {
                view.copy(head.id, &mut voxels);
                dispatch(Take { voxels: &voxels, samples, distances: &mut distances, scale: head.scale.into(), min_weight });
            }
            distances
        });
        let distances = distances.collect();
        Self { blocks, distances }
    }

    /// What was measured in block `rank`.
    #[inline(always)]
    pub fn of(&self, rank: usize) -> Measured<'_> {
        let samples = &self.blocks[rank];
        Measured { samples, distances: &self.distances[part_of(rank)][samples.start as usize..] }
    }
}

/// Takes the voxels of a block.
struct Take<'a> {
    voxels: &'a VoxelBuffer,
    samples: &'a mut Samples,
    distances: &'a mut Vec<i16>,
    scale: usize,
    min_weight: u16,
}

impl Kernel for Take<'_> {
    #[inline(always)]
    fn run(self) {
        let (voxels, n) = (self.voxels, edge_at(self.scale));
        // By place, a bit for each of known, behind and far.
        let mut flags = [0; voxels_at(0)];
        if n == 8 {
            for i in 0..voxels_at(0) {
                flags[i] = flags_of(voxels[i], self.min_weight);
            }
        } else {
            for z in 0..n {
                for y in 0..n {
                    for x in 0..n {
                        flags[place([x, y, z])] = flags_of(voxels[voxel_index([x, y, z], self.scale) % voxels_at(0)], self.min_weight);
                    }
                }
            }
        }
        let (mut distances, mut count) = ([0; voxels_at(0)], 0);
        for z in 0..n {
            let [mut known, mut behind, mut far] = [0; 3];
            for y in 0..8 {
                let mut row = 0;
                for x in 0..8 {
                    row |= u64::from(flags[64 * z + 8 * y + x]) << (8 * x);
                }
                known |= lowest_bits(row) << (8 * y);
                behind |= lowest_bits(row >> 1) << (8 * y);
                far |= lowest_bits(row >> 2) << (8 * y);
            }
            (self.samples.known[z], self.samples.behind[z], self.samples.far[z]) = (known, behind, far);
            self.samples.before[z] = count as u16;
            let mut left = known;
            while left != 0 {
                let at = voxel_index(coords(64 * z + left.trailing_zeros() as usize), self.scale);
                distances[count % voxels_at(0)] = voxels[at % voxels_at(0)].distance;
                count += 1;
                left &= left - 1;
            }
        }
        self.samples.start = self.distances.len() as u32;
        self.distances.extend_from_slice(&distances[..count]);
    }
}

#[inline(always)]
fn flags_of(Voxel { distance, weight }: Voxel, min_weight: u16) -> u8 {
    let known = weight >= min_weight;
    u8::from(known) | u8::from(known & (distance < 0)) << 1 | u8::from(known & (distance.unsigned_abs() > FAR)) << 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_was_taken_is_found_again(voxels in prop::collection::vec((any::<i16>(), 0u16..4), voxels_at(0)), scale in 0usize..4) {
            let mut all = [Voxel::default(); voxels_at(0)];
            voxels.iter().zip(&mut all).for_each(|(&(distance, weight), voxel)| *voxel = Voxel { distance, weight });
            let (mut samples, mut distances) = (Samples::EMPTY, vec![7; 5]);
            dispatch(Take { voxels: &all, samples: &mut samples, distances: &mut distances, scale, min_weight: 2 });
            let measured = Measured { samples: &samples, distances: &distances[5..] };
            let mut spread = [f32::NAN; voxels_at(0)];
            measured.spread(&mut spread);
            let n = edge_at(scale);
            for at in 0..voxels_at(0) {
                let c = coords(at);
                let voxel = if c.iter().all(|&v| v < n) { all[voxel_index(c, scale)] } else { Voxel::default() };
                let known = voxel.weight >= 2;
                let bit = |bits: &Bits| bits[at / 64] >> (at % 64) & 1 == 1;
                prop_assert_eq!(place(c), at);
                prop_assert_eq!(valid(n) >> (at % 64) & 1 == 1, c[0] < n && c[1] < n);
                prop_assert_eq!(measured.steps(at), known.then_some(voxel.distance));
                prop_assert_eq!(spread[at].is_nan(), !known);
                prop_assert!(!known || spread[at] == f32::from(voxel.distance));
                prop_assert_eq!(bit(&samples.known), known);
                prop_assert_eq!(bit(&samples.behind), known && voxel.distance < 0);
                prop_assert_eq!(bit(&samples.far), known && f32::from(voxel.distance).abs() > f32::from(FAR));
            }
        }
    }
}
