//! Lossless encoding of a brick: a bitmap of its nonzero voxels, then their values in as few bits as they need.
//!
//! About a third of the voxels of a stored brick are observed, and their values are similar. So an encoded brick is a bitmap of 64 bits,
//! a header with the minimum of distance, weight and intensity, and for each nonzero voxel its differences from these minima, all with
//! the same number of bits. Any voxel can be read without decoding the others.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::bitstream::{BitWriter, read};
use crate::field::tsdf::brick::{BRICK, Brick, gather};
use crate::field::tsdf::voxel::Voxel;
use crate::simd::bits::{lowest_bits, rank};

/// Words before the voxels: the bitmap and the [`Header`].
const HEAD: usize = 4;
/// Largest length of an encoded brick, words: all voxels and intensities with their full number of bits.
pub(crate) const MAX_WORDS: usize = HEAD + BRICK + BRICK / 4;

/// How the voxels of a brick are encoded: the minimum of each quantity, and the number of bits of the differences from it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Header {
    distance: i16,
    weight: u16,
    /// The smallest known intensity, minus one.
    intensity: u8,
    distance_bits: u8,
    weight_bits: u8,
    /// Number of low bits in which all weights agree: most weights are multiples of a whole observation.
    weight_shift: u8,
    intensity_bits: u8,
}

impl Header {
    /// The header for the nonzero voxels of `brick`. Zero voxels take part without effect, so that the loop vectorises.
    #[inline(always)]
    fn of(brick: &Contents) -> Self {
        let (mut min_distance, mut max_distance, mut min_weight, mut max_weight) = (i32::MAX, i32::MIN, u32::MAX, 0);
        let (mut any_weight, mut all_weights) = (0, u32::MAX);
        // The code of an unknown intensity is zero, so known ones start at one.
        let (mut min_intensity, mut max_intensity) = (u32::from(u8::MAX), 0);
        for i in 0..BRICK {
            let (voxel, intensity) = (brick.voxels[i], brick.intensities[i]);
            let is_stored = (voxel | intensity) != 0;
            let (distance, weight) = (distance_of(voxel), weight_of(voxel));
            min_distance = min_distance.min(if is_stored { distance } else { i32::MAX });
            max_distance = max_distance.max(if is_stored { distance } else { i32::MIN });
            min_weight = min_weight.min(if is_stored { weight } else { u32::MAX });
            all_weights &= if is_stored { weight } else { u32::MAX };
            max_weight = max_weight.max(weight);
            any_weight |= weight;
            min_intensity = min_intensity.min(intensity.wrapping_sub(1) & 0xff);
            max_intensity = max_intensity.max(intensity);
        }
        if max_distance < min_distance {
            return Self::default();
        }
        // Low bits in which all weights agree are zero in every difference from the minimum.
        let differing = any_weight & !all_weights;
        let shift = if differing == 0 { 0 } else { differing.trailing_zeros() };
        let min_intensity = min_intensity.min(max_intensity);
        Self {
            distance: min_distance as i16,
            weight: min_weight as u16,
            intensity: min_intensity as u8,
            distance_bits: bits((max_distance - min_distance) as u32),
            weight_bits: bits((max_weight - min_weight) >> shift),
            weight_shift: shift as u8,
            intensity_bits: bits(max_intensity - min_intensity),
        }
    }

    #[inline(always)]
    fn to_words(self) -> [u32; 2] {
        let [intensity, distance_bits, weight_bits, weight_shift, intensity_bits] =
            [self.intensity, self.distance_bits, self.weight_bits, self.weight_shift, self.intensity_bits].map(u32::from);
        let minima = u32::from(self.distance as u16) | u32::from(self.weight) << 16;
        [minima, intensity | distance_bits << 8 | weight_bits << 13 | weight_shift << 18 | intensity_bits << 22]
    }

    #[inline(always)]
    fn from_words([minima, bits]: [u32; 2]) -> Self {
        let part = |first: u32, count: u32| (bits >> first & ((1 << count) - 1)) as u8;
        Self {
            distance: minima as i16,
            weight: (minima >> 16) as u16,
            intensity: part(0, 8),
            distance_bits: part(8, 5),
            weight_bits: part(13, 5),
            weight_shift: part(18, 4),
            intensity_bits: part(22, 4),
        }
    }

    /// Bits of an encoded voxel, without intensity.
    #[inline(always)]
    fn voxel_bits(self) -> u32 {
        u32::from(self.distance_bits + self.weight_bits)
    }

    /// Bits of an encoded voxel with its intensity.
    #[inline(always)]
    fn code_bits(self) -> u32 {
        self.voxel_bits() + u32::from(self.intensity_bits)
    }

    /// Words of `count` encoded voxels with their intensities.
    #[inline(always)]
    fn length(self, count: usize) -> usize {
        (count * self.code_bits() as usize).div_ceil(32)
    }

