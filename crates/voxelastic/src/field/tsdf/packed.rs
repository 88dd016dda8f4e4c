//! Bricks packed: only the voxels that hold anything, with a map of where they are, in no more bits than they need.
//!
//! Of the voxels of a brick that was ever met, about a third are observed, and what they hold is alike. So what is packed is a bitmap of 64 bits, the least distance, weight and intensity, and by how much
//! each voxel exceeds them. Nothing is lost, and any voxel can be read where it lies.

use super::bitstream::{BitReader, BitWriter, read};
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
    /// The form that fits the voxels `held`, and their intensities if they have any.
    #[inline(always)]
    fn of(held: &[Voxel], shades: &[u8]) -> Self {
        if held.is_empty() {
            return Self::default();
        }
        let (mut near, mut far, mut light, mut heavy) = (i16::MAX, i16::MIN, u16::MAX, 0);
        for v in held {
            (near, far) = (near.min(v.distance), far.max(v.distance));
            (light, heavy) = (light.min(v.weight), heavy.max(v.weight));
        }
        let differing = held.iter().fold(0, |all, v| all | (v.weight ^ light));
        // A difference from the least has the zeros at its end that both have in common.
        let shift = if differing == 0 { 0 } else { differing.trailing_zeros() };
        // Zero is unknown and stays zero: known ones follow it.
        let (mut dark, mut bright) = (u8::MAX, 0);
        for &shade in shades {
            (dark, bright) = (dark.min(shade.wrapping_sub(1)), bright.max(shade));
        }
        let dark = dark.min(bright);
        Self {
            distance: near,
            weight: light,
            shade: dark,
            distance_bits: bits((i32::from(far) - i32::from(near)) as u32),
            weight_bits: bits(u32::from(heavy - light) >> shift),
            weight_shift: shift as u8,
            shade_bits: bits(u32::from(bright - dark)),
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

    /// Words of `held` voxels, and of their intensities.
    #[inline(always)]
    fn lengths(self, held: usize) -> [usize; 2] {
        [self.voxel_bits(), u32::from(self.shade_bits)].map(|bits| (held * bits as usize).div_ceil(32))
    }

    #[inline(always)]
    fn encode(self, voxel: Voxel) -> u32 {
        let distance = (i32::from(voxel.distance) - i32::from(self.distance)) as u32;
        distance | u32::from((voxel.weight - self.weight) >> self.weight_shift) << self.distance_bits
    }

    #[inline(always)]
    fn decode(self, code: u32) -> Voxel {
        let distance = code & ((1 << self.distance_bits) - 1);
        let weight = ((code >> self.distance_bits) << self.weight_shift) as u16;
        Voxel { distance: self.distance.wrapping_add(distance as i16), weight: self.weight + weight }
    }

    #[inline(always)]
    fn encode_shade(self, shade: u8) -> u32 {
        u32::from(if shade == 0 { 0 } else { shade - self.shade })
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
        let mask = mask(brick, shaded);
        let (mut voxels, mut shades) = ([Voxel::default(); BRICK], [0; BRICK]);
        let (mut left, mut held) = (mask, 0);
        while left != 0 {
            let place = left.trailing_zeros() as usize % BRICK;
            (voxels[held % BRICK], shades[held % BRICK]) = (brick.voxels[place], brick.shades[place]);
            held += 1;
            left &= left - 1;
        }
        let (voxels, shades) = (&voxels[..held], &shades[..if shaded { held } else { 0 }]);
        let form = Form::of(voxels, shades);
        (self.words[0], self.words[1]) = (mask as u32, (mask >> 32) as u32);
        [self.words[2], self.words[3]] = form.to_words();
        let mut writer = BitWriter::new(&mut self.words[HEAD..]);
        for &voxel in voxels {
            writer.push(form.encode(voxel), form.voxel_bits());
        }
        let begin = HEAD + writer.finish();
        let mut writer = BitWriter::new(&mut self.words[begin..]);
        for &shade in shades {
            writer.push(form.encode_shade(shade), form.shade_bits.into());
        }
        (self.held, self.len) = (held, begin + writer.finish());
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
            let (brick, rest) = left.split_at(HEAD + piece.form.lengths(piece.held()).iter().sum::<usize>());
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
    form: Form,
    voxels: &'a [u32],
    shades: &'a [u32],
}

impl<'a> Piece<'a> {
    /// The piece at the beginning of `words`.
    #[inline(always)]
    pub fn of(words: &'a [u32]) -> Self {
        let mask = u64::from(words[0]) | u64::from(words[1]) << 32;
        let form = Form::from_words([words[2], words[3]]);
        let [voxels, shades] = form.lengths(mask.count_ones() as usize);
        let (voxels, shades) = words[HEAD..HEAD + voxels + shades].split_at(voxels);
        Self { mask, form, voxels, shades }
    }

    /// Voxels held.
    #[inline(always)]
    fn held(self) -> usize {
        self.mask.count_ones() as usize
    }

    /// Where voxel `place` is among those held.
    #[inline(always)]
    fn rank(self, place: usize) -> Option<usize> {
        (self.mask >> place & 1 == 1).then(|| rank(self.mask, place))
    }

    /// Voxel `place` of the brick.
    #[inline]
    pub fn voxel(self, place: usize) -> Voxel {
        self.rank(place).map_or(Voxel::default(), |k| self.form.decode(read(self.voxels, self.form.voxel_bits(), k)))
    }

    /// Intensity `place` of the brick; 0 for those of a brick without intensities.
    #[inline]
    pub fn shade(self, place: usize) -> u8 {
        self.rank(place).map_or(0, |k| self.form.decode_shade(read(self.shades, self.form.shade_bits.into(), k)))
    }

    /// All voxels of the brick.
    #[inline(always)]
    pub fn voxels(self) -> [Voxel; BRICK] {
        let mut codes = BitReader::new(self.voxels, self.form.voxel_bits());
        scatter(self.mask, || self.form.decode(codes.next()))
    }

    /// All intensities of the brick; zeros for one without.
    #[inline(always)]
    pub fn shades(self) -> [u8; BRICK] {
        let mut codes = BitReader::new(self.shades, self.form.shade_bits.into());
        scatter(self.mask, || self.form.decode_shade(codes.next()))
    }
}

/// Puts the next value into each place that `mask` names.
#[inline(always)]
fn scatter<T: Copy + Default>(mask: u64, mut next: impl FnMut() -> T) -> [T; BRICK] {
    let mut array = [T::default(); BRICK];
    let mut left = mask;
    while left != 0 {
        array[left.trailing_zeros() as usize % BRICK] = next();
        left &= left - 1;
    }
    array
}
