//! A page of a TSDF: some hundred blocks, as a sequence of streams (numbers little endian):
//!
//! 1. one byte per block: scale in bits 0-1, finest scale in bits 2-3, whether it has intensities in bit 4;
//! 2. the blocks' keys as differences to the key before (the first to 0), in base 128;
//! 3. a mask of each brick of all blocks' arrays: whether the voxel is anything but zero; eight bytes, one at scales 2 and 3;
//! 4. of these voxels the distances, each as the difference to the one before, signs folded into the lowest bit:
//!    all low bytes, then all high bytes;
//! 5. of these voxels the weights, in sixteenths of an observation: all low bytes, then all high bytes;
//! 6. a mask of each brick with intensities; then those that are anything but zero.
//!
//! On the hall at 5 cm three voxels of four are unobserved: leaving them out makes packing twice as fast, and splitting
//! bytes by their place makes the result a sixth smaller than packing the voxels as they lie in memory.

use super::bytes::{Bytes, push_varint};
use super::frames::{FULL, LARGEST};
use voxelastic::field::tsdf::{TsdfField, Voxel, WEIGHT_ONE};
use voxelastic::field::{BlockHead, PackedBlocks, full_mask};
use xxhash_rust::xxh3::xxh3_64;

// Files have weights in the field's unit: another unit is another version of the format.
const _: () = assert!(WEIGHT_ONE == 16);

/// Bytes that a block counts for: its arrays and more than its head takes.
fn cost(head: &BlockHead) -> usize {
    16 + head.voxel_count() * size_of::<Voxel>() + head.intensity_count()
}

/// Cuts blocks, in Morton order, into pages.
pub(crate) fn cut<'a>(field: &TsdfField, ids: &'a [u32]) -> Vec<&'a [u32]> {
    let mut size = 0;
    let mut full = false;
    ids.chunk_by(|&id, _| {
        size = if full { 0 } else { size } + cost(&field.head(id));
        full = size >= FULL;
        !full
    })
    .collect()
}

/// A hash of the page of the blocks `ids`.
pub(crate) fn digest(field: &TsdfField, ids: &[u32]) -> u64 {
    fill(field, ids, &mut PackedBlocks::default(), &mut Vec::new()).1
}

/// Appends the page of the blocks `ids`, which are packed into `packed`, to `raw`, which is empty; returns how many blocks it has, and its [`digest`].
pub(crate) fn fill(field: &TsdfField, ids: &[u32], packed: &mut PackedBlocks, raw: &mut Vec<u8>) -> (usize, u64) {
    field.pack(ids, packed);
    raw.extend(packed.heads.iter().map(|head| head.scale | head.finest << 2 | u8::from(head.has_intensity) << 4));
    let mut last = 0;
    for head in &packed.heads {
        push_varint(raw, head.key - last);
        last = head.key;
    }
    push_masks(raw, &packed.masks, packed.heads.iter().flat_map(BlockHead::brick_scales));
    push_voxels(raw, &packed.voxels);
    push_masks(raw, &packed.intensity_masks, packed.heads.iter().flat_map(BlockHead::intensity_brick_scales));
    raw.extend_from_slice(&packed.intensities);
    (ids.len(), xxh3_64(raw))
}

/// Bytes of the mask of a brick of an array at `scale`.
fn mask_bytes(scale: usize) -> usize {
    full_mask(scale).count_ones().div_ceil(8) as usize
}

fn push_masks(out: &mut Vec<u8>, masks: &[u64], scales: impl Iterator<Item = usize>) {
    out.reserve(size_of_val(masks));
    masks.iter().zip(scales).for_each(|(mask, scale)| out.extend_from_slice(&mask.to_le_bytes()[..mask_bytes(scale)]));
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

/// Reads a page of `blocks` blocks; says in words what is wrong with it.
pub(crate) fn parse(mut bytes: Bytes<'_>, blocks: usize) -> Result<PackedBlocks, String> {
    let heads = parse_heads(&mut bytes, blocks)?;
    if heads.iter().map(cost).sum::<usize>() > LARGEST {
        return Err("a page holds more blocks than any may".to_owned());
    }
    let (masks, count) = take_masks(&mut bytes, heads.iter().flat_map(BlockHead::brick_scales))?;
    let voxels = take_voxels(&mut bytes, count)?;
    let (intensity_masks, count) = take_masks(&mut bytes, heads.iter().flat_map(BlockHead::intensity_brick_scales))?;
    let intensities = bytes.take(count)?.to_vec();
    bytes.end()?;
    Ok(PackedBlocks { heads, masks, voxels, intensity_masks, intensities })
}

/// Takes the masks of bricks at `scales`, and says how many values they have.
fn take_masks(bytes: &mut Bytes<'_>, scales: impl Iterator<Item = usize>) -> Result<(Vec<u64>, usize), String> {
    let mut take = |scale: usize| {
        let mut mask = [0; size_of::<u64>()];
        let taken = bytes.take(mask_bytes(scale))?;
        mask[..taken.len()].copy_from_slice(taken);
        let mask = u64::from_le_bytes(mask);
        if mask & !full_mask(scale) == 0 { Ok(mask) } else { Err("a mask is longer than its values".to_owned()) }
    };
    let masks = scales.map(&mut take).collect::<Result<Vec<u64>, String>>()?;
    let count = masks.iter().map(|mask| mask.count_ones() as usize).sum();
    Ok((masks, count))
}

fn take_voxels(bytes: &mut Bytes<'_>, count: usize) -> Result<Vec<Voxel>, String> {
    let mut plane = || bytes.take(count);
    let (distance_low, distance_high, weight_low, weight_high) = (plane()?, plane()?, plane()?, plane()?);
    let mut distance = 0i16;
    let voxel = |i: usize| {
        let folded = u16::from_le_bytes([distance_low[i], distance_high[i]]);
        distance = distance.wrapping_add((folded >> 1) as i16 ^ -((folded & 1) as i16));
        Voxel { distance, weight: u16::from_le_bytes([weight_low[i], weight_high[i]]) }
    };
    Ok((0..count).map(voxel).collect())
}

fn parse_heads(bytes: &mut Bytes<'_>, blocks: usize) -> Result<Vec<BlockHead>, String> {
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
