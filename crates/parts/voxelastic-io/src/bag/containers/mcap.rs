//! MCAP files (mcap.dev/spec): records with op code and length, messages mostly in chunks, a summary at the end.

use super::chunk::Compression;
use super::chunk_reader::ChunkReader;
use super::container::{Encoding, Index, Message, Topic};
use super::format::MCAP_MAGIC;
use super::records::{RecordFile, TopicTable};
use crate::ros::MessageReader;
use crate::{Error, Position, Result};
use std::collections::HashMap;
use std::path::Path;

const FOOTER: u8 = 0x02;
const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const CHUNK: u8 = 0x06;
const STATISTICS: u8 = 0x0b;
const DATA_END: u8 = 0x0f;
/// Bytes of a message record before its data.
const MESSAGE_HEAD: u64 = 22;
/// The footer record and the closing magic.
const TAIL: u64 = 1 + 8 + 20 + MCAP_MAGIC.len() as u64;

/// An MCAP file.
#[derive(Debug)]
pub(crate) struct Mcap {
    reader: ChunkReader,
    topics: TopicTable,
    schemas: HashMap<u16, String>,
    index: Option<Index>,
    finished: bool,
}

impl Mcap {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let reader = ChunkReader::open(path)?;
        let mut file = Self { reader, topics: TopicTable::default(), schemas: HashMap::new(), index: None, finished: false };
        // A file that was not closed has no summary; it can still be read.
        file.index = file.read_summary().ok().flatten();
        file.reader.seek(MCAP_MAGIC.len() as u64)?;
        Ok(file)
    }

    /// Reads schemas, channels and statistics at the end of a file that was closed.
    fn read_summary(&mut self) -> Result<Option<Index>> {
        let Some(tail) = self.reader.len().checked_sub(TAIL) else { return Ok(None) };
        self.reader.seek(tail)?;
        let footer = self.reader.take(TAIL)?;
        if footer[0] != FOOTER || !footer.ends_with(MCAP_MAGIC) {
            return Ok(None);
        }
        let start = footer[9..].first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
        if start < MCAP_MAGIC.len() as u64 || start >= tail {
            return Ok(None);
        }
        self.reader.seek(start)?;
        let mut statistics = None;
        while self.reader.position() < tail {
            let (op, size) = self.record_head()?;
            match op {
                SCHEMA => self.schema(size)?,
                CHANNEL => self.channel(size)?,
                STATISTICS => statistics = Some(self.reader.take(size)?),
                _ => self.reader.skip(size)?,
            }
        }
        Ok(statistics.and_then(|bytes| self.parse_statistics(&bytes)))
    }

    /// The index in a statistics record.
    fn parse_statistics(&self, bytes: &[u8]) -> Option<Index> {
        let mut cursor = MessageReader::packed(bytes);
        let messages = cursor.u64()?;
        cursor.bytes(2 + 4 * 4)?;
        let times_ns = (cursor.u64()? as i64, cursor.u64()? as i64);
        let mut counts = vec![0; self.topics.list().len()];
        let pairs = cursor.u32()? as usize;
        for pair in cursor.bytes(pairs)?.chunks_exact(10) {
            let channel = u16::from_le_bytes([pair[0], pair[1]]);
            let count = pair[2..].first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
            if let Some(topic) = self.topics.get(channel.into()) {
                counts[topic] += count;
            }
        }
        Some(Index { counts, times_ns: (messages > 0).then_some(times_ns) })
    }

    fn record_head(&mut self) -> Result<(u8, u64)> {
        let op = self.reader.take(1)?[0];
        Ok((op, self.reader.u64()?))
    }

    fn schema(&mut self, size: u64) -> Result<()> {
        let bytes = self.reader.take(size)?;
        let mut cursor = MessageReader::packed(&bytes);
        let (Some(id), Some(name)) = (cursor.u16(), cursor.text()) else { return Err(self.damaged("a truncated schema")) };
        self.schemas.insert(id, name);
        Ok(())
    }

    fn channel(&mut self, size: u64) -> Result<()> {
        let bytes = self.reader.take(size)?;
        let mut cursor = MessageReader::packed(&bytes);
        let (Some(id), Some(schema), Some(name), Some(encoding)) = (cursor.u16(), cursor.u16(), cursor.text(), cursor.text()) else {
            return Err(self.damaged("a truncated channel"));
        };
        let encoding = match encoding.as_str() {
            "cdr" => Encoding::Cdr,
            "ros1" => Encoding::Ros1,
            _ => Encoding::Other,
        };
        let topic = Topic::new(name, self.schemas.get(&schema).map_or("", String::as_str), encoding);
        self.topics.add(id.into(), topic);
        Ok(())
    }

    fn enter(&mut self, size: u64) -> Result<()> {
        let begin = self.reader.position();
        // Start and end time, uncompressed size, checksum, name of the compression.
        self.reader.skip(16)?;
        let (uncompressed, crc, name) = (self.reader.u64()?, self.reader.u32()?, self.reader.u32()?);
        if u64::from(name) > size {
            return Err(self.damaged("a chunk whose compression has a name longer than the chunk"));
        }
        let name = self.reader.take(name.into())?;
        let compressed = self.reader.u64()?;
        let compression = match name.as_slice() {
            b"" => {
                self.reader.enter_in_place(compressed);
                return Ok(());
            }
            b"lz4" => Compression::Lz4,
            b"zstd" => Compression::Zstd,
            other => {
                let problem = format!("a chunk compressed with {:?}", String::from_utf8_lossy(other));
                self.reader.skip(compressed)?;
                self.reader.mark_recoverable();
                return Err(Error::content(self.reader.path(), Position::Byte(begin), problem, "record with lz4, zstd or no compression"));
            }
        };
        self.reader.enter(compression, compressed, uncompressed, Some(crc))
    }

    fn damaged(&self, problem: &str) -> Error {
        Error::content(self.reader.path(), Position::Byte(self.reader.position()), problem, "the recording is damaged here: copy or record it again")
    }
}

impl RecordFile for Mcap {
    fn reader(&mut self) -> &mut ChunkReader {
        &mut self.reader
    }

    fn topics(&self) -> &TopicTable {
        &self.topics
    }

    fn index(&self) -> Option<&Index> {
        self.index.as_ref()
    }

    fn has_ended(&self) -> bool {
        self.finished
    }

    fn record(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Result<Option<Message>> {
        let at = self.reader.position();
        let (op, size) = self.record_head()?;
        match op {
            SCHEMA => self.schema(size)?,
            CHANNEL => self.channel(size)?,
            CHUNK => self.enter(size)?,
            MESSAGE if size >= MESSAGE_HEAD => {
                let head = self.reader.take(MESSAGE_HEAD)?;
                let mut cursor = MessageReader::packed(&head);
                let (channel, _, time) = (cursor.u16(), cursor.u32(), cursor.u64());
                let topic = channel.and_then(|c| self.topics.get(c.into())).filter(|t| wanted(&self.topics.list()[*t]));
                let size = size - MESSAGE_HEAD;
                match topic.zip(time) {
                    Some((topic, time)) => return Ok(Some(Message { topic, time_ns: time as i64, at, data: self.reader.take(size)? })),
                    None => self.reader.skip(size)?,
                }
            }
            // What follows is the summary.
            DATA_END | FOOTER => self.finished = true,
            0 => return Err(self.damaged("a record without op code")),
            _ => self.reader.skip(size)?,
        }
        Ok(None)
    }
}
