//! Bricks packed: only the voxels that hold anything, with a map of where they are, in no more bits than they need.
//!
//! Of the voxels of a brick that was ever met, about a third are observed, and what they hold is alike. So what is packed is a bitmap of 64 bits, the least distance, weight and intensity, and by how much
//! each voxel exceeds them. Nothing is lost, and any voxel can be read where it lies.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::bitstream::{BitWriter, read};
use super::brick::{BRICK, Brick, gather, spread};
use super::voxel::Voxel;
use crate::geometry::bits::{lowest_bits, rank};
use crate::octree::voxels_at;

/// Words before the voxels: the bitmap and the [`Form`].
const HEAD: usize = 4;
/// Words of a packed brick that holds all voxels and their intensities in full length.
pub(super) const LONGEST: usize = HEAD + BRICK + BRICK / 4;

/// How the voxels of a packed brick are written: the least of each quantity, and how many bits the differences from it have.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Form {
    distance: i16,
    weight: u16,
    /// The least intensity that is known, less one.
    shade: u8,
    distance_bits: u8,
    weight_bits: u8,
    /// Lowest bits of weights that never differ: most weights are of whole observations.
    weight_shift: u8,
    shade_bits: u8,
}

impl Form {
    /// The form that fits the voxels of a brick that hold anything. All are looked at, the others without effect, for the sake of vectors.
    #[inline(always)]
    fn of(brick: &Contents) -> Self {
        let (mut near, mut far, mut light, mut heavy) = (i32::MAX, i32::MIN, u32::MAX, 0);
        let (mut any, mut all) = (0, u32::MAX);
        // Zero is unknown and stays zero: known ones follow it.
        let (mut dark, mut bright) = (u32::from(u8::MAX), 0);
        for i in 0..BRICK {
            let (voxel, shade) = (brick.voxels[i], brick.shades[i]);
            let held = (voxel | shade) != 0;
            let (distance, weight) = (distance_of(voxel), weight_of(voxel));
            near = near.min(if held { distance } else { i32::MAX });
            far = far.max(if held { distance } else { i32::MIN });
            light = light.min(if held { weight } else { u32::MAX });
            all &= if held { weight } else { u32::MAX };
            heavy = heavy.max(weight);
            any |= weight;
            dark = dark.min(shade.wrapping_sub(1) & 0xff);
            bright = bright.max(shade);
        }
        if far < near {
            return Self::default();
        }
        // A difference from the least has the zeros at its end that all have in common.
        let differing = any & !all;
        let shift = if differing == 0 { 0 } else { differing.trailing_zeros() };
        let dark = dark.min(bright);
        Self {
            distance: near as i16,
            weight: light as u16,
            shade: dark as u8,
            distance_bits: bits((far - near) as u32),
            weight_bits: bits((heavy - light) >> shift),
            weight_shift: shift as u8,
            shade_bits: bits(bright - dark),
        }
    }

    #[inline(always)]
    fn to_words(self) -> [u32; 2] {
        let [shade, distance_bits, weight_bits, weight_shift, shade_bits] =
            [self.shade, self.distance_bits, self.weight_bits, self.weight_shift, self.shade_bits].map(u32::from);
        let least = u32::from(self.distance as u16) | u32::from(self.weight) << 16;
        [least, shade | distance_bits << 8 | weight_bits << 13 | weight_shift << 18 | shade_bits << 22]
    }

    #[inline(always)]
    fn from_words([least, rest]: [u32; 2]) -> Self {
        let part = |first: u32, bits: u32| (rest >> first & ((1 << bits) - 1)) as u8;
        Self {
            distance: least as i16,
            weight: (least >> 16) as u16,
            shade: part(0, 8),
            distance_bits: part(8, 5),
            weight_bits: part(13, 5),
            weight_shift: part(18, 4),
            shade_bits: part(22, 4),
        }
    }

