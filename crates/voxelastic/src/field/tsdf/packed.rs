//! A voxel array at rest: only the voxels that hold anything, with a map of where they are.
//!
//! A surface passes through a block, it does not fill it: of a fine array one voxel in five is ever observed. Arrays that no scan has
//! touched for a while are kept like this; nothing is lost, and any voxel can be read where it lies.

use super::rest::LINE;
use super::voxel::Voxel;
use crate::octree::{prefetch, voxels_at};
use bytemuck::{Pod, Zeroable};

/// Voxels that share an entry of the map.
const GROUP: usize = 64;

/// What the map says of 64 voxels.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
struct Entry {
    /// A bit per voxel: whether it is held. Low half, high half.
    mask: [u32; 2],
    /// Voxels held before these.
    before: u32,
}

impl Entry {
    #[inline(always)]
    fn mask(self) -> u64 {
        u64::from(self.mask[0]) | u64::from(self.mask[1]) << 32
    }

    /// Where the voxel in `place` of 64 is among those held.
    #[inline(always)]
    fn rank(self, place: usize) -> Option<usize> {
        let mask = self.mask();
        (mask >> place & 1 == 1).then(|| self.before as usize + (mask & ((1 << place) - 1)).count_ones() as usize)
    }
}

/// The voxels of an array, and their intensities if it has any, without those that are zero. Which scale it has, its block knows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Packed {
    /// The map, the voxels, the intensities.
    words: Box<[u32]>,
}

/// The pieces of a packed array.
struct Pieces<'a> {
    map: &'a [Entry],
    values: &'a [Voxel],
    /// As many as values, or none, and up to three more.
    shades: &'a [u8],
}

impl Packed {
    /// Packs the array of a block at any scale. Inlined, and made of loops only, for kernels that pack many.
    #[inline(always)]
    pub fn new(voxels: &[Voxel], shades: Option<&[u8]>) -> Self {
        let mut map = [Entry::default(); voxels_at(0) / GROUP];
        let map = &mut map[..voxels.len().div_ceil(GROUP)];
        let mut held = [0u16; voxels_at(0)];
        let mut count = 0;
        for (i, entry) in map.iter_mut().enumerate() {
            let place = i * GROUP..voxels.len().min((i + 1) * GROUP);
            let shades = if let Some(shades) = shades { &shades[place.clone()] } else { &[] };
            let mut left = mask(&voxels[place], shades);
            *entry = Entry { mask: [left as u32, (left >> 32) as u32], before: count as u32 };
            while left != 0 {
                held[count % voxels_at(0)] = (i * GROUP) as u16 + left.trailing_zeros() as u16;
                count += 1;
                left &= left - 1;
            }
        }
        let held = &held[..count];
        let shade_words = if shades.is_some() { count.div_ceil(4) } else { 0 };
        let mut words = Vec::with_capacity(3 * map.len() + count + shade_words);
        words.extend_from_slice(bytemuck::cast_slice(map));
        words.resize(3 * map.len() + count + shade_words, 0);
        let (values, packed_shades) = words[3 * map.len()..].split_at_mut(count);
        for (value, &i) in values.iter_mut().zip(held) {
            *value = bytemuck::cast(voxels[usize::from(i)]);
        }
        if let Some(shades) = shades {
            let packed_shades: &mut [u8] = bytemuck::cast_slice_mut(packed_shades);
            for (shade, &i) in packed_shades.iter_mut().zip(held) {
                *shade = shades[usize::from(i)];
            }
        }
        Self { words: words.into_boxed_slice() }
    }

