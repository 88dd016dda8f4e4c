//! The colour section of a submap file: the number of blocks (u64), then [frames](super::frames) of the blocks of the TSDF that have
//! colours, in Morton order. It follows the TSDF's section; submaps without colours have none.
//!
//! A page is a sequence of streams (numbers little endian):
//!
//! 1. one byte per block: the scale of its colours;
//! 2. the blocks' keys as differences to the key before (the first to 0), in base 128;
//! 3. a bit per voxel of all blocks' arrays, end to end, least bit first: whether its colour is known;
//! 4. of these voxels all reds, then all greens, blues, and numbers of observations.

use super::bytes::{Bytes, push_varint};
use super::frames::{self, FULL, LARGEST, Section};
use super::masks::{for_each_set, mask, push_mask};
use crate::Result;
use std::io::{self, Write};
use voxelastic::field::tsdf::{ColourVoxel, TsdfField};
use voxelastic::octree::{SCALES, voxels_at};
use xxhash_rust::xxh3::Xxh3;

/// Bytes before the frames.
pub(crate) const HEAD: usize = 8;

/// Blocks with colours, in Morton order.
pub(crate) fn coloured(field: &TsdfField) -> Vec<u32> {
    field.ids_in_morton_order().into_iter().filter(|&id| field.colours().block(id).is_some()).collect()
}

/// Scale and colours of each of `ids`, with its key.
fn blocks<'a>(field: &'a TsdfField, ids: &'a [u32]) -> impl Iterator<Item = (u64, usize, &'a [ColourVoxel])> {
    ids.iter().filter_map(|&id| field.colours().block(id).map(|(scale, colours)| (field.block(id).key, scale, colours)))
}

/// A hash of everything that the section would hold.
pub(crate) fn digest(field: &TsdfField) -> u64 {
    let mut hash = Xxh3::new();
    for (key, scale, colours) in blocks(field, &coloured(field)) {
        hash.update(&key.to_le_bytes());
        hash.update(&[scale as u8]);
        hash.update(bytemuck::cast_slice(colours));
    }
    hash.digest()
}

/// Bytes that a block's colours count for.
fn cost(scale: usize) -> usize {
    16 + voxels_at(scale) * size_of::<ColourVoxel>()
}

/// Cuts blocks into pages.
fn cut<'a>(field: &TsdfField, ids: &'a [u32]) -> Vec<&'a [u32]> {
    let mut size = 0;
    let mut full = false;
    ids.chunk_by(|&id, _| {
        size = if full { 0 } else { size } + field.colours().block(id).map_or(0, |(scale, _)| cost(scale));
        full = size >= FULL;
        !full
    })
    .collect()
}

/// Writes the section and returns its [`digest`], which is one of all pages.
pub(crate) fn write(field: &TsdfField, out: &mut (impl Write + Send)) -> io::Result<u64> {
    let ids = coloured(field);
    out.write_all(&(ids.len() as u64).to_le_bytes())?;
    frames::write(&cut(field, &ids), |ids, (), raw| (fill(field, ids, raw), 0), out)?;
    Ok(digest(field))
}

/// Appends the page of the blocks `ids` to `raw` and returns how many blocks it has.
pub(crate) fn fill(field: &TsdfField, ids: &[u32], raw: &mut Vec<u8>) -> usize {
    let (mut colours, mut keys) = (Vec::new(), Vec::with_capacity(2 * ids.len()));
    let mut last = 0;
    for (key, scale, array) in blocks(field, ids) {
        raw.push(scale as u8);
        push_varint(&mut keys, key - last);
        last = key;
        colours.extend_from_slice(array);
    }
    raw.extend_from_slice(&keys);
    let known = push_mask(raw, &mut colours);
    colours.truncate(known);
    for k in 0..3 {
        raw.extend(colours.iter().map(|t| t.rgb[k]));
    }
    raw.extend(colours.iter().map(|t| t.observations));
    ids.len()
}

/// The blocks of a page, unpacked: keys, scales, and all arrays end to end.
pub(crate) struct Page {
    heads: Vec<(u64, u8)>,
    colours: Vec<ColourVoxel>,
}

impl Page {
    /// Sets the colours of the blocks of `field`; returns their number.
    pub fn add_to(&self, field: &mut TsdfField) -> std::result::Result<usize, String> {
        let mut colours = &self.colours[..];
        for &(key, scale) in &self.heads {
            let (array, rest) = colours.split_at(voxels_at(scale.into()));
            field.set_colours(key, scale, array).map_err(|e| e.to_string())?;
            colours = rest;
        }
        Ok(self.heads.len())
    }
}

/// Reads a page of `blocks` blocks; the error says what is wrong with it.
pub(crate) fn parse(mut bytes: Bytes<'_>, blocks: usize) -> std::result::Result<Page, String> {
    let scales = bytes.take(blocks)?;
    if let Some(scale) = scales.iter().find(|s| usize::from(**s) >= SCALES) {
        return Err(format!("colours are of scale {scale}"));
    }
    if scales.iter().map(|s| cost((*s).into())).sum::<usize>() > LARGEST {
        return Err("a page holds more blocks than any may".to_owned());
    }
    let mut key = 0u64;
    let mut heads = Vec::with_capacity(blocks);
    for &scale in scales {
        key = key.checked_add(bytes.varint()?).ok_or("a block key is longer than 64 bits")?;
        heads.push((key, scale));
    }
    let mut colours = vec![ColourVoxel::default(); scales.iter().map(|s| voxels_at((*s).into())).sum()];
    let (known, count) = mask(&mut bytes, colours.len())?;
    let mut plane = || bytes.take(count);
    let (red, green, blue, seen) = (plane()?, plane()?, plane()?, plane()?);
    let mut at = 0;
    for_each_set(known, |i| {
        colours[i] = ColourVoxel { rgb: [red[at], green[at], blue[at]], observations: seen[at] };
        at += 1;
    });
    bytes.end()?;
    Ok(Page { heads, colours })
}

/// Reads a section whose checksum is right into the field whose distances were read before.
pub(crate) fn read(section: &Section<'_>, field: &mut TsdfField) -> Result<()> {
    let (mut head, frames) = section.split(HEAD)?;
    let claimed = head.u64().map_err(|e| section.damaged(0, e))?;
    let mut blocks = 0;
    frames::read(section, &frames, parse, |page: Page| page.add_to(field).map(|count| blocks += count))?;
    if blocks as u64 == claimed { Ok(()) } else { Err(section.damaged(0, format!("{claimed} blocks are claimed, {blocks} are there"))) }
}
