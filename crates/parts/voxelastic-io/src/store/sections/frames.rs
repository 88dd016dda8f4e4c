//! Frames: the pages of a section, each packed on its own, so that they are packed and unpacked in parallel.
//!
//! A section starts with a head of its own; frames follow to its end: length packed (u32), length unpacked (u32), items
//! in it (u32), CRC-32 of the packed bytes (u32), the packed bytes (one zstd frame). All numbers little endian.

use super::bytes::Bytes;
use crate::{Error, Result};
use rayon::prelude::*;
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use zstd::bulk::{Compressor, Decompressor};

/// Bytes before the packed bytes of a frame.
const FRAME_HEAD: usize = 16;
/// Size of a page, unpacked, at which the next begins.
pub(crate) const FULL: usize = 1 << 20;
/// Most bytes that a page takes: it may pass [`FULL`] by its last item, and keep tables of its items.
pub(crate) const LARGEST: usize = 2 * FULL;
/// zstd level: 3 is half as fast and saves 2 %.
const LEVEL: i32 = 1;

/// Pages that are in memory twice at once, packed and unpacked: enough to keep all threads busy.
fn batch() -> usize {
    4 * rayon::current_num_threads()
}

/// A packed page.
struct Packed {
    items: u32,
    raw: u32,
    digest: u64,
    bytes: Vec<u8>,
}

/// What it takes to pack a page: large enough that pages share it.
struct Packer<S> {
    compressor: Compressor<'static>,
    raw: Vec<u8>,
    scratch: S,
}

/// Packers or decompressors that are not in use. Making one takes as long as a page.
struct Spare<T>(Mutex<Vec<T>>);

impl<T> Spare<T> {
    fn lock(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lends one to `with`; makes one if all are in use.
    fn lend<R>(&self, make: impl FnOnce() -> io::Result<T>, with: impl FnOnce(&mut T) -> R) -> io::Result<R> {
        let spare = self.lock().pop();
        let mut item = spare.map_or_else(make, Ok)?;
        let result = with(&mut item);
        self.lock().push(item);
        Ok(result)
    }
}

/// Writes a frame for each of `pages`, which `fill` turns into bytes, a number of items and a hash, with memory that it may use; returns the hashes.
/// Pages are packed in parallel while those before are written.
pub(crate) fn write<P: Sync, S: Default + Send>(
    pages: &[P],
    fill: impl Fn(&P, &mut S, &mut Vec<u8>) -> (usize, u64) + Sync,
    out: &mut (impl Write + Send),
) -> io::Result<Vec<u64>> {
    let spare: Spare<Packer<S>> = Spare(Mutex::default());
    let start = || Ok(Packer { compressor: Compressor::new(LEVEL)?, raw: Vec::new(), scratch: S::default() });
    let pack = |page: &P| {
        spare.lend(start, |Packer { compressor, raw, scratch }| {
            raw.clear();
            let (items, digest) = fill(page, scratch, raw);
            debug_assert!(raw.len() <= LARGEST);
            let bytes = compressor.compress(raw)?;
            Ok(Packed { items: items as u32, raw: raw.len() as u32, digest, bytes })
        })?
    };
    let pack_all = |pages: &[P]| pages.par_iter().map(pack).collect::<io::Result<Vec<Packed>>>();
    let mut packed: Vec<Packed> = Vec::new();
    let mut digests = Vec::with_capacity(pages.len());
    for pages in pages.chunks(batch()) {
        let (written, next) = rayon::join(|| write_packed(&packed, out), || pack_all(pages));
        written?;
        packed = next?;
        digests.extend(packed.iter().map(|page| page.digest));
    }
    write_packed(&packed, out)?;
    Ok(digests)
}

fn write_packed(pages: &[Packed], out: &mut impl Write) -> io::Result<()> {
    for page in pages {
        for number in [page.bytes.len() as u32, page.raw, page.items, crc32fast::hash(&page.bytes)] {
            out.write_all(&number.to_le_bytes())?;
        }
        out.write_all(&page.bytes)?;
    }
    Ok(())
}

/// A section of a file that was read.
#[derive(Clone, Copy)]
pub(crate) struct Section<'a> {
    pub path: &'a Path,
    /// The section in words.
    pub name: &'static str,
    /// Where it starts in the file.
    pub offset: u64,
    pub bytes: &'a [u8],
}

