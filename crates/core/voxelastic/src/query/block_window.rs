//! Decoded blocks in a box of a field, found by an index: points near each other look their voxels up without searching.

use crate::field::tsdf::{TsdfField, VoxelBuffer};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, block_coords, block_key, voxel_index, voxels_at};
use crate::simd::gather;

/// Entries of a decoded block: one for each finest voxel, whatever its scale.
const ENTRIES: usize = voxels_at(0);

/// Most blocks in a box.
const MOST: f64 = 32_768.0;

/// Blocks from `low` to `high`, both included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BlockBox {
    pub low: [i32; 3],
    pub high: [i32; 3],
}

impl BlockBox {
    /// The box of all blocks of a field; none if it has no blocks. What is inside of the box so far is not visited.
    pub fn of(field: &TsdfField) -> Option<Self> {
        let tree = field.tree();
        if tree.is_empty() {
            return None;
        }
        let mut bounds = Self { low: [i32::MAX; 3], high: [i32::MIN; 3] };
        let mut stack = vec![(tree.root_key(), tree.root_level(), *tree.root())];
        while let Some((key, level, octant)) = stack.pop() {
            let low = block_coords(key);
            let high = low.map(|c| c + ((1 << level) - 1));
            if octant.link == NONE || (0..3).all(|k| low[k] >= bounds.low[k] && high[k] <= bounds.high[k]) {
                continue;
            }
            if level == 0 {
                bounds = Self { low: std::array::from_fn(|k| bounds.low[k].min(low[k])), high: std::array::from_fn(|k| bounds.high[k].max(high[k])) };
                continue;
            }
            let children = tree.siblings(octant.link).iter().enumerate();
            stack.extend(children.map(|(i, child)| (key | (i as u64) << (3 * (level - 1)), level - 1, *child)));
        }
        (bounds.low[0] <= bounds.high[0]).then_some(bounds)
    }

    fn holds(&self, c: [i32; 3]) -> bool {
        (0..3).all(|k| c[k] >= self.low[k] && c[k] <= self.high[k])
    }
}

/// The blocks in a box, and those that were decoded. One is used for one box after the other.
#[derive(Debug)]
pub(super) struct BlockWindow {
    /// All blocks of the field.
    field: BlockBox,
    low: [i32; 3],
    size: [u32; 3],
    /// For each block in the box, x fastest: its number among the decoded ones; 0 if it is not there, or was not asked for.
    numbers: Vec<u32>,
    was_asked_for: Vec<bool>,
    /// Of each decoded block: its scale, and distances in metres, NaN where nothing was observed. The first is the block that is not there.
    scales: Vec<u8>,
    distances: Vec<f32>,
}

impl BlockWindow {
    /// A window without blocks.
    pub fn new() -> Self {
        let nothing = BlockBox { low: [0; 3], high: [-1; 3] };
        let (numbers, was_asked_for) = (Vec::new(), Vec::new());
        Self { field: nothing, low: [0; 3], size: [0; 3], numbers, was_asked_for, scales: vec![0], distances: vec![f32::NAN; ENTRIES] }
    }

    /// What a window would hold that is around points of a field with `blocks` from `low` to `high`, finest voxels of the submap frame.
    #[inline(always)]
    pub fn reach(blocks: &BlockBox, low: [f64; 3], high: [f64; 3]) -> Reach {
        let block = |voxel: f64| (voxel / BLOCK_EDGE as f64).floor();
        let (mut around, mut count) = (BlockBox { low: [0; 3], high: [0; 3] }, 1.0);
        for k in 0..3 {
            // A voxel for rounding, then the next block for interpolation. Beyond the blocks of the field one more layer suffices: all that lies farther out
            // is looked up in it.
            let first = block(low[k] - 1.0) - 1.0;
            let last = block(high[k] + 1.0) + 1.0;
            let (lowest, highest) = (f64::from(blocks.low[k] - 1), f64::from(blocks.high[k] + 1));
            let (first, last) = (if first > lowest { first } else { lowest }, if last < highest { last } else { highest });
            if first > last {
                return Reach::Nothing;
            }
            count *= last - first + 1.0;
            (around.low[k], around.high[k]) = (first as i32, last as i32);
        }
        if count > MOST { Reach::TooMuch } else { Reach::Some(around) }
    }

    /// Moves to what it would hold of a field with `blocks`. False if there is nothing.
    #[inline(always)]
    pub fn move_to(&mut self, blocks: BlockBox, reach: Reach) -> bool {
        let Reach::Some(around) = reach else { return false };
        (self.field, self.low) = (blocks, around.low);
        self.size = std::array::from_fn(|k| (around.high[k] - around.low[k] + 1) as u32);
        let count = self.size.iter().map(|n| *n as usize).product();
        self.numbers.clear();
        self.numbers.resize(count, 0);
        self.was_asked_for.clear();
        self.was_asked_for.resize(count, false);
        self.scales.truncate(1);
        self.distances.truncate(ENTRIES);
        true
    }