    /// The code of a nonzero voxel; an arbitrary number for others.
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
    fn encode_intensity(self, intensity: u32) -> u32 {
        if intensity == 0 { 0 } else { intensity - u32::from(self.intensity) }
    }

    #[inline(always)]
    fn decode_intensity(self, code: u32) -> u8 {
        if code == 0 { 0 } else { self.intensity + code as u8 }
    }
}

/// Number of bits that hold any number up to `max`.
#[inline(always)]
fn bits(max: u32) -> u8 {
    (u32::BITS - max.leading_zeros()) as u8
}

/// The voxels of a brick as numbers (distance in the low half, weight in the high one) and their intensities (zeros for a brick without).
struct Contents {
    voxels: [u32; BRICK],
    intensities: [u32; BRICK],
}

impl Contents {
    #[inline(always)]
    fn of(brick: &Brick, has_intensity: bool) -> Self {
        let mut contents = Self { voxels: [0; BRICK], intensities: [0; BRICK] };
        for i in 0..BRICK {
            let Voxel { distance, weight } = brick.voxels[i];
            contents.voxels[i] = u32::from(distance as u16) | u32::from(weight) << 16;
            contents.intensities[i] = if has_intensity { u32::from(brick.intensities[i]) } else { 0 };
        }
        contents
    }

