//! Bricks at rest: only the voxels that hold anything, with a map of where they are.
//!
//! Of the voxels of a brick that was ever met, one in three is observed. A piece is a bitmap of 64 bits, the voxels that are held, and
//! their intensities if the block has any; nothing is lost, and any voxel can be read where it lies. Pieces of about the same length lie
//! together without gaps: bricks grow from scan to scan, and places that they leave would not be needed again.

use super::brick::{BRICK, Brick, Handle, gather, spread};
use super::voxel::Voxel;
use crate::octree::{prefetch, voxels_at};

/// Lengths of pieces are multiples of this many words.
const UNIT: usize = 4;
/// Words of a packed brick that holds all voxels and their intensities.
const LONGEST: usize = 2 + BRICK + BRICK / 4;
/// Different lengths of pieces: packed bricks and their owners.
const LENGTHS: usize = (1 + LONGEST).div_ceil(UNIT);
/// Pieces of one length that a page holds: few, because every field has a page of each length that is not full.
const PER_PAGE: usize = 16;

/// A brick packed, on its way to rest.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    words: [u32; LONGEST],
    /// Voxels that are held.
    held: usize,
    len: usize,
}

impl Packed {
    pub const EMPTY: Self = Self { words: [0; LONGEST], held: 0, len: 0 };

    /// Packs `brick`. Inlined, and made of loops only, for kernels that pack many.
    #[inline(always)]
    pub fn pack(&mut self, brick: &Brick, shaded: bool) {
        let mask = mask(brick, shaded);
        (self.words[0], self.words[1]) = (mask as u32, (mask >> 32) as u32);
        let mut places = [0u8; BRICK];
        let (mut left, mut held) = (mask, 0);
        while left != 0 {
            places[held % BRICK] = left.trailing_zeros() as u8;
            held += 1;
            left &= left - 1;
        }
        self.held = held;
        let (values, shades) = self.words[2..].split_at_mut(held);
        for (value, &place) in values.iter_mut().zip(&places) {
            *value = bytemuck::cast(brick.voxels[usize::from(place) % BRICK]);
        }
        self.len = 2 + held;
        if shaded {
            let words = held.div_ceil(4);
            // What fills up the last word is zero, so that equal bricks make equal pieces.
            shades[..words].fill(0);
            let shades: &mut [u8] = bytemuck::cast_slice_mut(&mut shades[..words]);
            for (shade, &place) in shades.iter_mut().zip(&places[..held]) {
                *shade = brick.shades[usize::from(place) % BRICK];
            }
            self.len += words;
        }
    }

    /// Whether no voxel holds anything.
    pub fn is_empty(&self) -> bool {
        self.held == 0
    }

    #[inline(always)]
    pub fn words(&self) -> &[u32] {
        &self.words[..self.len]
    }
}

/// An array packed, brick by brick: for keeping one for a while that belongs to no field.
#[derive(Clone, Debug, Default)]
pub(crate) struct PackedArray {
    words: Box<[u32]>,
    shaded: bool,
}

impl PackedArray {
    /// Packs an array at `scale`, with its intensities if it has any.
    pub fn new(scale: usize, voxels: &[Voxel], shades: Option<&[u8]>) -> Self {
        let (mut words, mut packed) = (Vec::new(), Packed::EMPTY);
        for brick in 0..voxels.len().div_ceil(BRICK) {
            let values = Brick { voxels: gather(voxels, scale, brick), shades: shades.map_or([0; BRICK], |shades| gather(shades, scale, brick)) };
            packed.pack(&values, shades.is_some());
            words.extend_from_slice(packed.words());
        }
        Self { words: words.into(), shaded: shades.is_some() }
    }

    /// Whether it has intensities.
    pub fn is_shaded(&self) -> bool {
        self.shaded
    }

    /// The words of each brick, as [`Pieces`] take them; none for one that holds nothing.
    pub fn bricks(&self) -> impl Iterator<Item = &[u32]> {
        let mut left = &self.words[..];
        std::iter::from_fn(move || {
            let held = (left.first()?.count_ones() + left.get(1)?.count_ones()) as usize;
            let (brick, rest) = left.split_at(2 + held + if self.shaded { held.div_ceil(4) } else { 0 });
            left = rest;
            Some(if held == 0 { &[] } else { brick })
        })
    }

    /// The array, which is at `scale`, and its intensities if it has any.
    pub fn unpack(&self, scale: usize) -> (Vec<Voxel>, Option<Vec<u8>>) {
        let mut voxels = vec![Voxel::default(); voxels_at(scale)];
        let mut shades = self.shaded.then(|| vec![0; voxels_at(scale)]);
        for (k, words) in self.bricks().enumerate().filter(|(_, words)| !words.is_empty()) {
            let piece = Piece::of(words);
            spread(&piece.voxels(), k, scale, &mut voxels);
            if let Some(shades) = &mut shades {
                spread(&piece.shades(), k, scale, shades);
            }
        }
        (voxels, shades)
    }
}

