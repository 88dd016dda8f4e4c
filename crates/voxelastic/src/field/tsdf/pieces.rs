//! Bricks at rest. Pieces of about the same length lie together without gaps: bricks grow from scan to scan, and places that they leave
//! would not be needed again.

use super::brick::Handle;
use super::packed::{LONGEST, Piece};
use crate::octree::prefetch;

/// Lengths of pieces are multiples of this many words.
const UNIT: usize = 2;
/// Different lengths of pieces: packed bricks and their owners.
const LENGTHS: usize = (1 + LONGEST).div_ceil(UNIT);
/// Bits of a piece's number that say which length it has.
const SHELF_BITS: u32 = usize::BITS - (LENGTHS - 1).leading_zeros();
/// Pieces of one length that a page holds: few, because every field has a page of each length that is not full.
const PER_PAGE: usize = 16;

/// The pieces of a field, addressed by number.
#[derive(Clone, Debug)]
pub(crate) struct Pieces {
    shelves: [Shelf; LENGTHS],
}

/// Pieces of one length, each an owner and a packed brick.
#[derive(Clone, Debug, Default)]
struct Shelf {
    pages: Vec<Box<[u32]>>,
    len: usize,
}

impl Shelf {
    #[inline(always)]
    fn piece(&self, place: usize, stride: usize) -> &[u32] {
        &self.pages[place / PER_PAGE][place % PER_PAGE * stride..][..stride]
    }

    fn piece_mut(&mut self, place: usize, stride: usize) -> &mut [u32] {
        &mut self.pages[place / PER_PAGE][place % PER_PAGE * stride..][..stride]
    }
}

impl Default for Pieces {
    fn default() -> Self {
        Self { shelves: std::array::from_fn(|_| Shelf::default()) }
    }
}

/// A piece's number: which of its length it is, and its length.
#[inline(always)]
fn number(shelf: usize, place: usize) -> u32 {
    (place as u32) << SHELF_BITS | shelf as u32
}

#[inline(always)]
fn shelf_and_place(number: u32) -> (usize, usize) {
    ((number & ((1 << SHELF_BITS) - 1)) as usize, (number >> SHELF_BITS) as usize)
}

/// Words of the pieces on a shelf.
#[inline(always)]
fn stride(shelf: usize) -> usize {
    UNIT * (shelf + 1)
}

impl Pieces {
    /// Stores what [`Packed::words`] gives for `owner`.
    ///
    /// # Panics
    /// When 2^25 pieces of one length are stored: a gigabyte about, of one submap.
    pub fn insert(&mut self, owner: u32, words: &[u32]) -> u32 {
        let length = (1 + words.len()).div_ceil(UNIT);
        let (shelf, stride) = (&mut self.shelves[length - 1], stride(length - 1));
        let place = shelf.len;
        assert!(place < Handle::MOST as usize >> SHELF_BITS, "a field has room for no more bricks");
        if place == shelf.pages.len() * PER_PAGE {
            shelf.pages.push(vec![0; PER_PAGE * stride].into_boxed_slice());
        }
        shelf.len += 1;
        let piece = shelf.piece_mut(place, stride);
        piece[0] = owner;
        piece[1..=words.len()].copy_from_slice(words);
        number(length - 1, place)
    }

    #[inline(always)]
    fn words(&self, number: u32) -> &[u32] {
        let (shelf, place) = shelf_and_place(number);
        self.shelves[shelf].piece(place, stride(shelf))
    }

    /// The piece with `number`.
    #[inline(always)]
    pub fn get(&self, number: u32) -> Piece<'_> {
        Piece::of(&self.words(number)[1..])
    }

    /// Asks for the piece with `number` to be brought near.
    #[inline(always)]
    pub fn ask_for(&self, number: u32) {
        for line in self.words(number).chunks(16) {
            prefetch(line.as_ptr());
        }
    }

    /// Forgets the piece with `number`. If another one takes its place, and so its number, returns whose that is.
    pub fn remove(&mut self, number: u32) -> Option<u32> {
        let (shelf, place) = shelf_and_place(number);
        let (shelf, stride) = (&mut self.shelves[shelf], stride(shelf));
        shelf.len -= 1;
        let (last, mut piece) = (shelf.len, [0; UNIT * LENGTHS]);
        let moved = (place < last).then(|| {
            piece[..stride].copy_from_slice(shelf.piece(last, stride));
            shelf.piece_mut(place, stride).copy_from_slice(&piece[..stride]);
            piece[0]
        });
        // One empty page is kept, lest it comes and goes.
        shelf.pages.truncate(shelf.len / PER_PAGE + 2);
        moved
    }

    /// Pieces stored.
    #[cfg(test)]
    pub fn live(&self) -> usize {
        self.shelves.iter().map(|shelf| shelf.len).sum()
    }

    /// Bytes held, and what an allocator adds.
    pub fn bytes(&self) -> usize {
        let of = |(i, shelf): (usize, &Shelf)| shelf.pages.len() * (16 + 4 * PER_PAGE * stride(i)) + shelf.pages.capacity() * size_of::<Box<[u32]>>();
        self.shelves.iter().enumerate().map(of).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::brick::{BRICK, Brick};
    use super::super::packed::Packed;
    use super::super::voxel::Voxel;
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    /// A brick of which tenths hold anything; `wide` voxels with their intensities take more than a word.
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
                brick.shades[i] = next() as u8;
            }
        }
        brick
    }

    proptest! {
        #[test]
        fn nothing_is_lost(bricks in prop::collection::vec((any::<u32>(), 0u32..=10, any::<bool>(), any::<bool>()), 1..60)) {
            let (mut pieces, mut packed) = (Pieces::default(), Packed::EMPTY);
            let mut kept = Vec::new();
            for (i, &(seed, share, shaded, wide)) in bricks.iter().enumerate() {
                let brick = brick(seed, share, wide);
                packed.pack(&brick, shaded);
                prop_assert!(packed.words().len() <= LONGEST);
                let held = (0..BRICK).filter(|&i| brick.voxels[i] != Voxel::default() || shaded && brick.shades[i] != 0).count();
                prop_assert_eq!(packed.is_empty(), held == 0);
                kept.push((pieces.insert(i as u32, packed.words()), i as u32, brick, shaded));
                if i % 3 == 2 {
                    let number = kept.swap_remove(seed as usize % kept.len()).0;
                    if let Some(moved) = pieces.remove(number) {
                        kept.iter_mut().filter(|k| k.1 == moved).for_each(|k| k.0 = number);
                    }
                }
            }
            prop_assert_eq!(pieces.live(), kept.len());
            for (number, _, brick, shaded) in kept {
                let piece = pieces.get(number);
                prop_assert_eq!(piece.voxels(), brick.voxels);
                prop_assert!((0..BRICK).all(|i| piece.voxel(i) == brick.voxels[i]));
                if shaded {
                    prop_assert_eq!(piece.shades(), brick.shades);
                    prop_assert!((0..BRICK).all(|i| piece.shade(i) == brick.shades[i]));
                }
            }
        }
    }
}
