//! The TSDF section of a submap file: the number of blocks (u64), then [frames](super::frames) of blocks in Morton order.

use super::frames::{self, Section};
use super::tsdf_page::{self, cut, fill, parse};
use crate::Result;
use rayon::prelude::*;
use std::io::{self, Write};
use voxelastic::field::tsdf::TsdfField;
use voxelastic::field::{PackedBlocks, TsdfBuilder};
use xxhash_rust::xxh3::xxh3_64;

/// Bytes before the frames.
pub(crate) const HEAD: usize = 8;

/// A hash of everything that the section would hold. Equal fields have equal hashes on every machine of one endianness.
pub(crate) fn digest(field: &TsdfField) -> u64 {
    let ids = field.ids_in_morton_order();
    let of_pages: Vec<u64> = cut(field, &ids).into_par_iter().map(|page| tsdf_page::digest(field, page)).collect();
    digest_of(&of_pages)
}

/// The hash of a section from those of its pages.
fn digest_of(pages: &[u64]) -> u64 {
    xxh3_64(&pages.iter().flat_map(|hash| hash.to_le_bytes()).collect::<Vec<u8>>())
}

/// Writes the section and returns its [`digest`].
pub(crate) fn write(field: &TsdfField, out: &mut (impl Write + Send)) -> io::Result<u64> {
    out.write_all(&(field.len() as u64).to_le_bytes())?;
    let ids = field.ids_in_morton_order();
    let of_pages = frames::write(&cut(field, &ids), |ids, packed, raw| fill(field, ids, packed, raw), out)?;
    Ok(digest_of(&of_pages))
}

/// Reads a section whose checksum is right.
pub(crate) fn read(section: &Section<'_>) -> Result<TsdfField> {
    let (mut head, frames) = section.split(HEAD)?;
    let blocks = head.u64().map_err(|e| section.damaged(0, e))?;
    let mut builder = TsdfBuilder::default();
    frames::read(section, &frames, parse, |page: PackedBlocks| builder.push_packed(&page).map_err(|e| e.to_string()))?;
    let field = builder.finish();
    if field.len() as u64 != blocks {
        return Err(section.damaged(0, format!("{blocks} blocks are claimed, {} are there", field.len())));
    }
    Ok(field)
}
