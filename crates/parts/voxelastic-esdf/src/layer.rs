//! The distances of one submap to one kind of seeds: blocks of squared distances, where a seed is within reach.

use crate::seeds::Seeds;
use crate::targets::{BlockSet, TILE, block_of_bit};
use crate::transform::{BlockBox, SeedBits, Transform};
use hashbrown::HashMap;
use hashbrown::hash_map::Entry;
use rayon::prelude::*;
use voxelastic::field::occupancy::BlockBits;
use voxelastic::octree::{block_coords, block_key};

/// Squared distance of a voxel without a seed within reach.
pub(crate) const FAR: u16 = u16::MAX;

/// Squared distances of a block's finest voxels, voxels squared.
pub(crate) type Distances = [u16; 512];

/// Distances by block. A block that is missing has no seed within reach, or consists of seeds only.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    blocks: HashMap<u64, Box<Distances>>,
    /// Lowest and highest coordinates of all blocks that were ever stored.
    bounds: Option<[[i32; 3]; 2]>,
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

    /// Lowest and highest coordinates of a box of blocks: those outside of it are missing.
    pub fn bounds(&self) -> Option<[[i32; 3]; 2]> {
        self.bounds
    }

    pub fn clear(&mut self) {
        self.blocks.clear();
        self.bounds = None;
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

    /// Recomputes what may differ because of seeds that began or ended in the `changed` blocks; returns how many blocks that were.
    pub fn update(&mut self, seeds: Seeds<'_>, changed: &BlockSet, reach: usize) -> usize {
        let mut limits: HashMap<[i32; 3], i32> = HashMap::new();
        let limit = |block: [i32; 3]| *limits.entry(block).or_insert_with(|| self.largest(block, reach));
        let targets = changed.within_reach(reach, |block| bounds(&self.changed_seeds(seeds, block)), limit);
        self.recompute(seeds, targets, reach)
    }

    /// The largest squared distance in a block, at most that of the reach: seeds that are farther than that, new ones or old ones, change nothing in it.
    fn largest(&self, block: [i32; 3], reach: usize) -> i32 {
        let largest = self.get(block_key(block)).map_or(FAR, |distances| distances.iter().fold(0, |largest, d| largest.max(*d)));
        i32::from(largest).min((reach * reach) as i32)
    }

    /// The voxels of a block that are seeds and were not, or were and are not.
    fn changed_seeds(&self, seeds: Seeds<'_>, block: [i32; 3]) -> BlockBits {
        let now = seeds.of_block(block);
        match self.get(block_key(block)) {
            Some(distances) => std::array::from_fn(|z| {
                let before = distances[64 * z..64 * (z + 1)].iter().enumerate().fold(0, |bits, (i, d)| bits | u64::from(*d == 0) << i);
                before ^ now[z]
            }),
            // It may have had none, or seeds only.
            None if matches!(seeds, Seeds::NotFree(_)) => [u64::MAX; 8],
            None => now,
        }
    }

    /// Recomputes `blocks`; returns how many they are.
    pub fn recompute(&mut self, seeds: Seeds<'_>, blocks: BlockSet, reach: usize) -> usize {
        let tiles = blocks.into_tiles();
        let recompute = |transform: &mut Transform, &(tile, mask): &([i32; 3], u64)| recompute_tile(transform, seeds, tile, mask, reach);
        let results: Vec<TileDistances> = tiles.par_iter().with_max_len(4).map_init(Transform::default, recompute).collect();
        let mut count = 0;
        for tile in results {
            count += tile.keys.len();
            let mut distances = tile.distances.iter();
            for (key, is_stored) in tile.keys {
                match if is_stored { distances.next() } else { None } {
                    Some(distances) => self.set(key, distances),
                    None => drop(self.blocks.remove(&key)),
                }
            }
        }
        count
    }

    /// Stores the distances of a block, where they were if it was stored.
    fn set(&mut self, key: u64, distances: &Distances) {
        match self.blocks.entry(key) {
            Entry::Occupied(mut block) => **block.get_mut() = *distances,
            Entry::Vacant(place) => {
                place.insert(Box::new(*distances));
                let block = block_coords(key);
                let [low, high] = self.bounds.unwrap_or([block; 2]);
                self.bounds = Some([std::array::from_fn(|k| low[k].min(block[k])), std::array::from_fn(|k| high[k].max(block[k]))]);
            }
        }
    }
}

