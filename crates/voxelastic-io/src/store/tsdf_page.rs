//! A page of a TSDF: some hundred blocks, as a sequence of streams (numbers little endian):
//!
//! 1. one byte per block: scale in bits 0-1, finest scale in bits 2-3, whether it has intensities in bit 4;
//! 2. the blocks' keys as differences to the key before (the first to 0), in base 128;
//! 3. a bit per voxel of all blocks' arrays, end to end, least bit first: whether the voxel is anything but zero;
//! 4. of these voxels the distances, each as the difference to the one before, signs folded into the lowest bit:
//!    all low bytes, then all high bytes;
//! 5. of these voxels the weights, in sixteenths of an observation (of a 64th in version 1): all low bytes, then all high bytes;
//! 6. a bit per intensity of all blocks' arrays: whether it is anything but zero; then those that are.
//!
//! On the hall at 5 cm three voxels of four are unobserved: leaving them out makes packing twice as fast, and splitting
//! bytes by their place makes the result a sixth smaller than packing the voxels as they lie in memory.

use super::bytes::{Bytes, push_varint};
use super::frames::{FULL, LARGEST};
use voxelastic::field::tsdf::{TsdfField, Voxel, WEIGHT_ONE};
use voxelastic::field::{BlockHead, TsdfBuilder};
use xxhash_rust::xxh3::Xxh3;

// Files have weights in the field's unit: another unit is another version of the format.
const _: () = assert!(WEIGHT_ONE == 16);

/// Bytes that a block counts for: its arrays and more than its head takes.
fn cost(head: &BlockHead) -> usize {
    16 + head.voxel_count() * size_of::<Voxel>() + head.intensity_count()
}

/// Cuts blocks, in Morton order, into pages.
pub(super) fn cut<'a>(field: &TsdfField, ids: &'a [u32]) -> Vec<&'a [u32]> {
    let mut size = 0;
    let mut full = false;
    ids.chunk_by(|&id, _| {
        size = if full { 0 } else { size } + cost(&field.head(id));
        full = size >= FULL;
        !full
    })
    .collect()
}

/// A hash of everything that the page of the blocks `ids` holds.
pub(super) fn digest(field: &TsdfField, ids: &[u32]) -> u64 {
    unpack(field, ids, |_| ()).digest
}

/// The arrays of a page's blocks, end to end.
struct Arrays {
    voxels: Vec<Voxel>,
    intensities: Vec<u8>,
    /// Of everything that the page holds.
    digest: u64,
}

/// Unpacks the blocks `ids`, and tells `visit` their heads.
fn unpack(field: &TsdfField, ids: &[u32], mut visit: impl FnMut(&BlockHead)) -> Arrays {
    let (mut hash, mut voxels, mut intensities) = (Xxh3::new(), Vec::new(), Vec::new());
    field.append_stored(ids, &mut voxels, &mut intensities, |head, voxels, intensities| {
        visit(&head);
        hash.update(&head.key.to_le_bytes());
        hash.update(&[head.scale, head.finest, u8::from(head.has_intensity)]);
        hash.update(bytemuck::cast_slice(voxels));
        hash.update(intensities);
    });
    Arrays { voxels, intensities, digest: hash.digest() }
}

/// Appends the page of the blocks `ids` to `raw`; returns how many blocks it has, and its [`digest`]: unpacking bricks takes longer than hashing
/// them, and so is done once for both.
pub(super) fn fill(field: &TsdfField, ids: &[u32], raw: &mut Vec<u8>) -> (usize, u64) {
    let mut keys = Vec::with_capacity(2 * ids.len());
    let mut last = 0;
    let Arrays { mut voxels, mut intensities, digest } = unpack(field, ids, |head| {
        raw.push(head.scale | head.finest << 2 | u8::from(head.has_intensity) << 4);
        push_varint(&mut keys, head.key - last);
        last = head.key;
    });
    raw.extend_from_slice(&keys);
    // As numbers, of which eight are compared at once.
    let observed = push_mask(raw, bytemuck::cast_slice_mut::<Voxel, u32>(&mut voxels));
    push_voxels(raw, &voxels[..observed]);
    let known = push_mask(raw, &mut intensities);
    raw.extend_from_slice(&intensities[..known]);
    (ids.len(), digest)
}

/// Appends a bit per value: whether it is anything but zero. Moves those that are to the front, in order, and returns their number.
pub(super) fn push_mask<T: Copy + Default + PartialEq>(out: &mut Vec<u8>, values: &mut [T]) -> usize {
    out.reserve(values.len().div_ceil(8));
    let mut kept = 0;
    for first in (0..values.len()).step_by(8) {
        let remaining = &values[first..];
        let eight: [T; 8] =
            remaining.first_chunk().copied().unwrap_or_else(|| std::array::from_fn(|i| remaining.get(i).copied().unwrap_or_default()));
        let mut is_set = [0; 8];
        for (bit, value) in is_set.iter_mut().zip(&eight) {
            *bit = u8::from(*value != T::default());
        }
        let mask = bits(is_set);
        out.push(mask);
        match mask {
            0 => {}
            u8::MAX => {
                values[kept..][..8].copy_from_slice(&eight);
                kept += 8;
            }
            // A branch for each value would be unpredictable.
            _ => {
                for (i, value) in eight.into_iter().enumerate().take(values.len() - first) {
                    values[kept] = value;
                    kept += usize::from(mask >> i & 1);
                }
            }
        }
    }
    kept
}

