//! Blocks of one submap in the lattice of another, merged there.

use crate::atlas::fusion::alignment::Displacement;
use crate::atlas::fusion::colour::ColourPatch;
use crate::atlas::fusion::combine::{Agreement, combine};
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::sampled_block::{SampledBlock, resize_intensities};
use crate::atlas::fusion::tsdf_sampling::{TsdfSampling, displaced_target_blocks};
use crate::field::tsdf::resolve::resolve_block;
use crate::field::tsdf::{TsdfField, Voxel};
use crate::octree::{BLOCK_EDGE, Cursor, block_coords, block_key, voxel_coords, voxels_at};
use hashbrown::HashSet;
use rayon::prelude::*;
use std::sync::Arc;

/// Blocks per task.
pub(super) const BLOCKS_PER_PART: usize = 1024;

/// Samples in the lattice of another field, in Morton order, with their colours.
pub(super) struct Transfer {
    pub blocks: Vec<SampledBlock>,
    pub colours: Vec<ColourPatch>,
}

/// Samples what lies in blocks `ids` of a field in another lattice.
pub(super) fn sampled(field: &TsdfField, placement: &Placement, ids: &[u32]) -> Transfer {
    let keys: HashSet<u64> = ids.iter().map(|id| field.block(*id).key).collect();
    let targets = displaced_target_blocks(field, placement, &Displacement::default(), ids, 0.0);
    let part = |start: usize| {
        let sampling = TsdfSampling::new(field, placement, Arc::clone(&targets));
        let mut blocks = sampling.sample(start..(start + BLOCKS_PER_PART).min(targets.len()));
        blocks.retain_mut(|block| keep_within(block, placement, &keys));
        Transfer::new(field, placement, blocks)
    };
    let starts: Vec<usize> = (0..targets.len()).step_by(BLOCKS_PER_PART).collect();
    Transfer::joined(starts.into_par_iter().map(part).collect())
}

impl Transfer {
    /// Samples of a field, with the colours that it has there.
    pub fn new(field: &TsdfField, placement: &Placement, blocks: Vec<SampledBlock>) -> Self {
        let keys_and_scales: Vec<(u64, u8)> = blocks.iter().map(|block| (block.key, block.scale)).collect();
        let colours = ColourPatch::sample(field, placement, &Displacement::default(), &keys_and_scales);
        Self { blocks, colours: vec![colours] }
    }

    /// Parts in their order.
    pub fn joined(parts: Vec<Self>) -> Self {
        let mut all = Self { blocks: Vec::new(), colours: Vec::new() };
        for part in parts {
            all.blocks.extend(part.blocks);
            all.colours.extend(part.colours);
        }
        all
    }

    /// The keys of the blocks.
    pub fn keys(&self) -> impl Iterator<Item = u64> + '_ {
        self.blocks.iter().map(|block| block.key)
    }

    /// Merges the samples into a field, with weights up to `max_weight`.
    pub fn merge_into(self, field: &mut TsdfField, max_weight: u16) {
        for key in self.keys() {
            if !field.tree.covers(key) {
                field.tree.grow_to(key);
            }
        }
        let combined = |sample: SampledBlock| {
            let own = field.find(sample.key).map(|id| own_block(field, id));
            let mut block = combine(own.into_iter().chain([sample]).collect(), &mut Agreement::default())?;
            block.voxels.iter_mut().for_each(|voxel| voxel.weight = voxel.weight.min(max_weight));
            Some(block.encode())
        };
        let combined: Vec<_> = self.blocks.into_par_iter().map(combined).collect();
        let mut cursor = Cursor::new(&field.tree);
        for block in combined.into_iter().flatten() {
            let (id, _) = field.find_or_create(&mut cursor, block.key, block.scale, block.array.has_intensity());
            field.blocks[id].observation_count = block.observation_count;
            field.install(id, block.scale.into(), &block.array);
        }
        self.colours.iter().for_each(|colours| colours.merge(0..usize::MAX, field));
    }
}

/// Makes voxels of a target's block unobserved whose centres are not in one of the source's blocks `keys`; returns whether any voxel is left.
fn keep_within(block: &mut SampledBlock, placement: &Placement, keys: &HashSet<u64>) -> bool {
    let (scale, corner) = (usize::from(block.scale), block_coords(block.key).map(|c| (c * BLOCK_EDGE as i32) as f32));
    let mut last = None;
    let mut is_within = |c: [usize; 3]| {
        let centre = std::array::from_fn(|k| corner[k] + (c[k] as f32 + 0.5) * (1 << scale) as f32);
        let at = placement.t_source_target.apply(centre).map(|c| (c / BLOCK_EDGE as f32).floor() as i32);
        match last {
            Some((known, is_within)) if known == at => is_within,
            _ => last.insert((at, keys.contains(&block_key(at)))).1,
        }
    };
    for i in 0..voxels_at(scale) {
        if block.voxels[i].is_observed() && !is_within(voxel_coords(i, scale)) {
            block.voxels[i] = Voxel::default();
            block.observed[i / 64] &= !(1 << (i % 64));
            if let Some(intensities) = &mut block.intensities {
                intensities[i] = 0;
            }
        }
    }
    block.observed.iter().any(|word| *word != 0)
}

/// The scale and the voxels of a block at its finest scale.
pub(super) fn voxels_of(field: &TsdfField, id: u32) -> (usize, Vec<Voxel>) {
    let (scale, resolved) = resolve_block(field, id, 0);
    (scale.into(), resolved.map_or_else(|| field.current(field.block(id)), Vec::from))
}

/// A block as if it had been sampled.
fn own_block(field: &TsdfField, id: u32) -> SampledBlock {
    let block = field.block(id);
    let ((scale, voxels), from) = (voxels_of(field, id), usize::from(block.scale));
    let intensities = field.has_intensity(block).then(|| resize_intensities(field.intensities(block, from), from, scale).into());
    SampledBlock::new(block.key, scale as u8, block.observation_count, voxels.into(), intensities)
}