    /// Bits of a voxel.
    #[inline(always)]
    fn voxel_bits(self) -> u32 {
        u32::from(self.distance_bits + self.weight_bits)
    }

    /// Bits of a voxel and its intensity.
    #[inline(always)]
    fn code_bits(self) -> u32 {
        self.voxel_bits() + u32::from(self.shade_bits)
    }

    /// Words of `held` voxels and their intensities.
    #[inline(always)]
    fn length(self, held: usize) -> usize {
        (held * self.code_bits() as usize).div_ceil(32)
    }

    /// The code of a voxel that holds anything; of others, something.
    #[inline(always)]
    fn encode(self, voxel: u32) -> u32 {
        let distance = distance_of(voxel).wrapping_sub(i32::from(self.distance)) as u32;
        let weight = weight_of(voxel).wrapping_sub(u32::from(self.weight)) >> self.weight_shift;
        distance | weight << self.distance_bits
    }

    #[inline(always)]
    fn decode(self, code: u32) -> Voxel {
        let distance = code & ((1 << self.distance_bits) - 1);
        let weight = ((code >> self.distance_bits) << self.weight_shift) as u16;
        Voxel { distance: self.distance.wrapping_add(distance as i16), weight: self.weight + weight }
    }

    #[inline(always)]
    fn encode_shade(self, shade: u32) -> u32 {
        if shade == 0 { 0 } else { shade - u32::from(self.shade) }
    }

    #[inline(always)]
    fn decode_shade(self, code: u32) -> u8 {
        if code == 0 { 0 } else { self.shade + code as u8 }
    }
}

/// Bits of the largest number.
#[inline(always)]
fn bits(most: u32) -> u8 {
    (u32::BITS - most.leading_zeros()) as u8
}

/// The voxels of a brick as numbers, distance below weight, and their intensities; zeros for a brick without.
struct Contents {
    voxels: [u32; BRICK],
    shades: [u32; BRICK],
}

impl Contents {
    #[inline(always)]
    fn of(brick: &Brick, shaded: bool) -> Self {
        let mut contents = Self { voxels: [0; BRICK], shades: [0; BRICK] };
        for i in 0..BRICK {
            let Voxel { distance, weight } = brick.voxels[i];
            contents.voxels[i] = u32::from(distance as u16) | u32::from(weight) << 16;
            contents.shades[i] = if shaded { u32::from(brick.shades[i]) } else { 0 };
        }
        contents
    }

    /// Which of them are anything but zero.
    #[inline(always)]
    fn mask(&self) -> u64 {
        let mut bytes = [0u8; BRICK];
        for i in 0..BRICK {
            bytes[i] = u8::from((self.voxels[i] | self.shades[i]) != 0);
        }
        let mut mask = 0;
        for (i, b) in bytes.chunks_exact(8).enumerate() {
            let eight = u64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
            mask |= lowest_bits(eight) << (8 * i);
        }
        mask
    }
}

#[inline(always)]
fn distance_of(voxel: u32) -> i32 {
    (voxel as i32) << 16 >> 16
}

#[inline(always)]
fn weight_of(voxel: u32) -> u32 {
    voxel >> 16
}

/// A brick packed, on its way to rest.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    /// And one more, where the last number may reach into.
    words: [u32; LONGEST + 1],
    /// Voxels that are held.
    held: usize,
    len: usize,
}

impl Packed {
    pub const EMPTY: Self = Self { words: [0; LONGEST + 1], held: 0, len: 0 };