/// Which voxels of a brick, or their intensities, are anything but zero.
#[inline(always)]
fn mask(brick: &Brick, shaded: bool) -> u64 {
    let mut bytes = [0u8; BRICK];
    for (byte, v) in bytes.iter_mut().zip(&brick.voxels) {
        *byte = u8::from((v.distance as u16 | v.weight) != 0);
    }
    if shaded {
        for (byte, &shade) in bytes.iter_mut().zip(&brick.shades) {
            *byte |= u8::from(shade != 0);
        }
    }
    let mut mask = 0;
    for (i, b) in bytes.chunks_exact(8).enumerate() {
        let eight = u64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
        // The product gathers the lowest bits of eight bytes in its topmost byte.
        mask |= (eight.wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * i);
    }
    mask
}

/// A piece, where it lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece<'a> {
    mask: u64,
    values: &'a [Voxel],
    /// As many as values, or none, and some more.
    shades: &'a [u8],
}

impl<'a> Piece<'a> {
    #[inline(always)]
    fn of(words: &'a [u32]) -> Self {
        let mask = u64::from(words[0]) | u64::from(words[1]) << 32;
        let (values, shades) = words[2..].split_at(mask.count_ones() as usize);
        Self { mask, values: bytemuck::cast_slice(values), shades: bytemuck::cast_slice(shades) }
    }

    /// Where voxel `place` is among those held.
    #[inline(always)]
    fn rank(self, place: usize) -> Option<usize> {
        (self.mask >> place & 1 == 1).then(|| (self.mask & ((1 << place) - 1)).count_ones() as usize)
    }

    /// Voxel `place` of the brick.
    #[inline]
    pub fn voxel(self, place: usize) -> Voxel {
        self.rank(place).map_or(Voxel::default(), |k| self.values[k])
    }

    /// Intensity `place` of a brick that has intensities.
    #[inline]
    pub fn shade(self, place: usize) -> u8 {
        self.rank(place).map_or(0, |k| self.shades[k])
    }

    /// All voxels of the brick.
    #[inline(always)]
    pub fn voxels(self) -> [Voxel; BRICK] {
        let mut voxels = [Voxel::default(); BRICK];
        scatter(self.mask, self.values, &mut voxels);
        voxels
    }

    /// All intensities of a brick that has some.
    #[inline(always)]
    pub fn shades(self) -> [u8; BRICK] {
        let mut shades = [0; BRICK];
        scatter(self.mask, self.shades, &mut shades);
        shades
    }
}

#[inline(always)]
fn scatter<T: Copy>(mask: u64, values: &[T], array: &mut [T; BRICK]) {
    let mut left = mask;
    for &value in &values[..mask.count_ones() as usize] {
        array[left.trailing_zeros() as usize % BRICK] = value;
        left &= left - 1;
    }
}

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
    (place as u32) << 5 | shelf as u32
}

#[inline(always)]
fn shelf_and_place(number: u32) -> (usize, usize) {
    ((number & 31) as usize, (number >> 5) as usize)
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
    /// When 2^26 pieces of one length are stored: a gigabyte at least, of one submap.
    pub fn insert(&mut self, owner: u32, words: &[u32]) -> u32 {
        let length = (1 + words.len()).div_ceil(UNIT);
        let (shelf, stride) = (&mut self.shelves[length - 1], stride(length - 1));
        let place = shelf.len;
        assert!(place < Handle::MOST as usize >> 5, "a field has room for no more bricks");
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
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    fn brick(seed: u32, share: u32) -> Brick {
        let mut number = seed;
        let mut next = || {
            number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            number >> 8
        };
        let mut brick = Brick::zeroed();
        for i in 0..BRICK {
            if next() % 10 < share {
                brick.voxels[i] = Voxel { distance: next() as i16, weight: (next() % 3) as u16 };
                brick.shades[i] = next() as u8;
            }
        }
        brick
    }

    proptest! {
        #[test]
        fn nothing_is_lost(bricks in prop::collection::vec((any::<u32>(), 1u32..=10, any::<bool>()), 1..60)) {
            let (mut pieces, mut packed) = (Pieces::default(), Packed::EMPTY);
            let mut kept = Vec::new();
            for (i, &(seed, share, shaded)) in bricks.iter().enumerate() {
                let brick = brick(seed, share);
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
