//! Bit masks of a block's known voxels and of those behind the surface, and the distances of the known ones.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::block_grid::{BlockGrid, PART, part_of};
use super::resolved_blocks::ResolvedBlocks;
use crate::field::tsdf::{DISTANCE_STEPS, Voxel, VoxelBuffer};
use crate::octree::{edge_at, voxel_index, voxels_at};
use crate::simd::bits::{lowest_bits, rank};
use crate::simd::{Kernel, dispatch};
use bytemuck::Zeroable;
use rayon::prelude::*;

/// A bit per voxel of a block: bit x + 8 y of layer z at every scale. The number of the bit over all layers is the voxel's *mask index*.
pub(crate) type Bits = [u64; 8];

/// The bits of a layer that a block with an edge of `n` voxels uses.
#[inline(always)]
pub(crate) fn valid(n: usize) -> u64 {
    (u64::MAX >> (64 - 8 * n)) & (0x0101_0101_0101_0101 * ((1 << n) - 1))
}

/// Mask index of a voxel.
#[inline(always)]
pub(crate) fn mask_index(c: [usize; 3]) -> usize {
    c[0] | c[1] << 3 | c[2] << 6
}

/// Coordinates of the voxel with a mask index.
#[inline(always)]
pub(crate) fn coords(mask_index: usize) -> [usize; 3] {
    [mask_index & 7, mask_index >> 3 & 7, mask_index >> 6]
}

/// Neighbouring voxels whose distances differ by more than this many times their spacing are not on one surface: the band in front of one
/// surface meets the band behind another.
pub(crate) const MAX_SLOPE: f32 = 4.0;
/// A distance changes that fast only if one of the two voxels is farther from the surface than this, steps.
pub(crate) const FAR: u16 = (MAX_SLOPE / 2.0 * DISTANCE_STEPS) as u16;

/// Masks of a block's voxels. Aligned to cache lines, because little is read of neighbouring blocks.
#[derive(Clone, Copy, Zeroable)]
#[repr(C, align(64))]
pub(crate) struct BlockMasks {
    /// Voxels that were observed often enough, or that fill holes.
    pub known: Bits,
    /// Known voxels behind the surface.
    pub behind: Bits,
    /// Known voxels farther from it than [`FAR`].
    pub far: Bits,
    /// Index of the block's first distance in the part's list, and number of distances before those of each layer.
    pub start: u32,
    pub before: [u16; 8],
}

impl BlockMasks {
    /// One of the masks.
    #[inline(always)]
    pub fn bits(&self, kind: MaskKind) -> &Bits {
        match kind {
            MaskKind::Known => &self.known,
            MaskKind::Behind => &self.behind,
            MaskKind::Far => &self.far,
        }
    }

    pub const EMPTY: Self = Self { known: [0; 8], behind: [0; 8], far: [0; 8], start: 0, before: [0; 8] };
}

/// Selects a mask of [`BlockMasks`].
#[derive(Clone, Copy)]
pub(crate) enum MaskKind {
    Known,
    Behind,
    Far,
}

/// Measured distances of a block.
#[derive(Clone, Copy)]
pub(crate) struct BlockDistances<'a> {
    masks: &'a BlockMasks,
    distances: &'a [i16],
}

impl BlockDistances<'_> {
    /// Writes all distances by mask index.
    #[inline(always)]
    pub fn spread(&self, steps: &mut [f32; voxels_at(0)]) {
        let mut next = 0;
        for z in 0..8 {
            let mut left = self.masks.known[z];
            while left != 0 {
                steps[64 * z + left.trailing_zeros() as usize] = f32::from(self.distances[next]);
                next += 1;
                left &= left - 1;
            }
        }
    }

    /// Distance of the voxel with `mask_index` in steps of its scale; none if it was not measured.
    #[inline(always)]
    pub fn steps(&self, mask_index: usize) -> Option<i16> {
        let (layer, bit) = (mask_index >> 6 & 7, mask_index & 63);
        let known = self.masks.known[layer];
        (known >> bit & 1 == 1).then(|| self.distances[usize::from(self.masks.before[layer]) + rank(known, bit)])
    }
}

/// The measured voxels of all blocks, by rank.
pub(crate) struct MaskedField {
    pub blocks: Vec<BlockMasks>,
    /// Their distances in steps of the block's scale, by part, block and mask index.
    distances: Vec<Vec<i16>>,
}