    /// Packs `brick`. Inlined, and made of loops only, for kernels that pack many.
    #[inline(always)]
    pub fn pack(&mut self, brick: &Brick, shaded: bool) {
        let contents = Contents::of(brick, shaded);
        let (mask, form) = (contents.mask(), Form::of(&contents));
        (self.words[0], self.words[1]) = (mask as u32, (mask >> 32) as u32);
        [self.words[2], self.words[3]] = form.to_words();
        let (mut codes, mut shades) = ([0; BRICK], [0; BRICK]);
        for i in 0..BRICK {
            codes[i] = form.encode(contents.voxels[i]);
            shades[i] = form.encode_shade(contents.shades[i]);
        }
        let mut writer = BitWriter::new(&mut self.words[HEAD..]);
        let mut left = mask;
        if form.code_bits() <= 32 {
            for i in 0..BRICK {
                codes[i] |= (u64::from(shades[i]) << form.voxel_bits()) as u32;
            }
            while left != 0 {
                writer.push(codes[left.trailing_zeros() as usize % BRICK], form.code_bits());
                left &= left - 1;
            }
        } else {
            while left != 0 {
                let place = left.trailing_zeros() as usize % BRICK;
                writer.push(codes[place], form.voxel_bits());
                writer.push(shades[place], form.shade_bits.into());
                left &= left - 1;
            }
        }
        (self.held, self.len) = (mask.count_ones() as usize, HEAD + writer.finish());
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
            let piece = (!left.is_empty()).then(|| Piece::of(left))?;
            let (brick, rest) = left.split_at(HEAD + piece.codes.len());
            left = rest;
            Some(if piece.mask == 0 { &[] } else { brick })
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

/// A piece, where it lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece<'a> {
    mask: u64,
    form: Form,
    /// A code for each voxel that is held: voxel and intensity.
    codes: &'a [u32],
}

impl<'a> Piece<'a> {
    /// The piece at the beginning of `words`.
    #[inline(always)]
    pub fn of(words: &'a [u32]) -> Self {
        let mask = u64::from(words[0]) | u64::from(words[1]) << 32;
        let form = Form::from_words([words[2], words[3]]);
        Self { mask, form, codes: &words[HEAD..HEAD + form.length(mask.count_ones() as usize)] }
    }

    /// Which voxels are held, a bit each.
    #[inline(always)]
    pub fn held(self) -> u64 {
        self.mask
    }

    /// Where voxel `place` is among those held.
    #[inline(always)]
    fn rank(self, place: usize) -> Option<usize> {
        (self.mask >> place & 1 == 1).then(|| rank(self.mask, place))
    }

    /// Voxel number `k` of those held.
    #[inline(always)]
    fn held_voxel(self, k: usize) -> Voxel {
        self.form.decode(read(self.codes, k * self.form.code_bits() as usize, self.form.voxel_bits()))
    }

    /// The intensity of voxel number `k` of those held.
    #[inline(always)]
    fn held_shade(self, k: usize) -> u8 {
        let first = k * self.form.code_bits() as usize + self.form.voxel_bits() as usize;
        self.form.decode_shade(read(self.codes, first, self.form.shade_bits.into()))
    }

    /// Voxel `place` of the brick.
    #[inline]
    pub fn voxel(self, place: usize) -> Voxel {
        self.rank(place).map_or(Voxel::default(), |k| self.held_voxel(k))
    }

    /// Intensity `place` of the brick; 0 for those of a brick without intensities.
    #[inline]
    pub fn shade(self, place: usize) -> u8 {
        self.rank(place).map_or(0, |k| self.held_shade(k))
    }

    /// All voxels of the brick.
    #[inline(always)]
    pub fn voxels(self) -> [Voxel; BRICK] {
        scatter(self.mask, |k| self.held_voxel(k))
    }

    /// All intensities of the brick; zeros for one without.
    #[inline(always)]
    pub fn shades(self) -> [u8; BRICK] {
        scatter(self.mask, |k| self.held_shade(k))
    }
}

/// Puts one value after the other into the places that `mask` names.
#[inline(always)]
fn scatter<T: Copy + Default>(mask: u64, value: impl Fn(usize) -> T) -> [T; BRICK] {
    let mut array = [T::default(); BRICK];
    let (mut left, mut next) = (mask, 0);
    while left != 0 {
        array[left.trailing_zeros() as usize % BRICK] = value(next);
        next += 1;
        left &= left - 1;
    }
    array
}
