//! TSDF fusion: weighted means of the target's voxels and the samples of the source.

use super::samples::sampled_block::{SampledBlock, refine, resize_intensities};
use crate::field::tsdf::resolve::resolve_block;
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{TsdfField, Voxel};
use crate::octree::Cursor;
use std::ops::Range;

/// The source in the target's lattice, blocks in Morton order. They are not encoded: few parts are in memory at once, and most blocks are merged
/// with one of the target, which needs their voxels.
#[derive(Debug, Default)]
pub(super) struct TsdfPatch {
    blocks: Vec<SampledBlock>,
}

impl TsdfPatch {
    /// A patch of `blocks`, in Morton order.
    pub fn of(blocks: Vec<SampledBlock>) -> Self {
        Self { blocks }
    }

    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Key and scale of each block.
    pub fn keys_and_scales(&self) -> Vec<(u64, u8)> {
        self.blocks.iter().map(|block| (block.key, block.scale)).collect()
    }

    /// Merges blocks `range` into `target`.
    pub fn merge(&self, range: Range<usize>, target: &mut TsdfField, max_weight: u16) {
        let blocks = &self.blocks[range];
        for block in blocks {
            if !target.tree.covers(block.key) {
                target.tree.grow_to(block.key);
            }
        }
        let mut cursor = Cursor::new(&target.tree);
        for block in blocks {
            let intensities = block.intensities.as_deref();
            let (id, is_new) = target.find_or_create(&mut cursor, block.key, block.scale, intensities.is_some());
            let observation_count = &mut target.blocks[id].observation_count;
            *observation_count = observation_count.plus(block.observation_count.get());
            if is_new {
                let scale = usize::from(block.scale);
                target.install(id, scale, &EncodedArray::new(scale, &block.voxels, intensities));
            } else {
                merge_block(target, id, block, max_weight);
            }
        }
    }
}

/// Merges a block into block `id` of the target: weighted means at the finer of both scales.
fn merge_block(target: &mut TsdfField, id: u32, addend: &SampledBlock, max_weight: u16) {
    let block = *target.block(id);
    let (target_scale, scale) = (usize::from(block.scale), usize::from(addend.scale));
    let (resolved_scale, resolved) = resolve_block(target, id, 0);
    let resolved_scale = usize::from(resolved_scale);
    let finest = resolved_scale.min(scale);
    let own = resolved.map_or_else(|| target.current(&block), Vec::from);
    let own_intensities = target.has_intensity(&block).then(|| resize_intensities(target.intensities(&block, target_scale), target_scale, finest));
    let mut sum = refine(own, resolved_scale, finest);
    let refined = (scale > finest).then(|| refine(addend.voxels.to_vec(), scale, finest));
    let other = refined.as_deref().unwrap_or(&addend.voxels);
    let intensities = addend.intensities.as_ref().map(|s| resize_intensities(s.to_vec(), scale, finest));
    let intensities = merge_intensities(own_intensities, intensities, &sum, other);
    // An observation of a coarser voxel is divided among the finer voxels in it.
    let shared_by = [resolved_scale, scale].map(|from| 3 * (from - finest) as u32);
    for (voxel, &other) in sum.iter_mut().zip(other).filter(|(_, other)| other.is_observed()) {
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
