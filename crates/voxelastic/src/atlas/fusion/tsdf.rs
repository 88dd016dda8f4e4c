//! TSDF fusion: the source sampled at the target's voxels, then weighted means.

use super::block_cache::BlockCache;
use super::placement::Placement;
use super::sample_grid::{SampleGrid, base_and_fraction};
use super::trilinear::Corners;
use crate::field::tsdf::propagate::{Interpolation, propagate_down};
use crate::field::tsdf::resolve::resolve_block;
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{DISTANCE_STEPS, ObservationCount, TsdfField, Voxel};
use crate::octree::{
    BLOCK_EDGE, BLOCK_SHIFT, Cursor, MAX_BLOCK_COORD, NONE, SCALES, block_coords, block_key, edge_at, voxel_coords, voxel_index, voxels_at,
};
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

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

    /// Its blocks, in Morton order.
    pub fn into_blocks(self) -> Vec<PatchBlock> {
        self.blocks
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

/// Largest number of the source's blocks along an axis that a block of the target can need: its diagonal plus a coarsest voxel on both sides.
const NEAR_EDGE: usize = 5;

/// The source's blocks around a block of the target, looked up once for all of its voxels: indices into the block cache of the part.
struct Neighbourhood {
    low: [i32; 3],
    blocks: [u32; NEAR_EDGE * NEAR_EDGE * NEAR_EDGE],
}

impl Neighbourhood {
    /// Index of the block at `coords` (blocks, source frame), or [`NONE`].
    #[inline(always)]
    fn block(&self, coords: [i32; 3]) -> u32 {
        let [x, y, z] = std::array::from_fn(|k| (coords[k] - self.low[k]) as usize);
        if x.max(y).max(z) < NEAR_EDGE { self.blocks[x + NEAR_EDGE * (y + NEAR_EDGE * z)] } else { NONE }
    }
}

/// A block of the target that the source reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TargetBlock {
    key: u64,
    /// The scale to sample at.
    scale: u8,
    /// Beams that observed the source there.
    observation_count: ObservationCount,
}

impl TargetBlock {
    /// Its Morton key in the target's lattice.
    pub fn key(&self) -> u64 {
        self.key
    }
}

/// Samples a field in the lattice of another one, part by part.
pub(super) struct TsdfSampling<'a> {
    source: &'a TsdfField,
    placement: Placement,
    blocks: Arc<[TargetBlock]>,
}

impl<'a> TsdfSampling<'a> {
    /// A sampling of `blocks`, which [`target_blocks`] found for the same source and placement.
    pub fn new(source: &'a TsdfField, placement: &Placement, blocks: Arc<[TargetBlock]>) -> Self {
        Self { source, placement: *placement, blocks }
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Samples blocks `range`. Each part decompresses the blocks of the source that it needs: decompressing the whole source would take
    /// as much memory as the samples.
    pub fn part(&self, range: Range<usize>) -> TsdfPatch {
        let blocks = &self.blocks[range];
        let mut cursor = Cursor::new(self.source.tree());
        let (mut ids, mut indices) = (Vec::new(), HashMap::new());
        let mut index_of = |id: u32| {
            *indices.entry(id).or_insert_with(|| {
                ids.push(id);
                ids.len() as u32 - 1
            })
        };
        let near: Vec<Neighbourhood> = blocks.iter().map(|block| self.neighbourhood(&mut cursor, block.key, &mut index_of)).collect();
        let sampler = Sampler { placement: &self.placement, cache: BlockCache::new(self.source, ids) };
        let mut grid = SampleGrid::new();
        let sampled = blocks.iter().zip(&near).filter_map(|(block, near)| sampler.block(near, block, &mut grid));
        TsdfPatch { blocks: sampled.collect() }
    }

    /// The source's blocks around the target's block `key`.
    fn neighbourhood(&self, cursor: &mut Cursor, key: u64, mut index_of: impl FnMut(u32) -> u32) -> Neighbourhood {
        let half = 0.5 * BLOCK_EDGE as f32;
        let (middle, extent) = self.placement.box_in_source(block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32 + half), half);
        let low = std::array::from_fn(|k| ((middle[k] - extent[k]) / BLOCK_EDGE as f32).floor() as i32 - 1);
        let blocks = std::array::from_fn(|i| {
            let step = [i % NEAR_EDGE, i / NEAR_EDGE % NEAR_EDGE, i / (NEAR_EDGE * NEAR_EDGE)];
            cursor.block(self.source.tree(), block_key(std::array::from_fn(|k| low[k] + step[k] as i32))).map_or(NONE, &mut index_of)
        });
        Neighbourhood { low, blocks }
    }
}

