//! Sequential reading of a recording, with compressed chunks decompressed transparently.

use super::chunk::{ChunkCache, Compression, decompress};
use crate::{Error, Position, Result, unpacking};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A decompressed chunk that is being read.
#[derive(Debug)]
struct Chunk {
    bytes: Vec<u8>,
    next: usize,
    /// Offset of the chunk in the file.
    at: u64,
}

/// Reads a file from front to back; inside a chunk, reads from the chunk.
#[derive(Debug)]
pub(crate) struct ChunkReader {
    path: PathBuf,
    file: BufReader<File>,
    len: u64,
    next: u64,
    chunk: Option<Chunk>,
    /// End of the uncompressed chunk that is read in place.
    in_place_until: u64,
    /// Whether reading can continue at the current position after the last error.
    can_continue: bool,
    /// Chunks decompressed ahead.
    pub(crate) cache: Option<Box<dyn ChunkCache>>,
}

impl ChunkReader {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let fail = |e| Error::io(path, "read", e);
        voxelastic_files::note_read(path);
        let file = voxelastic_files::patiently(|| File::open(path)).map_err(fail)?;
        let len = file.metadata().map_err(fail)?.len();
        let file = BufReader::with_capacity(1 << 18, file);
        Ok(Self { path: path.into(), file, len, next: 0, chunk: None, in_place_until: 0, can_continue: false, cache: None })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file, bytes.
    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    /// Offset of the next byte in the file; inside a chunk, the offset of the chunk.
    pub(crate) fn position(&self) -> u64 {
        self.chunk.as_ref().map_or(self.next, |c| c.at)
    }

    /// Whether everything has been read. Leaves a chunk that is exhausted.
    pub(crate) fn at_end(&mut self) -> bool {
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
    pub(crate) fn take(&mut self, count: u64) -> Result<Vec<u8>> {
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

    pub(crate) fn u32(&mut self) -> Result<u32> {
        Ok(self.take(4)?.first_chunk().map_or(0, |b| u32::from_le_bytes(*b)))
    }

    pub(crate) fn u64(&mut self) -> Result<u64> {
        Ok(self.take(8)?.first_chunk().map_or(0, |b| u64::from_le_bytes(*b)))
    }

    /// Skips `count` bytes.
    ///
    /// # Errors
    /// As [`take`](Self::take).
    pub(crate) fn skip(&mut self, count: u64) -> Result<()> {
        self.check(count)?;
        if let Some(chunk) = &mut self.chunk {
            chunk.next += count as usize;
            return Ok(());
        }
        self.file.seek_relative(count as i64).map_err(|e| Error::io(&self.path, "read", e))?;
        self.next += count;
        Ok(())
    }

    /// Continues at another offset of the file.
    pub(crate) fn seek(&mut self, to: u64) -> Result<()> {
        let to = to.min(self.len);
        self.chunk = None;
        self.file.seek(SeekFrom::Start(to)).map_err(|e| Error::io(&self.path, "read", e))?;
        self.next = to;
        Ok(())
    }

    /// Continues after an error: at the current position if [`mark_recoverable`](Self::mark_recoverable) was called, else after the chunk
    /// that holds the damaged record, else at the end of the file.
    pub(crate) fn recover(&mut self) {
        if std::mem::take(&mut self.can_continue) || self.chunk.take().is_some() {
            return;
        }
        let to = if self.in_place_until > self.next { self.in_place_until } else { self.len };
        if self.seek(to).is_err() {
            self.next = self.len;
        }
    }

    /// Notes that the next `count` bytes are an uncompressed chunk.
    pub(crate) fn enter_in_place(&mut self, count: u64) {
        if self.chunk.is_none() {
            self.in_place_until = self.next.saturating_add(count).min(self.len);
        }
    }

    /// Notes that after the error about to be returned, the reader is at the next record.
    pub(crate) fn mark_recoverable(&mut self) {
        self.can_continue = true;
    }

    /// Decompresses the chunk in the next `compressed` bytes and continues inside it. A truncated or damaged chunk is read as far as it goes:
    /// the error is returned, and the reader continues with what could be decompressed.
    pub(crate) fn enter(&mut self, compression: Compression, compressed: u64, size: u64, crc: Option<u32>) -> Result<()> {
        let at = self.next;
        let held = compressed.min(self.left());
        let ready = if self.chunk.is_none() { self.cache.as_mut().and_then(|cache| cache.take(at, held)) } else { None };
        let bytes = if ready.is_some() { self.skip(held).map(|()| Vec::new())? } else { self.take(held)? };
        self.can_continue = true;
        let damaged = |problem: String| Error::content(&self.path, Position::Byte(at), problem, "copy or record the file again");
        if size > unpacking::limit(compressed) {
            return Err(damaged(format!("a chunk of {compressed} bytes claims to decompress to {size}")));
        }
        let (bytes, failed) = ready.unwrap_or_else(|| decompress(compression, &bytes, size));
        let complete = bytes.len() as u64 == size && failed.is_none();
        let problem = if held < compressed {
            Some("the file ends within a chunk".to_owned())
        } else if let Some(error) = failed {
            Some(format!("a chunk cannot be decompressed to its end: {error}"))
        } else if !complete {
            Some(format!("a chunk decompresses to {} bytes instead of {size}", bytes.len()))
        } else if crc.is_some_and(|crc| crc != 0 && crc != crc32fast::hash(&bytes)) {
            return Err(damaged("the checksum of a chunk is wrong: the chunk is skipped".into()));
        } else {
            None
        };
        let error = problem.map(damaged);
        self.can_continue = error.is_some();
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
