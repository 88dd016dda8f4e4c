//! The occupancy section of a submap file: the octree, then the voxels of the blocks that are not uniform.
//!
//! Level of the root (u32), key of its smallest block (u64), number of octants (u64), number of blocks (u64); then
//! [frames](super::frames) of octants in the order of [`OccupancyField::octants_in_order`] until all are there; then frames
//! of blocks in Morton order. A page of octants is four streams: a bit each whether something hangs below, a bit each
//! whether all below was observed, the values, the maxima. A page of blocks is one byte per block for its scale, then all
//! arrays end to end. All numbers little endian.

use super::bytes::Bytes;
use super::frames::{self, FULL, Frame, LARGEST, Section};
use crate::Result;
use rayon::prelude::*;
use std::io::{self, Write};
use voxelastic::field::occupancy::{OccupancyField, Summary};
use voxelastic::field::{OccupancyBuilder, OctantRecord};
use voxelastic::octree::{SCALES, voxels_at};
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

/// Bytes before the frames.
pub(crate) const HEAD: usize = 28;
/// Octants in a page.
const OCTANTS_PER_PAGE: usize = FULL / 4;

fn head(field: &OccupancyField, octants: usize) -> [u8; HEAD] {
    let mut head = [0; HEAD];
    head[..4].copy_from_slice(&field.tree().root_level().to_le_bytes());
    head[4..12].copy_from_slice(&field.tree().root_key().to_le_bytes());
    head[12..20].copy_from_slice(&(octants as u64).to_le_bytes());
    head[20..].copy_from_slice(&(field.len() as u64).to_le_bytes());
    head
}

/// A hash of everything that the section would hold.
pub(crate) fn digest(field: &OccupancyField) -> u64 {
    let (octants, ids) = (field.octants_in_order(), field.ids_in_morton_order());
    let of_octants: Vec<u64> = octants.par_chunks(OCTANTS_PER_PAGE).map(|octants| fill_octants(octants, &mut Vec::new()).1).collect();
    let of_blocks: Vec<u64> = cut(field, &ids).into_par_iter().map(|ids| digest_blocks(field, ids)).collect();
    digest_of(&head(field, octants.len()), &of_octants, &of_blocks)
}

/// The hash of a section from those of its pages.
fn digest_of(head: &[u8; HEAD], octants: &[u64], blocks: &[u64]) -> u64 {
    let mut all = head.to_vec();
    all.extend(octants.iter().chain(blocks).flat_map(|hash| hash.to_le_bytes()));
    xxh3_64(&all)
}

fn digest_blocks(field: &OccupancyField, ids: &[u32]) -> u64 {
    let mut hash = Xxh3::new();
    for block in ids.iter().map(|&id| field.block(id)) {
        hash.update(&[block.scale]);
        hash.update(bytemuck::cast_slice(field.values(block)));
    }
    hash.digest()
}

/// Cuts blocks into pages.
fn cut<'a>(field: &OccupancyField, ids: &'a [u32]) -> Vec<&'a [u32]> {
    let mut size = 0;
    let mut full = false;
    ids.chunk_by(|&id, _| {
        size = if full { 0 } else { size } + 1 + field.values(field.block(id)).len();
        full = size >= FULL;
        !full
    })
    .collect()
}

/// Writes the section of a field that is not empty and returns its [`digest`].
pub(crate) fn write(field: &OccupancyField, out: &mut (impl Write + Send)) -> io::Result<u64> {
    let (octants, ids) = (field.octants_in_order(), field.ids_in_morton_order());
    let head = head(field, octants.len());
    out.write_all(&head)?;
    let pages: Vec<&[OctantRecord]> = octants.chunks(OCTANTS_PER_PAGE).collect();
    let of_octants = frames::write(&pages, |octants, (), raw| fill_octants(octants, raw), out)?;
    let of_blocks = frames::write(&cut(field, &ids), |ids, (), raw| (fill_blocks(field, ids, raw), digest_blocks(field, ids)), out)?;
    Ok(digest_of(&head, &of_octants, &of_blocks))
}

