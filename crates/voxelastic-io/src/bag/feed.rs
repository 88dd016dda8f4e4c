//! Bytes of a recording in the order of the file, through compressed chunks as if they were not there.

use super::ahead::{Ahead, FindChunk};
use crate::{Error, Position, Result};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A chunk that claims to unpack to more than this many times its size is damaged or made to harm.
const LARGEST_RATIO: u64 = 4096;
/// No recorder writes chunks this large.
const LARGEST_CHUNK: u64 = 1 << 30;

/// How a chunk is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    Bzip2,
    Lz4,
    Zstd,
}

/// An unpacked chunk that is being read.
#[derive(Debug)]
struct Chunk {
    bytes: Vec<u8>,
    next: usize,
    /// Where the chunk lies in the file.
    at: u64,
}

/// A file read from front to end. What is asked for comes from the current chunk while there is one.
#[derive(Debug)]
pub(super) struct Feed {
    path: PathBuf,
    file: BufReader<File>,
    len: u64,
    next: u64,
    chunk: Option<Chunk>,
    /// End of the chunk that is read in place because it is not packed.
    in_place_until: u64,
    /// Whether the last error left the feed where reading can go on.
    sound: bool,
    /// Unpacks the chunks that follow.
    pub(super) ahead: Option<Box<Ahead>>,
}

