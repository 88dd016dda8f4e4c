//! The distances of one submap to one kind of seeds: blocks of squared distances, where a seed is within reach.

use crate::seeds::Seeds;
use crate::targets::{BlockSet, TILE, block_of_bit};
use crate::transform::{BlockBox, Transform};
use hashbrown::HashMap;
use rayon::prelude::*;
use voxelastic::octree::{BLOCK_EDGE, block_coords, block_key};

/// Squared distance of a voxel without a seed within reach.
pub(crate) const FAR: u16 = u16::MAX;

/// Squared distances of a block's finest voxels, voxels squared.
pub(crate) type Distances = [u16; 512];

/// How many blocks away a seed may be that is within `reach` voxels: centres of voxels in neighbouring blocks are at least one voxel apart, in the next ones nine.
pub(crate) fn blocks_within(reach: usize) -> usize {
    (reach - 1) / BLOCK_EDGE + 1
}

/// Distances by block. A block that is missing has no seed within reach, or consists of seeds only.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    blocks: HashMap<u64, Box<Distances>>,
}

impl Layer {
    /// The distances of block `key`.
    #[inline]
    pub fn get(&self, key: u64) -> Option<&Distances> {
        self.blocks.get(&key).map(Box::as_ref)
    }

    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    pub fn clear(&mut self) {
        self.blocks.clear();
    }

    /// Keeps the blocks of a set only.
    pub fn retain(&mut self, set: &BlockSet) {
        self.blocks.retain(|key, _| set.contains(block_coords(*key)));
        self.blocks.shrink_to_fit();
    }

    pub fn bytes(&self) -> usize {
        self.blocks.len() * size_of::<Distances>() + self.blocks.capacity() * size_of::<(u64, Box<Distances>)>()
    }

    /// Keys and distances of all blocks.
    #[cfg(test)]
    pub fn iter(&self) -> impl Iterator<Item = (u64, &Distances)> {
        self.blocks.iter().map(|(key, distances)| (*key, distances.as_ref()))
    }

    /// Recomputes everything within `reach` voxels of the `changed` blocks; returns how many blocks that were.
    pub fn update(&mut self, seeds: Seeds<'_>, changed: &BlockSet, reach: usize) -> usize {
        self.recompute(seeds, changed.dilated(blocks_within(reach)), reach)
    }

    /// Recomputes `blocks`; returns how many they are.
    pub fn recompute(&mut self, seeds: Seeds<'_>, blocks: BlockSet, reach: usize) -> usize {
        let tiles = blocks.into_tiles();
        let recompute = |transform: &mut Transform, &(tile, mask): &([i32; 3], u64)| recompute_tile(transform, seeds, tile, mask, reach);
        let results: Vec<Vec<(u64, Option<Box<Distances>>)>> = tiles.par_iter().with_max_len(4).map_init(Transform::default, recompute).collect();
        let mut count = 0;
        for (key, distances) in results.into_iter().flatten() {
            count += 1;
            match distances {
                Some(distances) => drop(self.blocks.insert(key, distances)),
                None => drop(self.blocks.remove(&key)),
            }
        }
        count
    }
}

/// The distances of the blocks of a tile that `mask` holds; none for blocks that are not stored.
fn recompute_tile(transform: &mut Transform, seeds: Seeds<'_>, tile: [i32; 3], mask: u64, reach: usize) -> Vec<(u64, Option<Box<Distances>>)> {
    let corner = tile.map(|c| c * TILE as i32);
    let absolute = |at: [usize; 3]| -> [i32; 3] { std::array::from_fn(|k| corner[k] + at[k] as i32) };
    let wanted: Vec<[usize; 3]> = (0..64).filter(|bit| mask >> bit & 1 == 1).map(block_of_bit).collect();
    let (skipped, computed): (Vec<_>, Vec<_>) = wanted.into_iter().partition(|at| seeds.are_all(absolute(*at)));
    let mut results: Vec<_> = skipped.into_iter().map(|at| (block_key(absolute(at)), None)).collect();
    let bound = |k: usize, pick: fn(usize, usize) -> usize| computed.iter().map(|at| at[k]).reduce(pick).unwrap_or(0);
    let low = [0, 1, 2].map(|k| bound(k, usize::min));
    let size = [0, 1, 2].map(|k| bound(k, usize::max) + 1 - low[k]);
    let any = !computed.is_empty() && transform.run(BlockBox { low: absolute(low), size }, reach, |block| seeds.of_block(block));
    for at in computed {
        let distances = if any { transform.block(std::array::from_fn(|k| at[k] - low[k]), reach, FAR) } else { [FAR; 512] };
        let is_stored = distances.iter().any(|d| *d != FAR) && !(matches!(seeds, Seeds::NotFree(_)) && distances == [0; 512]);
        results.push((block_key(absolute(at)), is_stored.then(|| Box::new(distances))));
    }
    results
}