    /// Bit set of the voxels of which voxel or intensity is nonzero.
    #[inline(always)]
    fn mask(&self) -> u64 {
        let mut bytes = [0u8; BRICK];
        for i in 0..BRICK {
            bytes[i] = u8::from((self.voxels[i] | self.intensities[i]) != 0);
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

/// A buffer for one encoded brick.
#[derive(Clone, Debug)]
pub(crate) struct EncodedBrick {
    /// One word more than the longest brick, which the bit writer may write to.
    words: [u32; MAX_WORDS + 1],
    /// Number of nonzero voxels.
    count: usize,
    len: usize,
}

impl EncodedBrick {
    /// The encoding of a brick of zeros.
    pub const EMPTY: Self = Self { words: [0; MAX_WORDS + 1], count: 0, len: 0 };

    /// Encodes `brick` into this buffer. Inlined and without closures, for kernels that encode many.
    #[inline(always)]
    pub fn encode(&mut self, brick: &Brick, has_intensity: bool) {
        let contents = Contents::of(brick, has_intensity);
        let (mask, header) = (contents.mask(), Header::of(&contents));
        (self.words[0], self.words[1]) = (mask as u32, (mask >> 32) as u32);
        [self.words[2], self.words[3]] = header.to_words();
        let (mut codes, mut intensities) = ([0; BRICK], [0; BRICK]);
        for i in 0..BRICK {
            codes[i] = header.encode(contents.voxels[i]);
            intensities[i] = header.encode_intensity(contents.intensities[i]);
        }
        let mut writer = BitWriter::new(&mut self.words[HEAD..]);
        let mut left = mask;
        if header.code_bits() <= 32 {
            for i in 0..BRICK {
                codes[i] |= (u64::from(intensities[i]) << header.voxel_bits()) as u32;
            }
            while left != 0 {
                writer.push(codes[left.trailing_zeros() as usize % BRICK], header.code_bits());
                left &= left - 1;
            }
        } else {
            while left != 0 {
                let i = left.trailing_zeros() as usize % BRICK;
                writer.push(codes[i], header.voxel_bits());
                writer.push(intensities[i], header.intensity_bits.into());
                left &= left - 1;
            }
        }
        (self.count, self.len) = (mask.count_ones() as usize, HEAD + writer.finish());
    }

    /// Whether all voxels are zero.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The encoded brick.
    #[inline(always)]
    pub fn words(&self) -> &[u32] {
        &self.words[..self.len]
    }
}

/// An array encoded brick by brick, outside of any field.
#[derive(Clone, Debug, Default)]
pub(crate) struct EncodedArray {
    words: Vec<u32>,
    has_intensity: bool,
}

impl EncodedArray {
    /// Encodes an array at `scale`, with its intensities if it has any.
    pub fn new(scale: usize, voxels: &[Voxel], intensities: Option<&[u8]>) -> Self {
        let bricks = (0..voxels.len().div_ceil(BRICK)).map(|brick| Brick {
            voxels: gather(voxels, scale, brick),
            intensities: intensities.map_or([0; BRICK], |intensities| gather(intensities, scale, brick)),
        });
        Self::of_bricks(bricks, intensities.is_some())
    }

    /// Encodes the bricks of an array.
    pub fn of_bricks(bricks: impl Iterator<Item = Brick>, has_intensity: bool) -> Self {
        let (mut words, mut encoded) = (Vec::with_capacity(BRICK * bricks.size_hint().0 / 2), EncodedBrick::EMPTY);
        for brick in bricks {
            encoded.encode(&brick, has_intensity);
            words.extend_from_slice(encoded.words());
        }
        Self { words, has_intensity }
    }

    /// The same without spare memory, for arrays of which many are kept.
    pub fn into_tight(mut self) -> Self {
        self.words.shrink_to_fit();
        self
    }

    /// Whether the array has intensities.
    pub fn has_intensity(&self) -> bool {
        self.has_intensity
    }

    /// The words of each encoded brick; empty for a brick of zeros.
    pub fn bricks(&self) -> impl Iterator<Item = &[u32]> {
        let mut left = &self.words[..];
        std::iter::from_fn(move || {
            let view = (!left.is_empty()).then(|| BrickView::new(left))?;
            let (brick, others) = left.split_at(HEAD + view.codes.len());
            left = others;
            Some(if view.mask == 0 { &[] } else { brick })
        })
    }
}

/// An encoded brick, read in place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BrickView<'a> {
    mask: u64,
    header: Header,
    /// The codes of the nonzero voxels: voxel and intensity.
    codes: &'a [u32],
}

impl<'a> BrickView<'a> {
    /// The encoded brick at the beginning of `words`.
    #[inline(always)]
    pub fn new(words: &'a [u32]) -> Self {
        let mask = u64::from(words[0]) | u64::from(words[1]) << 32;
        let header = Header::from_words([words[2], words[3]]);
        Self { mask, header, codes: &words[HEAD..HEAD + header.length(mask.count_ones() as usize)] }
    }

    /// Bit set of the observed voxels. Unobserved ones are stored, too, if they have an intensity.
    #[inline]
    pub fn observed(self) -> u64 {
        if self.header.weight > 0 {
            return self.mask;
        }
        self.voxels().iter().rev().fold(0, |observed, voxel| observed << 1 | u64::from(voxel.is_observed()))
    }

    /// Number of the code of voxel `index`; none for a zero voxel.
    #[inline(always)]
    fn rank(self, index: usize) -> Option<usize> {
        (self.mask >> index & 1 == 1).then(|| rank(self.mask, index))
    }

    /// The voxel with code number `k`.
    #[inline(always)]
    fn decode_voxel(self, k: usize) -> Voxel {
        self.header.decode(read(self.codes, k * self.header.code_bits() as usize, self.header.voxel_bits()))
    }

    /// The intensity with code number `k`.
    #[inline(always)]
    fn decode_intensity(self, k: usize) -> u8 {
        let first = k * self.header.code_bits() as usize + self.header.voxel_bits() as usize;
        self.header.decode_intensity(read(self.codes, first, self.header.intensity_bits.into()))
    }

    /// Voxel `index` of the brick.
    #[inline]
    pub fn voxel(self, index: usize) -> Voxel {
        self.rank(index).map_or(Voxel::default(), |k| self.decode_voxel(k))
    }

    /// Intensity `index` of the brick; 0 in a brick without intensities.
    #[inline]
    pub fn intensity(self, index: usize) -> u8 {
        self.rank(index).map_or(0, |k| self.decode_intensity(k))
    }

    /// Appends the nonzero voxels among those of the mask `within`; returns their mask.
    pub fn append_voxels(self, within: u64, out: &mut Vec<Voxel>) -> u64 {
        let stored = self.mask & within;
        let voxels = (0..stored.count_ones() as usize).map(|k| self.decode_voxel(k));
        if self.header.weight > 0 {
            out.extend(voxels);
            return stored;
        }
        // Zero voxels are stored, too, if they have an intensity.
        append_nonzero(stored, voxels, out)
    }

    /// Appends the nonzero intensities among those of the mask `within`; returns their mask.
    pub fn append_intensities(self, within: u64, out: &mut Vec<u8>) -> u64 {
        let stored = if self.header.intensity_bits == 0 { 0 } else { self.mask & within };
        append_nonzero(stored, (0..stored.count_ones() as usize).map(|k| self.decode_intensity(k)), out)
    }

    /// All voxels of the brick.
    #[inline(always)]
    pub fn voxels(self) -> [Voxel; BRICK] {
        scatter(self.mask, |k| self.decode_voxel(k))
    }

    /// All intensities of the brick; zeros in a brick without intensities.
    #[inline(always)]
    pub fn intensities(self) -> [u8; BRICK] {
        scatter(self.mask, |k| self.decode_intensity(k))
    }
}

/// Appends those of the values at the set bits of `mask` that are not zero; returns their mask.
#[inline(always)]
fn append_nonzero<T: Copy + Default + PartialEq>(mask: u64, values: impl Iterator<Item = T>, out: &mut Vec<T>) -> u64 {
    let (mut kept, mut count) = ([T::default(); BRICK], 0);
    let (mut left, mut nonzero) = (mask, 0);
    for value in values {
        // A branch would be unpredictable.
        let is_set = u64::from(value != T::default());
        kept[count % BRICK] = value;
        count += is_set as usize;
        nonzero |= is_set << left.trailing_zeros();
        left &= left - 1;
    }
    out.extend_from_slice(&kept[..count]);
    nonzero
}

/// Stores value number k at the position of the k-th set bit of `mask`, and the default elsewhere.
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
