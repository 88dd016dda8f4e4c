//! Which blocks have to be recomputed: those within reach of changed ones, gathered in tiles of 4 x 4 x 4 blocks.

use hashbrown::HashMap;
use voxelastic::octree::{BLOCK_EDGE, block_coords};

/// Blocks along the edge of a tile.
pub(crate) const TILE: usize = 4;
/// Room around a tile for its dilation, blocks: two tiles on each side.
const MARGIN: usize = 2 * TILE;
const WINDOW: usize = TILE + 2 * MARGIN;

const EDGE: i32 = BLOCK_EDGE as i32;

/// How many blocks away a seed may be that is within `reach` voxels: centres of voxels in neighbouring blocks are at least one voxel apart, in the next ones nine.
pub(crate) fn blocks_within(reach: usize) -> usize {
    (reach - 1) / BLOCK_EDGE + 1
}

/// A set of blocks: a bit per block of a tile, x fastest, by the tile's coordinates.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockSet {
    tiles: HashMap<[i32; 3], u64>,
}

/// Bit of a block in its tile.
fn bit(block: [i32; 3]) -> u32 {
    let [x, y, z] = block.map(|c| (c & 3) as u32);
    x + 4 * y + 16 * z
}

impl BlockSet {
    /// Adds the octant of `level` whose first block has `key`: only the blocks at its faces if `hollow`.
    pub fn add_octant(&mut self, key: u64, level: u32, hollow: bool) {
        let (low, edge) = (block_coords(key), 1i32 << level);
        for z in 0..edge {
            for y in 0..edge {
                let is_face = |c: i32| c == 0 || c == edge - 1;
                let step = if hollow && !is_face(z) && !is_face(y) { (edge - 1).max(1) } else { 1 };
                for x in (0..edge).step_by(step as usize) {
                    let block = [low[0] + x, low[1] + y, low[2] + z];
                    *self.tiles.entry(block.map(|c| c >> 2)).or_default() |= 1 << bit(block);
                }
            }
        }
    }

    /// The set of all blocks that are no farther than `by` blocks, at most 8, from one of this set along every axis.
    pub fn dilated(&self, by: usize) -> Self {
        let mut result = Self::default();
        for (tile, mask) in &self.tiles {
            let mut rows = [[0u32; WINDOW]; WINDOW];
            for z in 0..TILE {
                for y in 0..TILE {
                    let row = (mask >> (4 * y + 16 * z) & 15) as u32;
                    let dilated = (0..=2 * by).fold(0, |all, shift| all | row << (MARGIN - by + shift));
                    (MARGIN + y - by..=MARGIN + y + by).for_each(|y| rows[MARGIN + z][y] |= dilated);
                }
            }
            let mut planes = [[0u32; WINDOW]; WINDOW];
            for z in MARGIN..MARGIN + TILE {
                for plane in &mut planes[z - by..=z + by] {
                    plane.iter_mut().zip(&rows[z]).for_each(|(all, row)| *all |= row);
                }
            }
            result.add_window(*tile, &planes);
        }
        result
    }

    /// All blocks with a voxel whose centre is at most `reach` voxels, at most 48, from a voxel that changed. `changed_in` gives the box around the changed voxels of a
    /// block of this set, lowest and highest coordinates in the block; none if nothing in it changed. `limit` gives the largest squared distance from there that matters
    /// in a block.
    pub fn within_reach(&self, reach: usize, changed_in: impl Fn([i32; 3]) -> Option<[[i32; 3]; 2]>, mut limit: impl FnMut([i32; 3]) -> i32) -> Self {
        let by = blocks_within(reach) as i32;
        let mut result = Self::default();
        for (tile, mask) in &self.tiles {
            let mut planes = [[0u32; WINDOW]; WINDOW];
            for at in (0..64).filter(|bit| mask >> bit & 1 == 1).map(block_of_bit) {
                let block: [i32; 3] = std::array::from_fn(|k| (tile[k] << 2) + at[k] as i32);
                let Some([low, high]) = changed_in(block) else { continue };
                // Squared distance along an axis to the voxels of the block `d` blocks away.
                let squared = |k: usize, d: i32| {
                    let gap = if d > 0 { EDGE * d - high[k] } else { low[k] - EDGE * d - (EDGE - 1) };
                    if d == 0 { 0 } else { gap * gap }
                };
                let along_x: [i32; WINDOW] = std::array::from_fn(|i| squared(0, i as i32 - by));
                for z in -by..=by {
                    for y in -by..=by {
                        let across = squared(1, y) + squared(2, z);
                        let plane = &mut planes[(MARGIN as i32 + at[2] as i32 + z) as usize];
                        let row = &mut plane[(MARGIN as i32 + at[1] as i32 + y) as usize];
                        for x in -by..=by {
                            let (squared, bit) = (across + along_x[(x + by) as usize], 1u32 << (MARGIN as i32 + at[0] as i32 + x));
                            let is_within = squared <= (reach * reach) as i32 && *row & bit == 0;
                            if is_within && squared <= limit([block[0] + x, block[1] + y, block[2] + z]) {
                                *row |= bit;
                            }
                        }
                    }
                }
            }
            result.add_window(*tile, &planes);
        }
        result
    }

