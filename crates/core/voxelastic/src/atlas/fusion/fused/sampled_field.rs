//! The fused field of a map that grows and bends: what is gathered from submaps is sampled here, on any thread.

use super::fused_tsdf::{FusedTsdf, Reached};
use crate::atlas::fusion::alignment::Displacement;
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::samples::tsdf_sampling::{TargetBlock, displaced_target_blocks};
use crate::field::tsdf::TsdfField;
use hashbrown::HashMap;
use rayon::prelude::*;
use std::sync::Arc;

/// log2 of the edge of a cube, blocks. A cube is named by what the keys of its blocks begin with. Cubes are as small as those in which submaps are sampled, because what
/// is around a tile is sampled with it.
pub(crate) const CUBE_SHIFT: u32 = 2;

/// Blocks per part: few, because few cubes are renewed at a time.
const BLOCKS_PER_PART: usize = 128;

/// A copy of what some cubes are made of.
#[derive(Debug, Default)]
pub(crate) struct Gathered {
    /// Ascending.
    pub(crate) cubes: Vec<u64>,
    pub(crate) sources: Vec<GatheredSource>,
}

/// The blocks of a TSDF in and around some cubes.
#[derive(Debug)]
pub(crate) struct GatheredSource {
    pub(crate) field: TsdfField,
    pub(in crate::atlas::fusion) placement: Placement,
    pub(in crate::atlas::fusion) displacement: Arc<Displacement>,
    /// The blocks that reach the cubes, ascending.
    pub(crate) reached: Vec<u32>,
}

/// The map as one field, as far as it was sampled.
#[derive(Debug, Default)]
pub(crate) struct SampledField {
    one: FusedTsdf,
    /// The blocks that were sampled, by cube.
    made: HashMap<u64, Vec<u64>>,
}

impl SampledField {
    /// The field in the map frame. Cubes that were not renewed yet are as they were, or empty.
    pub fn field(&self) -> &TsdfField {
        &self.one.field
    }

    /// Samples cubes.
    pub fn renew(&mut self, gathered: &Gathered) {
        let cube_of = |key: u64| key >> (3 * CUBE_SHIFT);
        let reached: Vec<Reached<'_>> = gathered.sources.iter().map(|source| source.reached_in(&gathered.cubes)).collect();
        let mut keys: Vec<u64> = reached.iter().flat_map(|source| source.blocks.iter().map(TargetBlock::key)).collect();
        keys.par_sort_unstable();
        keys.dedup();
        let mut made: HashMap<u64, Vec<u64>> = gathered.cubes.iter().map(|cube| (*cube, Vec::new())).collect();
        keys.iter().for_each(|key| made.entry(cube_of(*key)).or_default().push(*key));
        // What nothing reaches any more becomes empty.
        keys.extend(gathered.cubes.iter().filter_map(|cube| self.made.get(cube)).flatten());
        keys.par_sort_unstable();
        keys.dedup();
        self.one.sample(&reached, &keys, BLOCKS_PER_PART);
        self.made.extend(made);
    }
}

impl GatheredSource {
    fn reached_in(&self, cubes: &[u64]) -> Reached<'_> {
        let all = displaced_target_blocks(&self.field, &self.placement, &self.displacement, &self.reached);
        let is_in = |block: &&TargetBlock| cubes.binary_search(&(block.key() >> (3 * CUBE_SHIFT))).is_ok();
        let blocks = all.iter().filter(is_in).copied().collect();
        Reached { field: &self.field, placement: self.placement, displacement: &self.displacement, blocks }
    }
}