    /// Coordinate `c` (finest voxels, a whole number) along axis `k` within the window; at its edge if it is outside.
    #[inline(always)]
    pub fn inside(&self, k: usize, c: f64) -> u32 {
        // 2^52: the number is in the low bits of the sum.
        const MAGIC: f64 = 4_503_599_627_370_496.0;
        let first = f64::from(self.low[k]) * BLOCK_EDGE as f64;
        let last = f64::from(self.size[k]) * BLOCK_EDGE as f64 - 1.0;
        let at = c - first;
        let at = if at > 0.0 { at } else { 0.0 };
        let at = if at < last { at } else { last };
        (at + MAGIC).to_bits() as u32
    }

    /// What the block at coordinate `at` along axis `k` adds to the index of a block in the window.
    #[inline(always)]
    pub fn block_part(&self, k: usize, at: u32) -> u32 {
        (at >> BLOCK_SHIFT).wrapping_mul(match k {
            0 => 1,
            1 => self.size[0],
            _ => self.size[0].wrapping_mul(self.size[1]),
        })
    }

    /// What coordinate `at` along axis `k` adds to the index of a voxel in its block.
    #[inline(always)]
    pub fn voxel_part(k: usize, at: u32) -> u32 {
        (at & (BLOCK_EDGE as u32 - 1)) << (BLOCK_SHIFT * k as u32)
    }

    /// The number of the block at `index` of the window, which is decoded if it is there and was not yet; 0 if there is none.
    #[inline(always)]
    pub fn number(&mut self, source: &TsdfField, voxel: f64, index: u32) -> u32 {
        let index = index as usize;
        if !self.was_asked_for[index] {
            self.was_asked_for[index] = true;
            self.numbers[index] = self.decode(source, voxel, index);
        }
        self.numbers[index]
    }

    /// The scale of a decoded block.
    #[inline(always)]
    pub fn scale(&self, number: u32) -> u8 {
        self.scales[number as usize]
    }

    /// Distances in voxels of decoded blocks: `block` has numbers of blocks, `voxel` indices in them.
    #[inline(always)]
    pub fn distances<const N: usize>(&self, block: &[u32; N], voxel: &[u32; N]) -> [f32; N] {
        let (mut at, mut distances) = ([0; N], [0.0; N]);
        for k in 0..N {
            at[k] = block[k].wrapping_mul(ENTRIES as u32) | voxel[k];
        }
        gather(&self.distances, &at, &mut distances);
        distances
    }

    /// Numbers of the blocks at some indices, all of which were asked for or do not matter.
    #[inline(always)]
    pub fn numbers<const N: usize>(&self, index: &[u32; N]) -> [u32; N] {
        let mut numbers = [0; N];
        gather(&self.numbers, index, &mut numbers);
        numbers
    }

    #[inline(always)]
    fn decode(&mut self, source: &TsdfField, voxel: f64, index: usize) -> u32 {
        let [nx, ny, _] = self.size.map(|n| n as usize);
        let offset = [index % nx, index / nx % ny, index / (nx * ny)];
        let at = std::array::from_fn(|k| self.low[k] + offset[k] as i32);
        let Some(id) = self.field.holds(at).then(|| source.find(block_key(at))).flatten() else { return 0 };
        let block = source.block(id);
        let scale = usize::from(block.scale);
        let mut voxels: VoxelBuffer = [Default::default(); ENTRIES];
        let voxels = &mut voxels[..voxels_at(scale)];
        source.copy(block, block.current(), voxels);
        let edge = (voxel * f64::from(1 << scale)) as f32;
        let number = self.scales.len() as u32;
        self.scales.push(scale as u8);
        if scale == 0 {
            self.distances.extend(voxels.iter().map(|v| if v.is_observed() { v.distance_in_voxels() * edge } else { f32::NAN }));
            return number;
        }
        for z in 0..BLOCK_EDGE {
            for y in 0..BLOCK_EDGE {
                self.distances.extend((0..BLOCK_EDGE).map(|x| {
                    let v = voxels[voxel_index([x >> scale, y >> scale, z >> scale], scale)];
                    if v.is_observed() { v.distance_in_voxels() * edge } else { f32::NAN }
                }));
            }
        }
        number
    }
}

/// What a window reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reach {
    /// No block of the field.
    Nothing,
    /// These blocks.
    Some(BlockBox),
    /// The points are too far apart for one window.
    TooMuch,
}
