//! Storage of encoded bricks in size classes.
//!
//! Each class is kept without gaps: the last brick of the class takes the slot of a removed one. A free list would leave memory unused,
//! because bricks grow from scan to scan and the slots of small ones are seldom needed again.

use super::brick_codec::{BrickView, MAX_WORDS};
use crate::field::tsdf::brick::BrickHandle;
use crate::memory::{PageBox, zeroed_page};
use crate::octree::prefetch;

/// The slot sizes of the classes are multiples of this many words.
const UNIT: usize = 2;
/// Number of size classes. A slot holds the brick's owner and its encoding.
const CLASSES: usize = (1 + MAX_WORDS).div_ceil(UNIT);
/// Bits of a brick's number that select its size class.
const CLASS_BITS: u32 = usize::BITS - (CLASSES - 1).leading_zeros();
/// Slots per page: few, because every field has a partly filled page for each class.
const PER_PAGE: usize = 16;

/// The compressed bricks of a field, addressed by number.
#[derive(Clone, Debug)]
pub(crate) struct CompressedStore {
    classes: [SizeClass; CLASSES],
}

/// Bricks of similar length. A slot is the owner in one word, then the encoded brick.
#[derive(Clone, Debug, Default)]
struct SizeClass {
    pages: Vec<PageBox<u32>>,
    len: usize,
}

impl SizeClass {
    #[inline(always)]
    fn slot(&self, index: usize, stride: usize) -> &[u32] {
        &self.pages[index / PER_PAGE][index % PER_PAGE * stride..][..stride]
    }

    fn slot_mut(&mut self, index: usize, stride: usize) -> &mut [u32] {
        &mut self.pages[index / PER_PAGE][index % PER_PAGE * stride..][..stride]
    }
}

impl Default for CompressedStore {
    fn default() -> Self {
        Self { classes: std::array::from_fn(|_| SizeClass::default()) }
    }
}

/// Number of the brick at `index` of size class `class`.
#[inline(always)]
fn number(class: usize, index: usize) -> u32 {
    (index as u32) << CLASS_BITS | class as u32
}

/// Inverse of [`number`].
#[inline(always)]
fn class_and_index(number: u32) -> (usize, usize) {
    ((number & ((1 << CLASS_BITS) - 1)) as usize, (number >> CLASS_BITS) as usize)
}

/// Words of a slot of size class `class`.
#[inline(always)]
fn stride(class: usize) -> usize {
    UNIT * (class + 1)
}

impl CompressedStore {
    /// Stores an encoded brick for `owner` and returns its number.
    ///
    /// # Panics
    /// If 2^25 bricks of one size class are stored, which takes about a gigabyte in one submap.
    pub fn insert(&mut self, owner: u32, words: &[u32]) -> u32 {
        let length = (1 + words.len()).div_ceil(UNIT);
        let (class, stride) = (&mut self.classes[length - 1], stride(length - 1));
        let index = class.len;
        assert!(index < BrickHandle::MAX as usize >> CLASS_BITS, "too many compressed bricks in one field");
        if index == class.pages.len() * PER_PAGE {
            class.pages.push(zeroed_page(PER_PAGE * stride).into_boxed_slice());
        }
        class.len += 1;
        let slot = class.slot_mut(index, stride);
        slot[0] = owner;
        slot[1..=words.len()].copy_from_slice(words);
        number(length - 1, index)
    }

    /// Stores a copy of a brick of another store for `owner` and returns its number here.
    pub fn insert_copy(&mut self, owner: u32, other: &Self, number: u32) -> u32 {
        // With what is behind the brick in its slot, so that it gets into the same class.
        self.insert(owner, &other.words(number)[1..])
    }

    #[inline(always)]
    fn words(&self, number: u32) -> &[u32] {
        let (class, index) = class_and_index(number);
        self.classes[class].slot(index, stride(class))
    }