    /// Adds a window of blocks around a tile.
    fn add_window(&mut self, tile: [i32; 3], planes: &[[u32; WINDOW]; WINDOW]) {
        for z in 0..WINDOW / TILE {
            for y in 0..WINDOW / TILE {
                for x in 0..WINDOW / TILE {
                    let mut mask = 0u64;
                    for (row, shift) in (0..TILE * TILE).zip((0..).step_by(TILE)) {
                        let bits = planes[z * TILE + row / TILE][y * TILE + row % TILE] >> (x * TILE) & 15;
                        mask |= u64::from(bits) << shift;
                    }
                    if mask != 0 {
                        let offset = [x, y, z].map(|c| c as i32 - (MARGIN / TILE) as i32);
                        *self.tiles.entry(std::array::from_fn(|k| tile[k] + offset[k])).or_default() |= mask;
                    }
                }
            }
        }
    }

    /// The tiles in the order of their coordinates.
    pub fn into_tiles(self) -> Vec<([i32; 3], u64)> {
        let mut tiles: Vec<_> = self.tiles.into_iter().collect();
        tiles.sort_unstable();
        tiles
    }

    pub fn add(&mut self, block: [i32; 3]) {
        *self.tiles.entry(block.map(|c| c >> 2)).or_default() |= 1 << bit(block);
    }

    pub fn is_empty(&self) -> bool {
        self.tiles.is_empty()
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.tiles.values().map(|mask| mask.count_ones() as usize).sum()
    }

    pub fn extend(&mut self, other: &Self) {
        other.tiles.iter().for_each(|(tile, mask)| *self.tiles.entry(*tile).or_default() |= mask);
    }

    pub fn remove(&mut self, other: &Self) {
        self.tiles.retain(|tile, mask| {
            *mask &= !other.tiles.get(tile).copied().unwrap_or(0);
            *mask != 0
        });
    }

    /// Whether a block is in the set.
    pub fn contains(&self, block: [i32; 3]) -> bool {
        self.tiles.get(&block.map(|c| c >> 2)).is_some_and(|mask| mask >> bit(block) & 1 == 1)
    }
}

/// Coordinates in its tile of the block with number `bit`.
pub(crate) fn block_of_bit(bit: usize) -> [usize; 3] {
    [bit & 3, bit >> 2 & 3, bit >> 4]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use voxelastic::octree::block_key;

    proptest! {
        #[test]
        fn blocks_within_reach_have_a_voxel_that_is(
            voxels in prop::collection::vec(prop::array::uniform3(-20i32..20), 1..4),
            reach in 1usize..=48,
        ) {
            let mut set = BlockSet::default();
            voxels.iter().for_each(|v| set.add(v.map(|c| c >> 3)));
            // And one in which nothing changed.
            set.add([9, 9, 9]);
            let in_block = |block: [i32; 3]| voxels.iter().filter(move |v| v.map(|c| c >> 3) == block).map(|v| v.map(|c| c & 7));
            let bounds = |block: [i32; 3]| {
                let low = in_block(block).reduce(|a, b| std::array::from_fn(|k| a[k].min(b[k])))?;
                Some([low, in_block(block).reduce(|a, b| std::array::from_fn(|k| a[k].max(b[k])))?])
            };
            // Where the first coordinate is odd, only what is nearer matters.
            let limit = |block: [i32; 3]| if block[0] % 2 == 0 { i32::MAX } else { 40 };
            let reached = set.within_reach(reach, bounds, limit);
            let boxes: Vec<[[i32; 3]; 2]> = voxels.iter().map(|v| v.map(|c| c >> 3)).filter_map(|block| {
                Some(bounds(block)?.map(|c| std::array::from_fn(|k| 8 * block[k] + c[k])))
            }).collect();
            for i in 0..24i32.pow(3) {
                let block = [i % 24 - 12, i / 24 % 24 - 12, i / 576 - 12];
                let is_near = |[low, high]: &[[i32; 3]; 2]| {
                    let gap = |k: usize| (8 * block[k] - high[k]).max(low[k] - 8 * block[k] - 7).max(0);
                    (0..3).map(|k| gap(k).pow(2)).sum::<i32>() <= limit(block).min((reach * reach) as i32)
                };
                prop_assert_eq!(reached.contains(block), boxes.iter().any(is_near), "{:?}, reach {}", block, reach);
            }
        }

        #[test]
        fn a_dilated_set_has_the_blocks_around_its_octants(
            octants in prop::collection::vec((prop::array::uniform3(-20i32..20), 0u32..4), 1..4),
            by in 0usize..=8,
            hollow in any::<bool>(),
        ) {
            let mut set = BlockSet::default();
            let octants: Vec<([i32; 3], u32)> = octants.into_iter().map(|(c, level)| {
                let key = block_key(c) >> (3 * level) << (3 * level);
                set.add_octant(key, level, hollow);
                (block_coords(key), level)
            }).collect();
            let dilated = set.dilated(by);
            for i in 0..60i32.pow(3) {
                let block = [i % 60 - 30, i / 60 % 60 - 30, i / 3600 - 30];
                let by = by as i32;
                let is_near = |(low, level): &([i32; 3], u32)| {
                    let high = low.map(|c| c + (1 << level) - 1);
                    let outside = (0..3).map(|k| (low[k] - block[k]).max(block[k] - high[k]).max(0)).max().unwrap_or(0);
                    let inside = (0..3).map(|k| (block[k] - low[k]).min(high[k] - block[k])).min().unwrap_or(0);
                    outside <= by && !(hollow && inside > by)
                };
                prop_assert_eq!(dilated.contains(block), octants.iter().any(is_near), "{:?} around {:?} by {}", block, octants, by);
            }
        }
    }
}
