//! Bricks packed: only the voxels that hold anything, with a map of where they are.
//!
//! Of the voxels of a brick that was ever met, one in three is observed. What is packed is a bitmap of 64 bits, the voxels that are held, and
//! their intensities if the block has any; nothing is lost, and any voxel can be read where it lies.

use super::brick::{BRICK, Brick, gather, spread};
use super::voxel::Voxel;
use crate::geometry::bits::{lowest_bits, rank};
use crate::octree::voxels_at;

/// Words of a packed brick that holds all voxels and their intensities.
pub(super) const LONGEST: usize = 2 + BRICK + BRICK / 4;

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
        mask |= lowest_bits(eight) << (8 * i);
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
    pub fn of(words: &'a [u32]) -> Self {
        let mask = u64::from(words[0]) | u64::from(words[1]) << 32;
        let (values, shades) = words[2..].split_at(mask.count_ones() as usize);
        Self { mask, values: bytemuck::cast_slice(values), shades: bytemuck::cast_slice(shades) }
    }

    /// Where voxel `place` is among those held.
    #[inline(always)]
    fn rank(self, place: usize) -> Option<usize> {
        (self.mask >> place & 1 == 1).then(|| rank(self.mask, place))
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