/// Blocks of a tile that were recomputed.
#[derive(Default)]
struct TileDistances {
    /// Their keys, and whether they are stored.
    keys: Vec<(u64, bool)>,
    /// The distances of those that are, in the same order.
    distances: Vec<Distances>,
}

/// The distances of the blocks of a tile that `mask` holds; none for blocks that are not stored.
fn recompute_tile(transform: &mut Transform, seeds: Seeds<'_>, tile: [i32; 3], mask: u64, reach: usize) -> TileDistances {
    let corner = tile.map(|c| c * TILE as i32);
    let absolute = |at: [usize; 3]| -> [i32; 3] { std::array::from_fn(|k| corner[k] + at[k] as i32) };
    let wanted: Vec<[usize; 3]> = (0..64).filter(|bit| mask >> bit & 1 == 1).map(block_of_bit).collect();
    let (skipped, computed): (Vec<_>, Vec<_>) = wanted.into_iter().partition(|at| seeds.are_all(absolute(*at)));
    let mut result = TileDistances { keys: skipped.into_iter().map(|at| (block_key(absolute(at)), false)).collect(), ..TileDistances::default() };
    let bound = |k: usize, pick: fn(usize, usize) -> usize| computed.iter().map(|at| at[k]).reduce(pick).unwrap_or(0);
    let low = [0, 1, 2].map(|k| bound(k, usize::min));
    let size = [0, 1, 2].map(|k| bound(k, usize::max) + 1 - low[k]);
    let any = !computed.is_empty() && transform.run(BlockBox { low: absolute(low), size }, reach, &seeds);
    for at in computed {
        let mut is_stored = false;
        if any {
            let distances = transform.block(std::array::from_fn(|k| at[k] - low[k]), reach, FAR);
            is_stored = distances.iter().any(|d| *d != FAR) && !(matches!(seeds, Seeds::NotFree(_)) && distances == [0; 512]);
            if is_stored {
                result.distances.push(distances);
            }
        }
        result.keys.push((block_key(absolute(at)), is_stored));
    }
    result
}

/// The box around the bits of a block, lowest and highest coordinates; none if no bit is set.
fn bounds(bits: &BlockBits) -> Option<[[i32; 3]; 2]> {
    let all = bits.iter().fold(0, |all, word| all | word);
    let rows = (0..8).fold(0, |rows, y| rows | u64::from(all >> (8 * y) & 0xff != 0) << y);
    let columns = (0..8).fold(0, |columns, y| columns | all >> (8 * y) & 0xff);
    let planes = (0..8).fold(0, |planes, z| planes | u64::from(bits[z] != 0) << z);
    let ends = [columns, rows, planes].map(|set| [set.trailing_zeros() as i32, 63 - set.leading_zeros() as i32]);
    (all != 0).then(|| [ends.map(|e| e[0]), ends.map(|e| e[1])])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_around_bits_has_their_lowest_and_highest_coordinates() {
        assert_eq!(bounds(&[0; 8]), None);
        for (a, b) in [([1, 7, 3], [5, 0, 3]), ([0, 0, 0], [7, 7, 7]), ([4, 2, 6], [4, 2, 6])] {
            let mut bits = [0; 8];
            [a, b].iter().for_each(|c: &[i32; 3]| bits[c[2] as usize] |= 1 << (c[0] + 8 * c[1]));
            assert_eq!(bounds(&bits), Some([std::array::from_fn(|k| a[k].min(b[k])), std::array::from_fn(|k| a[k].max(b[k]))]));
        }
    }
}