impl MaskedField {
    /// Masks and distances of all voxels with a weight of at least `min_weight`.
    pub fn new(resolved: &ResolvedBlocks<'_>, grid: &BlockGrid, min_weight: u16) -> Self {
        let mut blocks: Vec<BlockMasks> = bytemuck::allocation::zeroed_vec(grid.heads.len());
        let parts = blocks.par_chunks_mut(PART).zip(grid.heads.par_chunks(PART));
        let distances = parts.map(|(blocks, heads)| {
            let mut distances = Vec::with_capacity(PART * voxels_at(0) / 4);
            let mut voxels = [Voxel::default(); voxels_at(0)];
            for (masks, head) in blocks.iter_mut().zip(heads) {
                resolved.copy(head.id, &mut voxels);
                dispatch(ExtractMasks { voxels: &voxels, masks, distances: &mut distances, scale: head.scale.into(), min_weight });
            }
            distances
        });
        let distances = distances.collect();
        Self { blocks, distances }
    }

    /// Measured distances of block `rank`.
    #[inline(always)]
    pub fn of(&self, rank: usize) -> BlockDistances<'_> {
        let masks = &self.blocks[rank];
        BlockDistances { masks, distances: &self.distances[part_of(rank)][masks.start as usize..] }
    }
}

/// Computes the masks of a block.
struct ExtractMasks<'a> {
    voxels: &'a VoxelBuffer,
    masks: &'a mut BlockMasks,
    distances: &'a mut Vec<i16>,
    scale: usize,
    min_weight: u16,
}

impl Kernel for ExtractMasks<'_> {
    #[inline(always)]
    fn run(self) {
        let (voxels, n) = (self.voxels, edge_at(self.scale));
        // By mask index, a bit for each of known, behind and far.
        let mut flags = [0; voxels_at(0)];
        if n == 8 {
            for i in 0..voxels_at(0) {
                flags[i] = flags_of(voxels[i], self.min_weight);
            }
        } else {
            for z in 0..n {
                for y in 0..n {
                    for x in 0..n {
                        flags[mask_index([x, y, z])] = flags_of(voxels[voxel_index([x, y, z], self.scale) % voxels_at(0)], self.min_weight);
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
            (self.masks.known[z], self.masks.behind[z], self.masks.far[z]) = (known, behind, far);
            self.masks.before[z] = count as u16;
            let mut left = known;
            while left != 0 {
                let at = voxel_index(coords(64 * z + left.trailing_zeros() as usize), self.scale);
                distances[count % voxels_at(0)] = voxels[at % voxels_at(0)].distance;
                count += 1;
                left &= left - 1;
            }
        }
        self.masks.start = self.distances.len() as u32;
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
        fn masks_and_distances_equal_the_voxels(voxels in prop::collection::vec((any::<i16>(), 0u16..4), voxels_at(0)), scale in 0usize..4) {
            let mut all = [Voxel::default(); voxels_at(0)];
            voxels.iter().zip(&mut all).for_each(|(&(distance, weight), voxel)| *voxel = Voxel { distance, weight });
            let (mut masks, mut distances) = (BlockMasks::EMPTY, vec![7; 5]);
            dispatch(ExtractMasks { voxels: &all, masks: &mut masks, distances: &mut distances, scale, min_weight: 2 });
            let measured = BlockDistances { masks: &masks, distances: &distances[5..] };
            let mut spread = [f32::NAN; voxels_at(0)];
            measured.spread(&mut spread);
            let n = edge_at(scale);
            for at in 0..voxels_at(0) {
                let c = coords(at);
                let voxel = if c.iter().all(|&v| v < n) { all[voxel_index(c, scale)] } else { Voxel::default() };
                let known = voxel.weight >= 2;
                let bit = |bits: &Bits| bits[at / 64] >> (at % 64) & 1 == 1;
                prop_assert_eq!(mask_index(c), at);
                prop_assert_eq!(valid(n) >> (at % 64) & 1 == 1, c[0] < n && c[1] < n);
                prop_assert_eq!(measured.steps(at), known.then_some(voxel.distance));
                prop_assert_eq!(spread[at].is_nan(), !known);
                prop_assert!(!known || spread[at] == f32::from(voxel.distance));
                prop_assert_eq!(bit(&masks.known), known);
                prop_assert_eq!(bit(&masks.behind), known && voxel.distance < 0);
                prop_assert_eq!(bit(&masks.far), known && f32::from(voxel.distance).abs() > f32::from(FAR));
            }
        }
    }
}