/// Bit i is byte i, which is 0 or 1: each factor's bit moves one of the bytes to its place in the highest byte, and no two meet on the way.
fn bits(bytes: [u8; 8]) -> u8 {
    (u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

fn push_voxels(out: &mut Vec<u8>, voxels: &[Voxel]) {
    let start = out.len();
    out.resize(start + 4 * voxels.len(), 0);
    let (distances, weights) = out[start..].split_at_mut(2 * voxels.len());
    let (low, high) = distances.split_at_mut(voxels.len());
    let mut last = 0i16;
    for ((voxel, low), high) in voxels.iter().zip(low).zip(high) {
        let step = voxel.distance.wrapping_sub(last);
        last = voxel.distance;
        [*low, *high] = (step << 1 ^ step >> 15).to_le_bytes();
    }
    let (low, high) = weights.split_at_mut(voxels.len());
    for ((voxel, low), high) in voxels.iter().zip(low).zip(high) {
        [*low, *high] = voxel.weight.to_le_bytes();
    }
}

/// The blocks of a page, unpacked.
#[derive(Debug)]
pub(super) struct Unpacked {
    heads: Vec<BlockHead>,
    voxels: Vec<Voxel>,
    intensities: Vec<u8>,
}

impl Unpacked {
    /// Makes weights of version 1 what they are now: upwards, so that what was observed stays so.
    pub fn update_weights(&mut self) {
        self.voxels.iter_mut().for_each(|voxel| voxel.weight = voxel.weight.div_ceil(64 / WEIGHT_ONE));
    }

    /// Adds the page's blocks to a field.
    pub fn build(&self, builder: &mut TsdfBuilder) -> Result<(), String> {
        let (mut voxels, mut intensities) = (&self.voxels[..], &self.intensities[..]);
        for head in &self.heads {
            let (array, rest) = voxels.split_at(head.voxel_count());
            let (intensity, other) = intensities.split_at(head.intensity_count());
            builder.push(*head, array, intensity).map_err(|e| e.to_string())?;
            (voxels, intensities) = (rest, other);
        }
        Ok(())
    }
}

/// Reads a page of `blocks` blocks; says in words what is wrong with it.
pub(super) fn parse(mut bytes: Bytes<'_>, blocks: usize) -> Result<Unpacked, String> {
    let heads = heads(&mut bytes, blocks)?;
    if heads.iter().map(cost).sum::<usize>() > LARGEST {
        return Err("a page holds more blocks than any may".to_owned());
    }
    let voxels = voxels(&mut bytes, heads.iter().map(BlockHead::voxel_count).sum())?;
    let intensities = intensities(&mut bytes, heads.iter().map(BlockHead::intensity_count).sum())?;
    bytes.end()?;
    Ok(Unpacked { heads, voxels, intensities })
}

fn heads(bytes: &mut Bytes<'_>, blocks: usize) -> Result<Vec<BlockHead>, String> {
    let flags = bytes.take(blocks)?;
    let mut key = 0u64;
    let head = |&flag: &u8| {
        key = key.checked_add(bytes.varint()?).ok_or("a block key is longer than 64 bits")?;
        if flag >> 5 != 0 {
            return Err(format!("block {key:#x} has unknown flags {flag:#x}"));
        }
        let head = BlockHead { key, scale: flag & 3, finest: flag >> 2 & 3, has_intensity: flag >> 4 & 1 == 1 };
        head.check().map_err(|e| e.to_string())?;
        Ok(head)
    };
    flags.iter().map(head).collect()
}

/// Takes the mask of `count` values and says how many of them are set.
pub(super) fn mask<'a>(bytes: &mut Bytes<'a>, count: usize) -> Result<(&'a [u8], usize), String> {
    let mask = bytes.take(count.div_ceil(8))?;
    let set = mask.iter().map(|b| b.count_ones() as usize).sum();
    let tail = mask.last().filter(|_| !count.is_multiple_of(8)).is_some_and(|b| b >> (count % 8) != 0);
    if tail { Err("a mask is longer than its values".to_owned()) } else { Ok((mask, set)) }
}

/// Calls `set` with the index of every bit that is set.
#[inline(always)]
pub(super) fn for_each_set(mask: &[u8], mut set: impl FnMut(usize)) {
    for (i, &byte) in mask.iter().enumerate() {
        let mut left = byte;
        while left != 0 {
            set(8 * i + left.trailing_zeros() as usize);
            left &= left - 1;
        }
    }
}

fn voxels(bytes: &mut Bytes<'_>, count: usize) -> Result<Vec<Voxel>, String> {
    let (mask, set) = mask(bytes, count)?;
    let mut plane = || bytes.take(set);
    let (distance_low, distance_high, weight_low, weight_high) = (plane()?, plane()?, plane()?, plane()?);
    let mut voxels = vec![Voxel::default(); count];
    let (mut at, mut distance) = (0, 0i16);
    for_each_set(mask, |i| {
        let folded = u16::from_le_bytes([distance_low[at], distance_high[at]]);
        distance = distance.wrapping_add((folded >> 1) as i16 ^ -((folded & 1) as i16));
        voxels[i] = Voxel { distance, weight: u16::from_le_bytes([weight_low[at], weight_high[at]]) };
        at += 1;
    });
    Ok(voxels)
}

fn intensities(bytes: &mut Bytes<'_>, count: usize) -> Result<Vec<u8>, String> {
    let (mask, set) = mask(bytes, count)?;
    let mut left = bytes.take(set)?.iter();
    let mut intensities = vec![0; count];
    for_each_set(mask, |i| intensities[i] = left.next().copied().unwrap_or_default());
    Ok(intensities)
}
