//! The journal of a run: what came, record by record, appended to as the run goes on.
//!
//! Magic (8 bytes), then for each record its length (u32), the CRC-32 of length and content (u32), and the content, little endian. A checkpoint
//! says how much of it is valid: what is behind was written by a process that died before its checkpoint was complete, and is cut off.

use super::files;
use crate::{Error, Result};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use voxelastic_files::failpoint::{self, Writes};

const MAGIC: [u8; 8] = *b"\x89VXJNL\r\n";
/// Bytes before the content of a record.
const HEAD: usize = 8;

/// The journal of the run that is under way.
#[derive(Debug)]
pub(super) struct Journal {
    path: PathBuf,
    /// Bytes that are durable and belong to the last checkpoint.
    length: u64,
    /// Records that came since, as they are to be written.
    pending: Vec<u8>,
}

impl Journal {
    /// An empty journal, of which nothing is written yet.
    pub fn new(path: PathBuf) -> Self {
        Self { path, length: 0, pending: MAGIC.to_vec() }
    }

    /// The first `length` bytes of the journal at `path`, and its records.
    pub fn open(path: PathBuf, length: u64) -> Result<(Self, Vec<Vec<u8>>)> {
        if length == 0 {
            return Ok((Self::new(path), Vec::new()));
        }
        let bytes = files::read(&path, None)?;
        let damaged = |at: usize, what: &str| Error::damaged(&path, "record", at as u64, what);
        let length_here = usize::try_from(length).unwrap_or(usize::MAX);
        let bytes = bytes.get(..length_here).ok_or_else(|| damaged(bytes.len(), "it ends before what the checkpoint says"))?;
        let mut rest = bytes.strip_prefix(&MAGIC).ok_or_else(|| damaged(0, "it does not start like a journal"))?;
        let mut records = Vec::new();
        while !rest.is_empty() {
            let at = bytes.len() - rest.len();
            let (record, others) = split_record(rest).ok_or_else(|| damaged(at, "its bytes do not match their checksum"))?;
            records.push(record.to_vec());
            rest = others;
        }
        Ok((Self { path, length, pending: Vec::new() }, records))
    }

    /// Name of the file, in its folder.
    pub fn name(&self) -> &str {
        self.path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
    }

    /// Bytes of the journal once what is pending is written.
    pub fn length(&self) -> u64 {
        if self.has_records() { self.length + self.pending.len() as u64 } else { 0 }
    }

    fn has_records(&self) -> bool {
        self.length > 0 || self.pending.len() > MAGIC.len()
    }

    /// Adds a record, to be written by the next [`write`](Self::write).
    pub fn add(&mut self, record: &[u8]) {
        let length = (record.len() as u32).to_le_bytes();
        self.pending.extend(length);
        self.pending.extend(checksum(length, record).to_le_bytes());
        self.pending.extend(record);
    }

    /// Makes what is pending durable, behind what belongs to the last checkpoint. It is still pending: see [`settle`](Self::settle).
    pub fn write(&self) -> Result<()> {
        if !self.has_records() || self.pending.is_empty() {
            return Ok(());
        }
        let write = || {
            failpoint::check("open", &self.path)?;
            let file = File::options().write(true).create(true).truncate(false).open(&self.path)?;
            file.set_len(self.length)?;
            let mut file = Writes::new(file, &self.path);
            file.seek(SeekFrom::End(0))?;
            file.write_all(&self.pending)?;
            file.sync_all()
        };
        write().map_err(Error::on_io("write", &self.path))
    }

    /// What was written belongs to a checkpoint now.
    pub fn settle(&mut self) {
        if self.has_records() {
            self.length += self.pending.len() as u64;
            self.pending.clear();
        }
    }
}

fn checksum(length: [u8; 4], record: &[u8]) -> u32 {
    let mut crc = crc32fast::Hasher::new();
    crc.update(&length);
    crc.update(record);
    crc.finalize()
}

/// The first record of some bytes, and what follows it.
fn split_record(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (head, rest) = bytes.split_first_chunk::<HEAD>()?;
    let length = [head[0], head[1], head[2], head[3]];
    let (record, others) = rest.split_at_checked(u32::from_le_bytes(length) as usize)?;
    (checksum(length, record) == u32::from_le_bytes([head[4], head[5], head[6], head[7]])).then_some((record, others))
}

/// Path of a new journal in `dir`. Each run has another: the one of the run before is needed until the first checkpoint of this one.
pub(super) fn new_path(dir: &Path) -> PathBuf {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let number = (0..=u32::MAX).map(|k| since.as_nanos() as u32 ^ std::process::id().rotate_left(16) ^ k);
    let mut paths = number.map(|number| dir.join(files::journal_name(number)));
    paths.find(|path| !path.exists()).unwrap_or_else(|| dir.join(files::journal_name(0)))
}