/// Appends the page of `octants` to `raw`, which is empty; returns their number and a hash of the page.
fn fill_octants(octants: &[OctantRecord], raw: &mut Vec<u8>) -> (usize, u64) {
    let bits = |octants: &[OctantRecord], bit: fn(&OctantRecord) -> bool| octants.iter().rev().fold(0, |m, o| m << 1 | u8::from(bit(o)));
    raw.extend(octants.chunks(8).map(|c| bits(c, |o| o.linked)));
    raw.extend(octants.chunks(8).map(|c| bits(c, |o| o.summary.observed)));
    raw.extend(octants.iter().map(|o| o.summary.value as u8));
    raw.extend(octants.iter().map(|o| o.summary.max as u8));
    (octants.len(), xxh3_64(raw))
}

fn fill_blocks(field: &OccupancyField, ids: &[u32], raw: &mut Vec<u8>) -> usize {
    raw.extend(ids.iter().map(|&id| field.block(id).scale));
    ids.iter().for_each(|&id| raw.extend_from_slice(bytemuck::cast_slice(field.values(field.block(id)))));
    ids.len()
}

pub(crate) fn parse_octants(mut bytes: Bytes<'_>, count: usize) -> std::result::Result<Vec<OctantRecord>, String> {
    let [linked, observed] = [bytes.take(count.div_ceil(8))?, bytes.take(count.div_ceil(8))?];
    let [values, maxima] = [bytes.take(count)?, bytes.take(count)?];
    bytes.end()?;
    let bit = |mask: &[u8], i: usize| mask[i / 8] >> (i % 8) & 1 == 1;
    let octant = |i: usize| OctantRecord {
        linked: bit(linked, i),
        summary: Summary { value: values[i] as i8, max: maxima[i] as i8, observed: bit(observed, i) },
    };
    Ok((0..count).map(octant).collect())
}

/// Scale and array of each block of a page.
pub(crate) type Blocks = Vec<(u8, Vec<i8>)>;

pub(crate) fn parse_blocks(mut bytes: Bytes<'_>, count: usize) -> std::result::Result<Blocks, String> {
    let scales = bytes.take(count)?;
    let block = |&scale: &u8| {
        if usize::from(scale) >= SCALES {
            return Err(format!("a block has scale {scale}, but 3 is the largest"));
        }
        let values = bytes.take(voxels_at(usize::from(scale)))?;
        Ok((scale, bytemuck::cast_slice(values).to_vec()))
    };
    let blocks = scales.iter().map(block).collect::<std::result::Result<_, _>>()?;
    bytes.end()?;
    Ok(blocks)
}

/// Reads a section whose checksum is right.
pub(crate) fn read(section: &Section<'_>) -> Result<OccupancyField> {
    let (mut head, frames) = section.split(HEAD)?;
    let mut numbers = || Ok((head.u32()?, head.u64()?, head.u64()?, head.u64()?));
    let (level, key, octants, blocks) = numbers().map_err(|e: String| section.damaged(0, e))?;
    let mut missing = octants;
    let holds_octants = |frame: &&Frame<'_>| {
        let wanted = missing > 0;
        missing = missing.saturating_sub(frame.items as u64);
        wanted
    };
    let of_octants = frames.iter().take_while(holds_octants).count();
    let (octant_frames, block_frames) = frames.split_at(of_octants);

    let mut builder: Option<OccupancyBuilder> = None;
    frames::read(section, octant_frames, parse_octants, |page| {
        for octant in page {
            match &mut builder {
                None => builder = Some(OccupancyBuilder::new(key, level, octant).map_err(|e| e.to_string())?),
                Some(builder) => builder.push_octant(octant).map_err(|e| e.to_string())?,
            }
        }
        Ok(())
    })?;
    let mut builder = builder.ok_or_else(|| section.damaged(0, "it has no octants"))?;
    frames::read(section, block_frames, parse_blocks, |page: Blocks| {
        page.iter().try_for_each(|(scale, values)| builder.push_block(*scale, values).map_err(|e| e.to_string()))
    })?;
    let field = builder.finish().map_err(|e| section.damaged(0, e.to_string()))?;
    let found = (field.tree().octants() as u64, field.len() as u64);
    if found != (octants, blocks) {
        return Err(section.damaged(0, format!("{octants} octants and {blocks} blocks are claimed, {} and {} are there", found.0, found.1)));
    }
    Ok(field)
}

// A page of octants, and one of blocks with the last of them too many, stay below what a reader accepts.
const _: () = assert!(OCTANTS_PER_PAGE * 9 / 4 <= LARGEST && FULL + 1 + voxels_at(0) <= LARGEST);
