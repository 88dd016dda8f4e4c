//! Voxel arrays in one pool per scale, so that a block needs memory only for the scales that it has.

use crate::octree::{Pool, SCALES, voxels_at};

/// Voxel arrays of 512, 64, 8 and 1 voxels, for blocks at scales 0, 1, 2 and 3.
#[derive(Clone, Debug)]
pub(crate) struct BlockStore<V> {
    pub(super) fine: Pool<[V; voxels_at(0)]>,
    pub(super) half: Pool<[V; voxels_at(1)]>,
    pub(super) quarter: Pool<[V; voxels_at(2)]>,
    pub(super) single: Pool<[V; voxels_at(3)]>,
}

impl<V> Default for BlockStore<V> {
    fn default() -> Self {
        Self { fine: Pool::default(), half: Pool::default(), quarter: Pool::default(), single: Pool::default() }
    }
}

impl<V: Copy + Default> BlockStore<V> {
    /// Stores a new array of default voxels for a block at `scale` and returns its slot among those of that scale.
    pub fn insert(&mut self, scale: usize) -> u32 {
        match scale {
            0 => self.fine.insert([V::default(); voxels_at(0)]),
            1 => self.half.insert([V::default(); voxels_at(1)]),
            2 => self.quarter.insert([V::default(); voxels_at(2)]),
            _ => self.single.insert([V::default(); voxels_at(3)]),
        }
    }

    /// Frees the array in `slot` at `scale` for reuse.
    pub fn remove(&mut self, scale: usize, slot: u32) {
        match scale {
            0 => self.fine.remove(slot),
            1 => self.half.remove(slot),
            2 => self.quarter.remove(slot),
            _ => self.single.remove(slot),
        }
    }

    /// The array in `slot` at `scale`: x fastest, then y, then z.
    #[inline(always)]
    pub fn get(&self, scale: usize, slot: u32) -> &[V] {
        match scale {
            0 => &self.fine[slot],
            1 => &self.half[slot],
            2 => &self.quarter[slot],
            _ => &self.single[slot],
        }
    }

    /// The array in `slot` at `scale`, mutable.
    #[inline(always)]
    pub fn get_mut(&mut self, scale: usize, slot: u32) -> &mut [V] {
        match scale {
            0 => &mut self.fine[slot],
            1 => &mut self.half[slot],
            2 => &mut self.quarter[slot],
            _ => &mut self.single[slot],
        }
    }

    /// Number of arrays at each scale.
    pub fn live(&self) -> [usize; SCALES] {
        [self.fine.live(), self.half.live(), self.quarter.live(), self.single.live()]
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.fine.bytes() + self.half.bytes() + self.quarter.bytes() + self.single.bytes()
    }
}