/// Samples the source at any point and scale.
struct Sampler<'a> {
    placement: &'a Placement,
    cache: BlockCache<'a>,
}

/// A sample: distance in finest voxels, weight, intensity if known.
struct Sample {
    distance: f32,
    weight: f32,
    intensity: Option<u8>,
}

impl Sampler<'_> {
    /// The voxels of a block of the target; none if none of them is observed. Overwrites `grid`.
    fn block(&self, near: &Neighbourhood, block: &TargetBlock, grid: &mut SampleGrid) -> Option<PatchBlock> {
        let TargetBlock { key, scale: at, observation_count } = *block;
        let scale = usize::from(at);
        let edge = (1 << scale) as f32;
        let t = &self.placement.t_source_target;
        grid.fill(t, key, scale);
        let mut voxels = vec![Voxel::default(); voxels_at(scale)];
        let mut intensities: Option<Vec<u8>> = None;
        let mut is_observed = false;
        for (i, voxel) in voxels.iter_mut().enumerate() {
            let sample = match self.cell(near, grid.at(i), scale) {
                Cell::Unknown => continue,
                Cell::Sample(sample) => sample,
                Cell::Coarser => {
                    let (corner, c) = (block_coords(key), voxel_coords(i, scale));
                    let centre = std::array::from_fn(|k| (corner[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * edge);
                    let Some(sample) = self.coarser(near, t.apply(centre), scale) else { continue };
                    sample
                }
            };
            let steps = (sample.distance / edge * DISTANCE_STEPS).round().clamp(f32::from(i16::MIN), f32::from(i16::MAX));
            *voxel = Voxel { distance: steps as i16, weight: sample.weight.round().clamp(1.0, f32::from(u16::MAX)) as u16 };
            is_observed = true;
            if let Some(intensity) = sample.intensity {
                intensities.get_or_insert_with(|| vec![0; voxels_at(scale)])[i] = intensity;
            }
        }
        is_observed.then(|| PatchBlock { key, scale: at, observation_count, array: EncodedArray::new(scale, &voxels, intensities.as_deref()) })
    }

    /// The field at `point` (finest voxels, source frame) next to a block coarser than `scale`: at the finest scale at which all
    /// interpolated samples exist; finer blocks contribute means.
    fn coarser(&self, near: &Neighbourhood, point: [f32; 3], scale: usize) -> Option<Sample> {
        (scale + 1..SCALES).find_map(|scale| match self.cell(near, base_and_fraction(point, scale), scale) {
            Cell::Coarser => None,
            Cell::Unknown => Some(None),
            Cell::Sample(sample) => Some(Some(sample)),
        })?
    }

    /// The eight voxels of `scale` around the point that is `fraction` beyond the centre of voxel `base`.
    #[inline(always)]
    fn cell(&self, near: &Neighbourhood, (base, fraction): ([i32; 3], [f32; 3]), scale: usize) -> Cell {
        let (shift, mask) = (BLOCK_SHIFT as usize - scale, edge_at(scale) - 1);
        let within = base.map(|v| v as usize & mask);
        if within.iter().all(|&v| v < mask) {
            // Most cells lie in one block.
            let block = near.block(base.map(|v| v >> shift));
            if block == NONE {
                return Cell::Unknown;
            }
            if !self.cache.is_resolved_at(block, scale) {
                return Cell::Coarser;
            }
            if !self.cache.is_cell_observed(block, scale, within) {
                return Cell::Unknown;
            }
            let index = |i: usize| voxel_index(std::array::from_fn(|k| within[k] + (i >> k & 1)), scale);
            let voxels = self.cache.voxels(block, scale);
            return self.interpolate(fraction, std::array::from_fn(|i| voxels[index(i)]), scale, |i| (block, index(i)));
        }
        let corner = |i: usize| -> [i32; 3] { std::array::from_fn(|k| base[k] + (i >> k & 1) as i32) };
        let index = |i: usize| voxel_index(corner(i).map(|v| v as usize & mask), scale);
        let blocks: [u32; 8] = std::array::from_fn(|i| near.block(corner(i).map(|v| v >> shift)));
        let mut voxels = [Voxel::default(); 8];
        for i in (0..8).filter(|&i| blocks[i] != NONE) {
            if !self.cache.is_resolved_at(blocks[i], scale) {
                return Cell::Coarser;
            }
            voxels[i] = self.cache.voxels(blocks[i], scale)[index(i)];
        }
        self.interpolate(fraction, voxels, scale, |i| (blocks[i], index(i)))
    }

    /// Interpolates eight voxels of `scale` at `fraction` between them; `voxel_at` returns block and index of each.
    #[inline(always)]
    fn interpolate(&self, fraction: [f32; 3], voxels: [Voxel; 8], scale: usize, voxel_at: impl Fn(usize) -> (u32, usize)) -> Cell {
        let Some(corners) = Corners::around(fraction, voxels) else { return Cell::Unknown };
        let (distance, weight) = corners.interpolate();
        let (block, index) = voxel_at(corners.nearest());
        Cell::Sample(Sample { distance: distance * (1 << scale) as f32, weight, intensity: self.cache.intensity(block, scale, index) })
    }
}

/// The target's blocks that the source reaches, in Morton order. Scale and observation count are those of the source's block at the
/// target block's centre, otherwise those of the coarsest block that touches it.
pub(super) fn target_blocks(field: &TsdfField, placement: &Placement) -> Arc<[TargetBlock]> {
    let half = 0.5 * BLOCK_EDGE as f32;
    let touching = |&id: &u32| {
        let (scale, observation_count) = (field.block(id).finest, field.block(id).observation_count);
        let block = block_coords(field.block(id).key);
        let centre = block.map(|c| c as f32 * BLOCK_EDGE as f32 + half);
        let (middle, extent) = placement.box_in_target(centre, half);
        let low: [i32; 3] = std::array::from_fn(|k| ((middle[k] - extent[k]) / BLOCK_EDGE as f32).floor() as i32);
        let high: [i32; 3] = std::array::from_fn(|k| ((middle[k] + extent[k]) / BLOCK_EDGE as f32).floor() as i32);
        let mut found = Vec::new();
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let c = [x, y, z];
                    let (at, reach) = placement.box_in_source(c.map(|v| v as f32 * BLOCK_EDGE as f32 + half), half);
                    let is_outside = (0..3).any(|k| (at[k] - centre[k]).abs() > reach[k] + half);
                    if !is_outside && c.iter().all(|v| v.abs() < MAX_BLOCK_COORD) {
                        let is_at_centre = at.map(|v| (v / BLOCK_EDGE as f32).floor() as i32) == block;
                        // Sorts the block at the centre first, then the coarsest.
                        let rank = if is_at_centre { 0 } else { SCALES as u8 - scale };
                        found.push((rank, TargetBlock { key: block_key(c), scale, observation_count }));
                    }
                }
            }
        }
        found
    };
    let ids: Vec<u32> = field.ids().collect();
    let mut blocks: Vec<(u8, TargetBlock)> = ids.par_iter().with_min_len(256).flat_map_iter(touching).collect();
    // All fields are compared: which block is kept must not depend on threads.
    blocks.par_sort_unstable_by_key(|(rank, block)| (block.key, *rank, block.scale, block.observation_count));
    blocks.dedup_by_key(|(_, block)| block.key);
    blocks.into_iter().map(|(_, block)| block).collect()
}

/// The field at a point at one scale.
enum Cell {
    /// One of the blocks is coarser than that scale.
    Coarser,
    /// Too few voxels are observed.
    Unknown,
    Sample(Sample),
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