impl<'a> Section<'a> {
    /// Damage noticed at `at` of the section.
    pub fn damaged(&self, at: usize, what: impl Into<String>) -> Error {
        Error::damaged(self.path, self.name, self.offset + at as u64, what)
    }

    /// The section's own head of `length` bytes, and its frames.
    pub fn split(&self, length: usize) -> Result<(Bytes<'a>, Vec<Frame<'a>>)> {
        let mut bytes = Bytes::new(self.bytes);
        let head = bytes.take(length).map_err(|e| self.damaged(0, e))?;
        let mut frames = Vec::new();
        let mut at = length;
        while at < self.bytes.len() {
            let mut frame = || {
                let [packed, raw, items, crc32] = [bytes.u32()?, bytes.u32()?, bytes.u32()?, bytes.u32()?];
                Ok(Frame { at, raw: raw as usize, items: items as usize, crc32, packed: bytes.take(packed as usize)? })
            };
            let frame = frame().map_err(|e: String| self.damaged(at, e))?;
            at += FRAME_HEAD + frame.packed.len();
            frames.push(frame);
        }
        Ok((Bytes::new(head), frames))
    }

    /// Finds the place of damage in a section whose checksum is wrong and whose own head has `length` bytes.
    pub fn find_damage(&self, length: usize) -> Error {
        let frames = match self.split(length) {
            Ok((_, frames)) => frames,
            Err(error) => return error,
        };
        match frames.iter().position(|frame| crc32fast::hash(frame.packed) != frame.crc32) {
            Some(i) => self.damaged(frames[i].at, format!("page {i} does not match its checksum")),
            None => self.damaged(0, "the section does not match its checksum"),
        }
    }
}

/// A page as it lies in a section.
#[derive(Clone, Copy)]
pub(crate) struct Frame<'a> {
    /// Where its head starts in the section.
    pub at: usize,
    raw: usize,
    /// What it holds, counted.
    pub items: usize,
    crc32: u32,
    packed: &'a [u8],
}

/// Unpacks `frames` of `section`, turns each into something by `parse` and hands it to `take` in order. Pages are
/// unpacked in parallel while those before are taken. What `parse` and `take` say in words becomes damage at the page.
pub(crate) fn read<T: Send>(
    section: &Section<'_>,
    frames: &[Frame<'_>],
    parse: impl Fn(Bytes<'_>, usize) -> std::result::Result<T, String> + Sync,
    mut take: impl FnMut(T) -> std::result::Result<(), String> + Send,
) -> Result<()> {
    let spare: Spare<Decompressor<'static>> = Spare(Mutex::default());
    let unpack = |frame: &Frame<'_>| {
        let damaged = |e: String| section.damaged(frame.at, e);
        let raw = spare.lend(Decompressor::new, |decompressor| decompress(decompressor, frame));
        let raw = raw.map_err(Error::on_io("decompress", section.path))?.map_err(damaged)?;
        Ok((frame.at, parse(Bytes::new(&raw), frame.items).map_err(damaged)?))
    };
    let unpack_all = |frames: &[Frame<'_>]| -> Result<Vec<(usize, T)>> {
        // Collected in order first: of several errors the first in the file is reported, whatever the threads do.
        let parts: Vec<Result<(usize, T)>> = frames.par_iter().map(unpack).collect();
        parts.into_iter().collect()
    };
    let mut take_all = |parts: Vec<(usize, T)>| parts.into_iter().try_for_each(|(at, part)| take(part).map_err(|e| section.damaged(at, e)));
    let mut unpacked = Vec::new();
    for frames in frames.chunks(batch()) {
        let before = std::mem::take(&mut unpacked);
        let (taken, next) = rayon::join(|| take_all(before), || unpack_all(frames));
        taken?;
        unpacked = next?;
    }
    take_all(unpacked)
}

fn decompress(decompressor: &mut Decompressor<'_>, frame: &Frame<'_>) -> std::result::Result<Vec<u8>, String> {
    let (length, items) = (frame.raw, frame.items);
    if length > LARGEST || items > length {
        return Err(format!("a page claims {length} bytes with {items} items"));
    }
    let raw = decompressor.decompress(frame.packed, length).map_err(|e| format!("a page does not decompress ({e})"))?;
    if raw.len() == length { Ok(raw) } else { Err(format!("a page has {} bytes instead of {length}", raw.len())) }
}
