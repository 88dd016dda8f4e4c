//! TSDF fusion: weighted means of the target's voxels and the samples of the source.

use crate::field::tsdf::propagate::{Interpolation, propagate_down};
use crate::field::tsdf::resolve::resolve_block;
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{ObservationCount, TsdfField, Voxel};
use crate::octree::{Cursor, voxel_coords, voxel_index, voxels_at};
use std::ops::Range;

/// A block of the target's lattice.
#[derive(Debug)]
pub(super) struct PatchBlock {
    pub key: u64,
    pub scale: u8,
    /// Beams that observed the source there.
    pub observation_count: ObservationCount,
    /// Its voxels; empty after the merge.
    pub array: EncodedArray,
}

/// The source in the target's lattice, blocks in Morton order.
#[derive(Debug, Default)]
pub(super) struct TsdfPatch {
    blocks: Vec<PatchBlock>,
}

impl TsdfPatch {
    /// A patch of `blocks`, in Morton order.
    pub fn of(blocks: Vec<PatchBlock>) -> Self {
        Self { blocks }
    }

    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Key and scale of each block.
    pub fn keys_and_scales(&self) -> Vec<(u64, u8)> {
        self.blocks.iter().map(|block| (block.key, block.scale)).collect()
    }

    /// Moves blocks `range` into `target`.
    pub fn merge(&mut self, range: Range<usize>, target: &mut TsdfField, max_weight: u16) {
        let blocks = &mut self.blocks[range];
        for block in blocks.iter() {
            if !target.tree.covers(block.key) {
                target.tree.grow_to(block.key);
            }
        }
        let mut cursor = Cursor::new(&target.tree);
        for block in blocks {
            let (array, scale) = (std::mem::take(&mut block.array), usize::from(block.scale));
            let (id, is_new) = target.find_or_create(&mut cursor, block.key, block.scale, array.has_intensity());
            let observation_count = &mut target.blocks[id].observation_count;
            *observation_count = observation_count.plus(block.observation_count.get());
            if is_new {
                target.install(id, scale, &array);
            } else {
                merge_block(target, id, Addend::decode(scale, &array), max_weight);
            }
        }
    }
}

/// Decompressed voxels to be added to a block.
struct Addend {
    scale: usize,
    voxels: Vec<Voxel>,
    intensities: Option<Vec<u8>>,
}

impl Addend {
    fn decode(scale: usize, array: &EncodedArray) -> Self {
        let (voxels, intensities) = array.decode(scale);
        Self { scale, voxels, intensities }
    }
}

/// Merges voxels into block `id` of the target: weighted means at the finer of both scales.
fn merge_block(target: &mut TsdfField, id: u32, addend: Addend, max_weight: u16) {
    let block = *target.block(id);
    let target_scale = usize::from(block.scale);
    let Addend { scale, voxels, intensities } = addend;
    let (resolved_scale, resolved) = resolve_block(target, id, 0);
    let resolved_scale = usize::from(resolved_scale);
    let finest = resolved_scale.min(scale);
    let own = resolved.map_or_else(|| target.current(&block), Vec::from);
    let own_intensities = target.has_intensity(&block).then(|| resize_intensities(target.intensities(&block, target_scale), target_scale, finest));
    let mut sum = refine(own, resolved_scale, finest);
    let other = refine(voxels, scale, finest);
    let intensities = merge_intensities(own_intensities, intensities.map(|s| resize_intensities(s, scale, finest)), &sum, &other);
    // An observation of a coarser voxel is divided among the finer voxels in it.
    let shared_by = [resolved_scale, scale].map(|from| 3 * (from - finest) as u32);
    for (voxel, &other) in sum.iter_mut().zip(&other).filter(|(_, other)| other.is_observed()) {
        *voxel =
            if voxel.is_observed() { mean([*voxel, other], shared_by, max_weight) } else { Voxel { weight: other.weight.min(max_weight), ..other } };
    }
    target.install(id, finest, &EncodedArray::new(finest, &sum, intensities.as_deref()));
}

/// The mean of two intensities by the weights of their voxels.
fn mean_intensity((a, at): (u8, Voxel), (b, bt): (u8, Voxel)) -> u8 {
    // Unknown intensities have weight zero.
    let weight = |intensity: u8, at: Voxel| if intensity == 0 { 0 } else { u32::from(at.weight) };
    let (wa, wb) = (weight(a, at), weight(b, bt));
    ((u32::from(a) * wa + u32::from(b) * wb) / (wa + wb).max(1)) as u8
}

/// The weighted mean of two observed voxels, whose weights are divided by 2^`shared_by`.
fn mean(voxels: [Voxel; 2], shared_by: [u32; 2], max_weight: u16) -> Voxel {
    let weights: [i64; 2] = std::array::from_fn(|i| i64::from(voxels[i].weight >> shared_by[i]).max(1));
    let total: i64 = (0..2).map(|i| i64::from(voxels[i].distance) * weights[i]).sum();
    let sum = weights[0] + weights[1];
    // Rounded to nearest: truncation would move surfaces towards the sensor with every fusion.
    let distance = (2 * total + sum * total.signum()) / (2 * sum);
    Voxel { distance: distance as i16, weight: sum.min(i64::from(max_weight)) as u16 }
}

/// `voxels` of scale `from` at the finer scale `to`.
pub(super) fn refine(mut voxels: Vec<Voxel>, from: usize, to: usize) -> Vec<Voxel> {
    for scale in (to..from).rev() {
        let mut fine = vec![Voxel::default(); voxels_at(scale)];
        propagate_down(&voxels, &mut fine, scale, &Interpolation::NEAR);
        voxels = fine;
    }
    voxels
}

/// Intensities of scale `from` at scale `to`, each from the voxel at the same position.
pub(super) fn resize_intensities(intensities: Vec<u8>, from: usize, to: usize) -> Vec<u8> {
    if from == to {
        return intensities;
    }
    let coordinate = |v: usize| if from >= to { v >> (from - to) } else { v << (to - from) };
    (0..voxels_at(to)).map(|i| intensities[voxel_index(voxel_coords(i, to).map(coordinate), from)]).collect()
}

/// Means of intensities by the weights of their voxels.
fn merge_intensities(own: Option<Vec<u8>>, other: Option<Vec<u8>>, weights: &[Voxel], others: &[Voxel]) -> Option<Vec<u8>> {
    match (own, other) {
        (Some(a), Some(b)) => Some((0..a.len()).map(|i| mean_intensity((a[i], weights[i]), (b[i], others[i]))).collect()),
        (one, None) | (None, one) => one,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::WEIGHT_ONE;

    #[test]
    fn coarse_observations_count_less_among_finer_voxels() {
        let [fine, coarse] = [0, 900].map(|distance| Voxel { distance, weight: 8 * WEIGHT_ONE });
        assert_eq!(mean([fine, coarse], [0, 0], u16::MAX), Voxel { distance: 450, weight: 16 * WEIGHT_ONE });
        assert_eq!(mean([fine, coarse], [0, 3], u16::MAX), Voxel { distance: 100, weight: 9 * WEIGHT_ONE });
        assert_eq!(mean([coarse, fine], [6, 0], u16::MAX), Voxel { distance: 14, weight: 8 * WEIGHT_ONE + 2 });
    }
}