impl Feed {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let fail = |e| Error::io(path, "read", e);
        let file = File::open(path).map_err(fail)?;
        let len = file.metadata().map_err(fail)?.len();
        let file = BufReader::with_capacity(1 << 18, file);
        Ok(Self { path: path.into(), file, len, next: 0, chunk: None, in_place_until: 0, sound: false, ahead: None })
    }

    /// Unpacks chunks ahead of their turn from now on.
    pub(super) fn look_ahead(&mut self, find: FindChunk) {
        self.ahead = Self::open(&self.path).ok().map(|scout| Box::new(Ahead::new(scout, find)));
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file, bytes.
    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// Where in the file the next byte is from: in a chunk, where the chunk begins.
    pub(super) fn position(&self) -> u64 {
        self.chunk.as_ref().map_or(self.next, |c| c.at)
    }

    /// Whether all has been read. Leaves a chunk that is used up.
    pub(super) fn at_end(&mut self) -> bool {
        if self.chunk.as_ref().is_some_and(|c| c.next >= c.bytes.len()) {
            self.chunk = None;
        }
        self.chunk.is_none() && self.next >= self.len
    }

    /// Bytes left in the chunk, or else in the file.
    fn left(&self) -> u64 {
        self.chunk.as_ref().map_or(self.len - self.next, |c| (c.bytes.len() - c.next) as u64)
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// When there are not that many: the file is truncated, or the count is damaged.
    pub(super) fn take(&mut self, count: u64) -> Result<Vec<u8>> {
        self.check(count)?;
        if let Some(chunk) = &mut self.chunk {
            let end = chunk.next + count as usize;
            let bytes = chunk.bytes[chunk.next..end].to_vec();
            chunk.next = end;
            return Ok(bytes);
        }
        let mut bytes = vec![0; count as usize];
        self.file.read_exact(&mut bytes).map_err(|e| Error::io(&self.path, "read", e))?;
        self.next += count;
        Ok(bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32> {
        Ok(self.take(4)?.first_chunk().map_or(0, |b| u32::from_le_bytes(*b)))
    }

    pub(super) fn u64(&mut self) -> Result<u64> {
        Ok(self.take(8)?.first_chunk().map_or(0, |b| u64::from_le_bytes(*b)))
    }

    /// Passes over `count` bytes.
    ///
    /// # Errors
    /// As [`take`](Self::take).
    pub(super) fn skip(&mut self, count: u64) -> Result<()> {
        self.check(count)?;
        if let Some(chunk) = &mut self.chunk {
            chunk.next += count as usize;
            return Ok(());
        }
        self.file.seek_relative(count as i64).map_err(|e| Error::io(&self.path, "read", e))?;
        self.next += count;
        Ok(())
    }

    /// Goes on at another place of the file.
    pub(super) fn seek(&mut self, to: u64) -> Result<()> {
        let to = to.min(self.len);
        self.chunk = None;
        self.file.seek(SeekFrom::Start(to)).map_err(|e| Error::io(&self.path, "read", e))?;
        self.next = to;
        Ok(())
    }

    /// After an error: goes on where that is possible, which is at the next record if the error was about a chunk's packing, else
    /// behind the chunk that holds the broken record, else nowhere.
    pub(super) fn recover(&mut self) {
        if std::mem::take(&mut self.sound) || self.chunk.take().is_some() {
            return;
        }
        let to = if self.in_place_until > self.next { self.in_place_until } else { self.len };
        if self.seek(to).is_err() {
            self.next = self.len;
        }
    }

    /// The next `count` bytes are a chunk that is not packed.
    pub(super) fn enter_in_place(&mut self, count: u64) {
        if self.chunk.is_none() {
            self.in_place_until = self.next.saturating_add(count).min(self.len);
        }
    }

    /// Says that the error to come leaves the feed at the next record.
    pub(super) fn is_sound(&mut self) {
        self.sound = true;
    }

    /// Unpacks a chunk that takes the next `packed` bytes; what is asked for next comes out of it. A chunk that is cut or damaged
    /// is read as far as it goes: the error comes back, and the feed goes on with what could be unpacked.
    pub(super) fn enter(&mut self, packing: Packing, packed: u64, unpacked: u64, crc: Option<u32>) -> Result<()> {
        let at = self.next;
        let held = packed.min(self.left());
        let ready = if self.chunk.is_none() { self.ahead.as_mut().and_then(|ahead| ahead.take(at, held)) } else { None };
        let bytes = if ready.is_some() { self.skip(held).map(|()| Vec::new())? } else { self.take(held)? };
        self.sound = true;
        let damaged = |problem: String| Error::content(&self.path, Position::Byte(at), problem, "copy or record the file again");
        if !is_plausible(packed, unpacked) {
            return Err(damaged(format!("a chunk of {packed} bytes claims to unpack to {unpacked}")));
        }
        let (bytes, failed) = ready.unwrap_or_else(|| unpack(packing, &bytes, unpacked));
        let complete = bytes.len() as u64 == unpacked && failed.is_none();
        let problem = if held < packed {
            Some("the file ends within a chunk".to_owned())
        } else if let Some(error) = failed {
            Some(format!("a chunk cannot be unpacked to its end: {error}"))
        } else if !complete {
            Some(format!("a chunk unpacks to {} bytes instead of {unpacked}", bytes.len()))
        } else if crc.is_some_and(|crc| crc != 0 && crc != crc32fast::hash(&bytes)) {
            return Err(damaged("the checksum of a chunk is wrong: the chunk is left out".into()));
        } else {
            None
        };
        let error = problem.map(damaged);
        self.sound = error.is_some();
        self.chunk = Some(Chunk { bytes, next: 0, at });
        error.map_or(Ok(()), Err)
    }

    fn check(&self, count: u64) -> Result<()> {
        if count <= self.left() {
            return Ok(());
        }
        let place = if self.chunk.is_some() { "chunk" } else { "file" };
        let problem = format!("a record of {count} bytes, but the {place} ends after {}", self.left());
        Err(Error::content(&self.path, Position::Byte(self.position()), problem, "the recording is cut or damaged here: record or copy it again"))
    }
}

/// Whether a chunk may unpack to as much as it claims.
pub(super) fn is_plausible(packed: u64, unpacked: u64) -> bool {
    unpacked <= LARGEST_CHUNK && unpacked <= LARGEST_RATIO.saturating_mul(packed.max(256))
}

/// Unpacks up to `size` bytes; what went wrong, if something did.
pub(super) fn unpack(packing: Packing, packed: &[u8], size: u64) -> (Vec<u8>, Option<std::io::Error>) {
    let mut bytes = Vec::new();
    let read = match packing {
        Packing::Bzip2 => bzip2::read::BzDecoder::new(packed).take(size).read_to_end(&mut bytes),
        Packing::Lz4 => lz4_flex::frame::FrameDecoder::new(packed).take(size).read_to_end(&mut bytes),
        Packing::Zstd => zstd::stream::read::Decoder::with_buffer(packed).and_then(|d| d.take(size).read_to_end(&mut bytes)),
    };
    (bytes, read.err())
}
