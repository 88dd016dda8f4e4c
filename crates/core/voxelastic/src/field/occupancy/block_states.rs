//! The states of a block's voxels as bits.

use super::field::OccupancyField;
use super::value::{State, UNKNOWN, state_of};
use crate::octree::{NONE, voxel_coords, voxels_at};

/// A bit for each of a block's 512 finest voxels: voxel `[x, y, z]` is bit `x + 8 y` of word `z`.
pub type BlockBits = [u64; 8];

/// Which of a block's finest voxels are occupied and which are free; the others are unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockStates {
    /// The occupied voxels.
    pub occupied: BlockBits,
    /// The free voxels.
    pub free: BlockBits,
}

impl BlockStates {
    /// A block in which all voxels have one state.
    pub fn uniform(state: State) -> Self {
        let all = |is: bool| if is { [u64::MAX; 8] } else { [0; 8] };
        Self { occupied: all(state == State::Occupied), free: all(state == State::Free) }
    }

    /// The unknown voxels.
    pub fn unknown(&self) -> BlockBits {
        std::array::from_fn(|z| !(self.occupied[z] | self.free[z]))
    }

    /// The states of a block of finest voxels with these values.
    fn of_finest(values: &[i8]) -> Self {
        const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
        // From the highest bit of each byte to eight bits.
        let gather = |bits: u64| ((bits >> 7 & 0x0101_0101_0101_0101).wrapping_mul(0x0102_0408_1020_4080)) >> 56;
        let mut states = Self::default();
        for (row, values) in values.as_chunks::<8>().0.iter().enumerate() {
            let bytes = u64::from_le_bytes(values.map(|v| v as u8));
            // Neither zero nor the smallest value, which stands for unknown: the lower seven bits are not zero.
            let is_known = (bytes & LOW) + LOW;
            let (z, shift) = (row >> 3, 8 * (row & 7));
            states.occupied[z] |= gather(is_known & !bytes) << shift;
            states.free[z] |= gather(is_known & bytes) << shift;
        }
        states
    }

    /// The states of a block of coarser voxels.
    fn of_coarse(values: &[i8], scale: usize) -> Self {
        let edge = 1usize << scale;
        // The bits of the first voxel in one word: `edge` rows of `edge` bits.
        let pattern = (0..edge).fold(0u64, |bits, y| bits | (u64::MAX >> (64 - edge)) << (8 * y));
        let mut states = Self::default();
        for (i, &value) in values[..voxels_at(scale)].iter().enumerate() {
            let bits = match state_of(value) {
                State::Unknown => continue,
                State::Free => &mut states.free,
                State::Occupied => &mut states.occupied,
            };
            let [x, y, z] = voxel_coords(i, scale).map(|c| c << scale);
            bits[z..z + edge].iter_mut().for_each(|word| *word |= pattern << (x + 8 * y));
        }
        states
    }
}

impl OccupancyField {
    /// The states of the finest voxels of block `key`; all unknown outside of the field.
    pub fn block_states(&self, key: u64) -> BlockStates {
        let Some((_, octant)) = self.tree().find(key) else { return BlockStates::uniform(state_of(UNKNOWN)) };
        if octant.link == NONE {
            return BlockStates::uniform(state_of(octant.payload.value));
        }
        let block = self.block(octant.link);
        match usize::from(block.scale) {
            0 => BlockStates::of_finest(self.values(block)),
            scale => BlockStates::of_coarse(self.values(block), scale),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{SCALES, voxel_index};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_are_the_states_of_the_voxels(seed in any::<u64>()) {
            for scale in 0..SCALES {
                let mut random = seed;
                let values: Vec<i8> = (0..voxels_at(scale)).map(|_| {
                    random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    // Often the values between which states change.
                    match random >> 60 { 0 => UNKNOWN, 1 => 0, 2 => -127, 3 => 1, _ => (random >> 40) as i8 }
                }).collect();
                let states = if scale == 0 { BlockStates::of_finest(&values) } else { BlockStates::of_coarse(&values, scale) };
                let unknown = states.unknown();
                for i in 0..voxels_at(0) {
                    let c = voxel_coords(i, 0);
                    let is = |bits: &BlockBits| bits[c[2]] >> (c[0] + 8 * c[1]) & 1 == 1;
                    let expected = state_of(values[voxel_index(c.map(|v| v >> scale), scale)]);
                    prop_assert_eq!((is(&states.occupied), is(&states.free), is(&unknown)),
                        (expected == State::Occupied, expected == State::Free, expected == State::Unknown));
                }
            }
        }
    }
}
