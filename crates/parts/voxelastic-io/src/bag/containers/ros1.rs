//! ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0): records with named header fields, mostly in chunks.

use super::chunk::Compression;
use super::chunk_reader::ChunkReader;
use super::container::{Encoding, Index, Message, Topic};
use super::format::ROS1_MAGIC;
use super::prefetch::{ChunkHeader, ChunkPrefetcher};
use super::records::{RecordFile, TopicTable};
use crate::{Error, Position, Result};
use std::collections::HashMap;
use std::path::Path;

const MESSAGE: u8 = 0x02;
const BAG_HEADER: u8 = 0x03;
const CHUNK: u8 = 0x05;
const CHUNK_INFO: u8 = 0x06;
const CONNECTION: u8 = 0x07;
/// Largest plausible header of a record, bytes.
const LARGEST_HEADER: u64 = 1 << 20;

/// A ROS 1 bag.
#[derive(Debug)]
pub(crate) struct Ros1 {
    reader: ChunkReader,
    topics: TopicTable,
    index: Option<Index>,
}

/// The fields of a record's header.
struct Fields(Vec<u8>);

impl Fields {
    /// The value of a field; `None` if it is missing or the header is damaged.
    fn get(&self, name: &[u8]) -> Option<&[u8]> {
        let mut rest = self.0.as_slice();
        while let Some((len, tail)) = rest.split_first_chunk::<4>() {
            let len = u32::from_le_bytes(*len) as usize;
            let (field, tail) = tail.split_at_checked(len)?;
            let split = field.iter().position(|b| *b == b'=')?;
            if &field[..split] == name {
                return Some(&field[split + 1..]);
            }
            rest = tail;
        }
        None
    }

    fn u32(&self, name: &[u8]) -> Option<u32> {
        self.get(name)?.first_chunk().map(|b| u32::from_le_bytes(*b))
    }

    fn u64(&self, name: &[u8]) -> Option<u64> {
        self.get(name)?.first_chunk().map(|b| u64::from_le_bytes(*b))
    }

    /// A time (seconds, nanoseconds) in nanoseconds.
    fn time(&self, name: &[u8]) -> Option<i64> {
        let value = self.u64(name)?;
        Some((value & 0xffff_ffff) as i64 * 1_000_000_000 + (value >> 32) as i64)
    }

    fn text(&self, name: &[u8]) -> Option<String> {
        self.get(name).map(|b| String::from_utf8_lossy(b).into_owned())
    }

    fn op(&self) -> Option<u8> {
        self.get(b"op")?.first().copied()
    }
}

impl Ros1 {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let mut reader = ChunkReader::open(path)?;
        reader.skip(ROS1_MAGIC.len() as u64)?;
        let header = Fields(header_bytes(&mut reader)?);
        if header.op() != Some(BAG_HEADER) {
            return Err(damaged(&reader, "the bag header is missing"));
        }
        let index_at = header.u64(b"index_pos").unwrap_or(0);
        let padding = reader.u32()?;
        reader.skip(padding.into())?;
        let first = reader.position();
        let mut bag = Self { reader, topics: TopicTable::default(), index: None };
        if index_at >= first && index_at < bag.reader.len() {
            bag.index = bag.read_index(index_at).ok();
        }
        bag.reader.seek(first)?;
        bag.reader.cache = ChunkPrefetcher::open(path, next_chunk);
        Ok(bag)
    }

    /// Reads connections and chunk infos at the end of a bag that was closed.
    fn read_index(&mut self, at: u64) -> Result<Index> {
        self.reader.seek(at)?;
        let mut counts: HashMap<u32, u64> = HashMap::new();
        let mut times: Option<(i64, i64)> = None;
        while !self.reader.at_end() {
            let header = Fields(header_bytes(&mut self.reader)?);
            let size = u64::from(self.reader.u32()?);
            match header.op() {
                Some(CONNECTION) => self.connect(&header, size)?,
                Some(CHUNK_INFO) => {
                    let data = self.reader.take(size)?;
                    for pair in data.chunks_exact(8) {
                        let number = |k: usize| u32::from_le_bytes([pair[k], pair[k + 1], pair[k + 2], pair[k + 3]]);
                        *counts.entry(number(0)).or_default() += u64::from(number(4));
                    }
                    if let (Some(start), Some(end)) = (header.time(b"start_time"), header.time(b"end_time")) {
                        times = Some(times.map_or((start, end), |(a, b)| (a.min(start), b.max(end))));
                    }
                }
                _ => self.reader.skip(size)?,
            }
        }
        let mut index = Index { counts: vec![0; self.topics.list().len()], times_ns: times };
        for (connection, count) in counts {
            if let Some(topic) = self.topics.get(connection) {
                index.counts[topic] += count;
            }
        }
        Ok(index)
    }

    fn connect(&mut self, header: &Fields, size: u64) -> Result<()> {
        let details = Fields(self.reader.take(size)?);
        let (Some(number), Some(name)) = (header.u32(b"conn"), header.text(b"topic")) else {
            return Err(damaged(&self.reader, "a connection without number or topic"));
        };
        self.topics.add(number, Topic::new(name, &details.text(b"type").unwrap_or_default(), Encoding::Ros1));
        Ok(())
    }

    /// Enters a chunk. An uncompressed one is read like the rest of the file.
    fn enter(&mut self, header: &Fields, size: u64) -> Result<()> {
        let compression = match header.get(b"compression") {
            Some(b"none") | None => {
                self.reader.enter_in_place(size);
                return Ok(());
            }
            Some(b"bz2") => Compression::Bzip2,
            Some(b"lz4") => Compression::Lz4,
            Some(other) => {
                let problem = format!("a chunk compressed with {:?}", String::from_utf8_lossy(other));
                self.reader.skip(size)?;
                self.reader.mark_recoverable();
                return Err(damaged(&self.reader, problem));
            }
        };
        self.reader.enter(compression, size, header.u32(b"size").unwrap_or(0).into(), None)
    }
}

