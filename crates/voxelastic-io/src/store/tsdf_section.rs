//! The TSDF section of a submap file: pages of blocks in Morton order.
//!
//! The number of blocks (u64), then pages end to end: length packed (u32), length unpacked (u32), blocks (u32), CRC-32 of
//! the packed bytes (u32), the packed bytes: one zstd frame, see [`page`](super::page). All numbers little endian.

use super::bytes::Bytes;
use super::error::{Result, StoreError};
use super::page::{Packed, Packer, Unpacked, Unpacker, cut};
use rayon::prelude::*;
use std::io::{self, Write};
use std::path::Path;
use voxelastic::field::TsdfBuilder;
use voxelastic::field::tsdf::TsdfField;
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

/// Bytes before the packed bytes of a page.
const PAGE_HEAD: usize = 16;

/// Pages that are in memory twice at once, packed and unpacked: enough to keep all threads busy.
fn batch() -> usize {
    4 * rayon::current_num_threads()
}

/// A hash of everything that the section would hold. Equal fields have equal hashes on every machine of one endianness.
pub(super) fn digest(field: &TsdfField) -> u64 {
    let ids = field.ids_in_morton_order();
    let of_pages: Vec<u8> = cut(field, &ids).into_par_iter().flat_map_iter(|page| digest_page(field, page).to_le_bytes()).collect();
    xxh3_64(&of_pages)
}

fn digest_page(field: &TsdfField, ids: &[u32]) -> u64 {
    let mut hash = Xxh3::new();
    for &id in ids {
        let head = field.head(id);
        hash.update(&head.key.to_le_bytes());
        hash.update(&[head.scale, head.finest, u8::from(head.shaded)]);
        field.stored_voxels(id).for_each(|array| hash.update(bytemuck::cast_slice(array)));
        field.stored_shades(id).for_each(|array| hash.update(array));
    }
    hash.digest()
}

/// Writes the section. Pages are packed in parallel while those before are written.
pub(super) fn write(field: &TsdfField, out: &mut (impl Write + Send)) -> io::Result<()> {
    out.write_all(&(field.len() as u64).to_le_bytes())?;
    let ids = field.ids_in_morton_order();
    let mut packed: Vec<Packed> = Vec::new();
    for pages in cut(field, &ids).chunks(batch()) {
        let (written, next) = rayon::join(|| write_pages(&packed, out), || pack(field, pages));
        written?;
        packed = next?;
    }
    write_pages(&packed, out)
}

fn pack(field: &TsdfField, pages: &[&[u32]]) -> io::Result<Vec<Packed>> {
    pages.par_iter().map_init(Packer::new, |packer, ids| packer.as_mut().map_err(copy)?.pack(field, ids)).collect()
}

/// An I/O error like `error`, which several pages may have to report.
fn copy(error: &mut io::Error) -> io::Error {
    io::Error::new(error.kind(), error.to_string())
}

fn write_pages(pages: &[Packed], out: &mut impl Write) -> io::Result<()> {
    for page in pages {
        for number in [page.bytes.len() as u32, page.raw, page.blocks, crc32fast::hash(&page.bytes)] {
            out.write_all(&number.to_le_bytes())?;
        }
        out.write_all(&page.bytes)?;
    }
    Ok(())
}

/// A section in a file that was read, for naming places in it.
#[derive(Clone, Copy)]
pub(super) struct Section<'a> {
    pub path: &'a Path,
    /// Where the section starts in the file.
    pub offset: u64,
    pub bytes: &'a [u8],
}

impl Section<'_> {
    /// Damage noticed at `at` of the section.
    fn damaged(&self, at: usize, what: impl Into<String>) -> StoreError {
        StoreError::damaged(self.path, "tsdf section", self.offset + at as u64, what)
    }
}

/// A page as it lies in the section.
struct Page<'a> {
    /// Where its head starts in the section.
    at: usize,
    raw: usize,
    blocks: usize,
    crc32: u32,
    packed: &'a [u8],
}

/// The number of blocks and the pages of a section.
fn pages<'a>(section: &Section<'a>) -> Result<(u64, Vec<Page<'a>>)> {
    let mut bytes = Bytes::new(section.bytes);
    let blocks = bytes.u64().map_err(|e| section.damaged(0, e))?;
    let mut pages = Vec::new();
    let mut at = size_of::<u64>();
    while at < section.bytes.len() {
        let mut page = || {
            let [packed, raw, blocks, crc32] = [bytes.u32()?, bytes.u32()?, bytes.u32()?, bytes.u32()?];
            Ok(Page { at, raw: raw as usize, blocks: blocks as usize, crc32, packed: bytes.take(packed as usize)? })
        };
        let page = page().map_err(|e: String| section.damaged(at, e))?;
        at += PAGE_HEAD + page.packed.len();
        pages.push(page);
    }
    Ok((blocks, pages))
}

/// Finds the place of damage in a section whose checksum is wrong.
pub(super) fn find_damage(section: &Section<'_>) -> StoreError {
    let whole = |(_, pages): (u64, Vec<Page<'_>>)| match pages.iter().position(|page| crc32fast::hash(page.packed) != page.crc32) {
        Some(i) => section.damaged(pages[i].at, format!("page {i} does not match its checksum")),
        None => section.damaged(0, "the section does not match its checksum"),
    };
    pages(section).map_or_else(|e| e, whole)
}

/// Reads a section whose checksum is right. Pages are unpacked in parallel while those before are put into the field.
pub(super) fn read(section: &Section<'_>) -> Result<TsdfField> {
    let (blocks, pages) = pages(section)?;
    let mut builder = TsdfBuilder::default();
    let mut unpacked: Vec<(usize, Unpacked)> = Vec::new();
    for pages in pages.chunks(batch()) {
        let (built, next) = rayon::join(|| build(section, &unpacked, &mut builder), || unpack(section, pages));
        built?;
        unpacked = next?;
    }
    build(section, &unpacked, &mut builder)?;
    let field = builder.finish();
    if field.len() as u64 != blocks {
        return Err(section.damaged(0, format!("{blocks} blocks are claimed, {} are there", field.len())));
    }
    Ok(field)
}

fn unpack(section: &Section<'_>, pages: &[Page<'_>]) -> Result<Vec<(usize, Unpacked)>> {
    let unpack = |unpacker: &mut io::Result<Unpacker>, page: &Page<'_>| {
        let unpacker = unpacker.as_mut().map_err(|e| StoreError::io("decompress", section.path)(copy(e)))?;
        let unpacked = unpacker.unpack(page.packed, page.raw, page.blocks).map_err(|e| section.damaged(page.at, e))?;
        Ok((page.at, unpacked))
    };
    // Collected in order first: of several errors the first in the file is reported, whatever the threads do.
    pages.par_iter().map_init(Unpacker::new, unpack).collect::<Vec<_>>().into_iter().collect()
}

fn build(section: &Section<'_>, pages: &[(usize, Unpacked)], builder: &mut TsdfBuilder) -> Result<()> {
    pages.iter().try_for_each(|(at, page)| page.build(builder).map_err(|e| section.damaged(*at, e)))
}
