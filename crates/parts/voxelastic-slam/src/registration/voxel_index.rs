//! A hash index of voxels: integer coordinates to positions in a list, by open addressing.

/// Voxels per axis that a key can hold, halved: coordinates from `-HALF` to `HALF - 1`.
const HALF: i32 = 1 << 20;
/// Key of an empty slot. No voxel has it: keys use 63 bits.
const EMPTY: u64 = u64::MAX;

/// The key of a voxel; coordinates beyond what a key can hold wrap around.
#[inline(always)]
pub(crate) fn key([x, y, z]: [i32; 3]) -> u64 {
    let part = |v: i32| (v.wrapping_add(HALF) as u64) & 0x1f_ffff;
    part(x) << 42 | part(y) << 21 | part(z)
}

/// Positions of voxels in a list, by key. Contents depend on the order of insertions only, never on memory addresses or threads.
#[derive(Clone, Debug)]
pub(crate) struct VoxelIndex {
    slots: Vec<(u64, u32)>,
    shift: u32,
    len: usize,
}

impl Default for VoxelIndex {
    fn default() -> Self {
        Self::with_capacity(1024)
    }
}

impl VoxelIndex {
    /// An index with room for so many voxels before it grows.
    pub(crate) fn with_capacity(voxels: usize) -> Self {
        let slots = (voxels * 2).next_power_of_two().max(16);
        Self { slots: vec![(EMPTY, 0); slots], shift: 64 - slots.trailing_zeros(), len: 0 }
    }

    /// Removes all voxels and keeps the memory.
    pub(crate) fn clear(&mut self) {
        self.slots.fill((EMPTY, 0));
        self.len = 0;
    }

    #[inline(always)]
    fn first_slot(&self, key: u64) -> usize {
        (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> self.shift) as usize
    }

    /// The position of a voxel.
    #[inline(always)]
    pub(crate) fn get(&self, key: u64) -> Option<u32> {
        let mask = self.slots.len() - 1;
        let mut slot = self.first_slot(key);
        loop {
            let (found, position) = self.slots[slot & mask];
            if found == key {
                return Some(position);
            }
            if found == EMPTY {
                return None;
            }
            slot += 1;
        }
    }

    /// The position of a voxel; one that is not there is inserted with position `next`. Also whether it was inserted.
    #[inline]
    pub(crate) fn get_or_insert(&mut self, key: u64, next: u32) -> (u32, bool) {
        if (self.len + 1) * 2 > self.slots.len() {
            self.grow();
        }
        let mask = self.slots.len() - 1;
        let mut slot = self.first_slot(key);
        loop {
            let (found, position) = self.slots[slot & mask];
            if found == key {
                return (position, false);
            }
            if found == EMPTY {
                self.slots[slot & mask] = (key, next);
                self.len += 1;
                return (next, true);
            }
            slot += 1;
        }
    }

    fn grow(&mut self) {
        let mut larger = Self::with_capacity(self.slots.len());
        for &(key, position) in self.slots.iter().filter(|(key, _)| *key != EMPTY) {
            larger.get_or_insert(key, position);
        }
        *self = larger;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    #[test]
    fn agrees_with_the_standard_map() {
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % 41) as i32 - 20
        };
        let (mut index, mut reference) = (VoxelIndex::with_capacity(4), HashMap::new());
        for next in 0..20_000u32 {
            let at = [random(), random(), random()];
            let expected = *reference.entry(at).or_insert(next);
            assert_eq!(index.get_or_insert(key(at), next).0, expected);
        }
        for x in -21..21 {
            for y in -21..21 {
                for z in -21..21 {
                    assert_eq!(index.get(key([x, y, z])), reference.get(&[x, y, z]).copied());
                }
            }
        }
        index.clear();
        assert_eq!(index.get(key([0, 0, 0])), None);
    }
}
