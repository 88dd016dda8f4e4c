//! An index of voxels by blocks: neighbours lie side by side in memory, and the eight voxels around a point are found with one look into a hash table, or
//! a few where they lie in several blocks.

use super::voxel_index::{VoxelIndex, key};

/// Binary logarithm of a block's edge in voxels.
const SHIFT: i32 = 3;
/// Edge of a block, voxels.
const EDGE: i32 = 1 << SHIFT;
/// Voxels of a block.
const VOLUME: usize = 1 << (3 * SHIFT);
/// From a voxel to the seven beyond it in the same block, x first.
const STEPS: [usize; 8] = {
    let (x, y) = (1 << (2 * SHIFT), 1 << SHIFT);
    [0, x, y, x + y, 1, x + 1, y + 1, x + y + 1]
};
/// The position of a voxel that is not there.
pub(crate) const ABSENT: u32 = u32::MAX;

/// Positions of voxels in a list, by coordinates. Contents depend on the order of insertions only, never on memory addresses or threads.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockIndex {
    blocks: VoxelIndex,
    /// Positions of the voxels of each block, x slowest.
    positions: Vec<[u32; VOLUME]>,
}

/// The block of a voxel, and where the voxel is in it.
#[inline(always)]
fn split(voxel: [i32; 3]) -> (u64, usize) {
    let [x, y, z] = voxel.map(|v| (v & (EDGE - 1)) as usize);
    (key(voxel.map(|v| v >> SHIFT)), x << (2 * SHIFT) | y << SHIFT | z)
}

impl BlockIndex {
    /// Removes all voxels and keeps the memory.
    pub(crate) fn clear(&mut self) {
        self.blocks.clear();
        self.positions.clear();
    }

    /// The position of a voxel.
    #[inline(always)]
    pub(crate) fn get(&self, voxel: [i32; 3]) -> Option<u32> {
        let (block, at) = split(voxel);
        let position = self.positions[self.blocks.get(block)? as usize][at];
        (position != ABSENT).then_some(position)
    }

    /// The positions of the voxel at `base` and of the seven beyond it, x first; [`ABSENT`] where there is none.
    #[inline(always)]
    pub(crate) fn corners(&self, base: [i32; 3]) -> [u32; 8] {
        // The axes along which the corners lie in two blocks.
        let across = (0..3).map(|axis| usize::from(base[axis] & (EDGE - 1) == EDGE - 1) << axis).sum::<usize>();
        let mut found = [ABSENT; 8];
        if across == 0 {
            let (block, at) = split(base);
            if let Some(block) = self.blocks.get(block) {
                let positions = &self.positions[block as usize];
                for (found, step) in found.iter_mut().zip(STEPS) {
                    *found = positions[(at + step) & (VOLUME - 1)];
                }
            }
            return found;
        }
        let mut blocks = [None; 8];
        for corner in 0..8 {
            let (block, at) = split([0, 1, 2].map(|axis| base[axis].wrapping_add((corner >> axis & 1) as i32)));
            // The first corner in the same block.
            let first = corner & across;
            if first == corner {
                blocks[corner] = self.blocks.get(block);
            }
            if let Some(block) = blocks[first] {
                found[corner] = self.positions[block as usize][at];
            }
        }
        found
    }

    /// The position of a voxel; one that is not there is inserted with position `next`. Also whether it was inserted.
    #[inline]
    pub(crate) fn get_or_insert(&mut self, voxel: [i32; 3], next: u32) -> (u32, bool) {
        let (block, at) = split(voxel);
        let (block, is_new) = self.blocks.get_or_insert(block, self.positions.len() as u32);
        if is_new {
            self.positions.push([ABSENT; VOLUME]);
        }
        let position = &mut self.positions[block as usize][at];
        if *position != ABSENT {
            return (*position, false);
        }
        *position = next;
        (next, true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    #[test]
    fn agrees_with_the_standard_map() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % 27) as i32 - 13
        };
        let (mut index, mut reference) = (BlockIndex::default(), HashMap::new());
        for next in 0..9_000u32 {
            let at = [random(), random(), random()];
            let expected = (*reference.entry(at).or_insert(next), reference[&at] == next);
            assert_eq!(index.get_or_insert(at, next), expected);
        }
        for base in (0..30 * 30 * 30).map(|k| [k / 900 - 15, k / 30 % 30 - 15, k % 30 - 15]) {
            assert_eq!(index.get(base), reference.get(&base).copied());
            let corner = |k: i32| [base[0] + (k & 1), base[1] + (k >> 1 & 1), base[2] + (k >> 2)];
            let expected: Vec<u32> = (0..8).map(|k| reference.get(&corner(k)).copied().unwrap_or(ABSENT)).collect();
            assert_eq!(index.corners(base)[..], expected);
        }
        index.clear();
        assert_eq!((index.get([0; 3]), index.corners([0; 3])), (None, [ABSENT; 8]));
    }
}