    /// The encoded brick with `number`.
    #[inline(always)]
    pub fn get(&self, number: u32) -> BrickView<'_> {
        BrickView::new(&self.words(number)[1..])
    }

    /// Prefetches the brick with `number`.
    #[inline(always)]
    pub fn prefetch(&self, number: u32) {
        for line in self.words(number).chunks(16) {
            prefetch(line.as_ptr());
        }
    }

    /// Removes the brick with `number`. If another brick is moved to its slot, and so takes its number, returns the owner of that one.
    pub fn remove(&mut self, number: u32) -> Option<u32> {
        let (class, index) = class_and_index(number);
        let (class, stride) = (&mut self.classes[class], stride(class));
        class.len -= 1;
        let (last, mut slot) = (class.len, [0; UNIT * CLASSES]);
        let moved = (index < last).then(|| {
            slot[..stride].copy_from_slice(class.slot(last, stride));
            class.slot_mut(index, stride).copy_from_slice(&slot[..stride]);
            slot[0]
        });
        // One empty page is kept, so that it is not freed and allocated again and again.
        class.pages.truncate(class.len / PER_PAGE + 2);
        moved
    }

    /// Number of bricks stored.
    #[cfg(test)]
    pub fn live(&self) -> usize {
        self.classes.iter().map(|class| class.len).sum()
    }

    /// Memory held, bytes, including the overhead of the system allocator.
    pub fn bytes(&self) -> usize {
        let of = |(i, class): (usize, &SizeClass)| {
            class.pages.len() * (16 + 4 * PER_PAGE * stride(i)) + class.pages.capacity() * size_of::<PageBox<u32>>()
        };
        self.classes.iter().enumerate().map(of).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::brick::{BRICK, Brick};
    use crate::field::tsdf::storage::brick_codec::EncodedBrick;
    use crate::field::tsdf::voxel::Voxel;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    /// A brick of which `share` tenths are nonzero; `wide` voxels with their intensities need more than a word.
    fn brick(seed: u32, share: u32, wide: bool) -> Brick {
        let mut number = seed;
        let mut next = || {
            number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            number >> 8
        };
        let mut brick = Brick::zeroed();
        for i in 0..BRICK {
            if next() % 10 < share {
                brick.voxels[i] = Voxel { distance: next() as i16, weight: if wide { next() as u16 } else { (next() % 3) as u16 } };
                brick.intensities[i] = next() as u8;
            }
        }
        brick
    }

    proptest! {
        #[test]
        fn bricks_are_restored_exactly(bricks in prop::collection::vec((any::<u32>(), 0u32..=10, any::<bool>(), any::<bool>()), 1..60)) {
            let (mut store, mut encoded) = (CompressedStore::default(), EncodedBrick::EMPTY);
            let mut kept = Vec::new();
            for (i, &(seed, share, has_intensity, wide)) in bricks.iter().enumerate() {
                let brick = brick(seed, share, wide);
                encoded.encode(&brick, has_intensity);
                prop_assert!(encoded.words().len() <= MAX_WORDS);
                let count = (0..BRICK).filter(|&i| brick.voxels[i] != Voxel::default() || has_intensity && brick.intensities[i] != 0).count();
                prop_assert_eq!(encoded.is_empty(), count == 0);
                kept.push((store.insert(i as u32, encoded.words()), i as u32, brick, has_intensity));
                if i % 3 == 2 {
                    let number = kept.swap_remove(seed as usize % kept.len()).0;
                    if let Some(moved) = store.remove(number) {
                        kept.iter_mut().filter(|k| k.1 == moved).for_each(|k| k.0 = number);
                    }
                }
            }
            prop_assert_eq!(store.live(), kept.len());
            for (number, _, brick, has_intensity) in kept {
                let view = store.get(number);
                prop_assert_eq!(view.voxels(), brick.voxels);
                prop_assert!((0..BRICK).all(|i| view.voxel(i) == brick.voxels[i]));
                if has_intensity {
                    prop_assert_eq!(view.intensities(), brick.intensities);
                    prop_assert!((0..BRICK).all(|i| view.intensity(i) == brick.intensities[i]));
                }
            }
        }
    }
}