impl RecordFile for Ros1 {
    fn reader(&mut self) -> &mut ChunkReader {
        &mut self.reader
    }

    fn topics(&self) -> &TopicTable {
        &self.topics
    }

    fn index(&self) -> Option<&Index> {
        self.index.as_ref()
    }

    fn record(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Result<Option<Message>> {
        let at = self.reader.position();
        let header = Fields(header_bytes(&mut self.reader)?);
        let size = u64::from(self.reader.u32()?);
        match header.op() {
            Some(MESSAGE) => {
                let topic = header.u32(b"conn").and_then(|c| self.topics.get(c));
                match (topic, header.time(b"time")) {
                    (Some(topic), Some(time_ns)) if wanted(&self.topics.list()[topic]) => {
                        Ok(Some(Message { topic, time_ns, at, data: self.reader.take(size)? }))
                    }
                    (None, _) | (_, None) => {
                        self.reader.skip(size)?;
                        self.reader.mark_recoverable();
                        Err(damaged_at(&self.reader, at, "a message without connection or time"))
                    }
                    _ => self.reader.skip(size).map(|()| None),
                }
            }
            Some(CONNECTION) => self.connect(&header, size).map(|()| None),
            Some(CHUNK) => self.enter(&header, size).map(|()| None),
            Some(_) => self.reader.skip(size).map(|()| None),
            None => Err(damaged_at(&self.reader, at, "a record without op code")),
        }
    }
}

/// Finds the next bzip2 chunk, starting at a record outside of chunks: the others decompress quickly.
fn next_chunk(reader: &mut ChunkReader) -> Option<ChunkHeader> {
    while !reader.at_end() {
        let header = Fields(header_bytes(reader).ok()?);
        let compressed = u64::from(reader.u32().ok()?);
        if header.op() == Some(CHUNK) && header.get(b"compression") == Some(b"bz2") {
            return Some(ChunkHeader { compression: Compression::Bzip2, compressed, size: header.u32(b"size")?.into() });
        }
        reader.skip(compressed).ok()?;
    }
    None
}

fn header_bytes(reader: &mut ChunkReader) -> Result<Vec<u8>> {
    let size = u64::from(reader.u32()?);
    if size > LARGEST_HEADER {
        return Err(damaged(reader, format!("a record whose header takes {size} bytes")));
    }
    reader.take(size)
}

fn damaged(reader: &ChunkReader, problem: impl Into<String>) -> Error {
    damaged_at(reader, reader.position(), problem)
}

fn damaged_at(reader: &ChunkReader, at: u64, problem: impl Into<String>) -> Error {
    Error::content(reader.path(), Position::Byte(at), problem, "the bag is damaged here: copy or record it again")
}