    #[inline(always)]
    fn pieces(&self, scale: usize) -> Pieces<'_> {
        let (map, rest) = self.words.split_at(3 * voxels_at(scale).div_ceil(GROUP));
        let map: &[Entry] = bytemuck::cast_slice(map);
        let held = map.last().map_or(0, |e| e.before as usize + e.mask().count_ones() as usize);
        let (values, shades) = rest.split_at(held);
        Pieces { map, values: bytemuck::cast_slice(values), shades: bytemuck::cast_slice(shades) }
    }

    /// Voxel `index` of the array.
    #[inline]
    pub fn voxel(&self, scale: usize, index: usize) -> Voxel {
        let Pieces { map, values, .. } = self.pieces(scale);
        map[index / GROUP].rank(index % GROUP).map_or(Voxel::default(), |k| values[k])
    }

    /// Intensity `index` of an array that has intensities.
    #[inline]
    pub fn shade(&self, scale: usize, index: usize) -> u8 {
        let Pieces { map, shades, .. } = self.pieces(scale);
        map[index / GROUP].rank(index % GROUP).map_or(0, |k| shades[k])
    }

    /// Fills `voxels`, the array of a block at `scale`.
    #[inline(always)]
    pub fn unpack(&self, scale: usize, voxels: &mut [Voxel]) {
        let Pieces { map, values, .. } = self.pieces(scale);
        scatter(map, values, voxels);
    }

    /// Fills `shades`, the intensities of a block at `scale`.
    #[inline(always)]
    pub fn unpack_shades(&self, scale: usize, shades: &mut [u8]) {
        let pieces = self.pieces(scale);
        scatter(pieces.map, pieces.shades, shades);
    }

    /// Asks for all of it to be brought near.
    #[inline(always)]
    pub fn ask_for(&self) {
        for line in self.words.chunks(LINE / size_of::<u32>()) {
            prefetch(line.as_ptr());
        }
    }

    /// Bytes held, and what an allocator adds.
    pub fn bytes(&self) -> usize {
        16 + 4 * self.words.len()
    }
}

/// Which of 64 voxels, or their intensities, are anything but zero.
#[inline(always)]
fn mask(voxels: &[Voxel], shades: &[u8]) -> u64 {
    let mut bytes = [0u8; GROUP];
    for (byte, v) in bytes.iter_mut().zip(voxels) {
        *byte = u8::from((v.distance as u16 | v.weight) != 0);
    }
    for (byte, &shade) in bytes.iter_mut().zip(shades) {
        *byte |= u8::from(shade != 0);
    }
    let mut mask = 0;
    for (i, b) in bytes.chunks_exact(8).enumerate() {
        let eight = u64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
        // The product gathers the lowest bits of eight bytes in its topmost byte.
        mask |= (eight.wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * i);
    }
    mask
}

#[inline(always)]
fn scatter<T: Copy + Default>(map: &[Entry], values: &[T], array: &mut [T]) {
    array.fill(T::default());
    for (entry, group) in map.iter().zip(array.chunks_mut(GROUP)) {
        let mut left = entry.mask();
        for &value in &values[entry.before as usize..][..left.count_ones() as usize] {
            group[left.trailing_zeros() as usize & (GROUP - 1)] = value;
            left &= left - 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::SCALES;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn nothing_is_lost(scale in 0..SCALES, share in 0u32..=10, shaded in any::<bool>(), seed in any::<u32>()) {
            let mut number = seed;
            let mut next = || { number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223); number >> 8 };
            let mut voxels = vec![Voxel::default(); voxels_at(scale)];
            let mut shades = vec![0u8; voxels_at(scale)];
            for i in 0..voxels.len() {
                if next() % 10 < share {
                    voxels[i] = Voxel { distance: next() as i16, weight: (next() % 3) as u16 };
                    shades[i] = next() as u8;
                }
            }
            let packed = Packed::new(&voxels, shaded.then_some(&shades[..]));
            let mut back = vec![Voxel { distance: 1, weight: 1 }; voxels.len()];
            packed.unpack(scale, &mut back);
            prop_assert_eq!(&back, &voxels);
            prop_assert!((0..voxels.len()).all(|i| packed.voxel(scale, i) == voxels[i]));
            if shaded {
                let mut back = vec![7; voxels.len()];
                packed.unpack_shades(scale, &mut back);
                prop_assert_eq!(&back, &shades);
                prop_assert!((0..voxels.len()).all(|i| packed.shade(scale, i) == shades[i]));
            }
            prop_assert!(packed.bytes() <= 16 + 3 * 32 + 5 * voxels.len());
        }
    }
}
