//! MCAP files (mcap.dev/spec): records of an op code and a length, messages mostly in chunks, a summary at the end.

use super::container::{Encoding, Index, Message, Topic};
use super::feed::{Feed, Packing};
use super::records::{Records, Topics};
use super::wire::Wire;
use crate::{Error, Position, Result};
use std::collections::HashMap;
use std::path::Path;

pub(super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

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
const TAIL: u64 = 1 + 8 + 20 + MAGIC.len() as u64;

/// An MCAP file.
#[derive(Debug)]
pub(super) struct Mcap {
    feed: Feed,
    topics: Topics,
    schemas: HashMap<u16, String>,
    index: Option<Index>,
    finished: bool,
}

impl Mcap {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let feed = Feed::open(path)?;
        let mut file = Self { feed, topics: Topics::default(), schemas: HashMap::new(), index: None, finished: false };
        // A file that was not closed has no summary: it is read all the same.
        file.index = file.read_summary().ok().flatten();
        file.feed.seek(MAGIC.len() as u64)?;
        Ok(file)
    }

    /// Schemas, channels and statistics at the end of a file that was closed.
    fn read_summary(&mut self) -> Result<Option<Index>> {
        let Some(tail) = self.feed.len().checked_sub(TAIL) else { return Ok(None) };
        self.feed.seek(tail)?;
        let footer = self.feed.take(TAIL)?;
        if footer[0] != FOOTER || !footer.ends_with(MAGIC) {
            return Ok(None);
        }
        let start = footer[9..].first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
        if start < MAGIC.len() as u64 || start >= tail {
            return Ok(None);
        }
        self.feed.seek(start)?;
        let mut statistics = None;
        while self.feed.position() < tail {
            let (op, size) = self.record_head()?;
            match op {
                SCHEMA => self.schema(size)?,
                CHANNEL => self.channel(size)?,
                STATISTICS => statistics = Some(self.feed.take(size)?),
                _ => self.feed.skip(size)?,
            }
        }
        Ok(statistics.and_then(|bytes| self.count(&bytes)))
    }

    /// What the statistics record says.
    fn count(&self, bytes: &[u8]) -> Option<Index> {
        let mut wire = Wire::packed(bytes);
        let messages = wire.u64()?;
        wire.bytes(2 + 4 * 4)?;
        let times_ns = (wire.u64()? as i64, wire.u64()? as i64);
        let mut counts = vec![0; self.topics.list().len()];
        let pairs = wire.u32()? as usize;
        for pair in wire.bytes(pairs)?.chunks_exact(10) {
            let channel = u16::from_le_bytes([pair[0], pair[1]]);
            let count = pair[2..].first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
            if let Some(topic) = self.topics.get(channel.into()) {
                counts[topic] += count;
            }
        }
        Some(Index { counts, times_ns: (messages > 0).then_some(times_ns) })
    }

    fn record_head(&mut self) -> Result<(u8, u64)> {
        let op = self.feed.take(1)?[0];
        Ok((op, self.feed.u64()?))
    }

    fn schema(&mut self, size: u64) -> Result<()> {
        let bytes = self.feed.take(size)?;
        let mut wire = Wire::packed(&bytes);
        let (Some(id), Some(name)) = (wire.u16(), wire.text()) else { return Err(self.damaged("a schema that ends early")) };
        self.schemas.insert(id, name);
        Ok(())
    }

    fn channel(&mut self, size: u64) -> Result<()> {
        let bytes = self.feed.take(size)?;
        let mut wire = Wire::packed(&bytes);
        let (Some(id), Some(schema), Some(name), Some(encoding)) = (wire.u16(), wire.u16(), wire.text(), wire.text()) else {
            return Err(self.damaged("a channel that ends early"));
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
        let begin = self.feed.position();
        // Start and end time, unpacked size, checksum, name of the packing.
        self.feed.skip(16)?;
        let (unpacked, crc, name) = (self.feed.u64()?, self.feed.u32()?, self.feed.u32()?);
        if u64::from(name) > size {
            return Err(self.damaged("a chunk whose packing has a name longer than the chunk"));
        }
        let name = self.feed.take(name.into())?;
        let packed = self.feed.u64()?;
        let packing = match name.as_slice() {
            b"" => {
                self.feed.enter_in_place(packed);
                return Ok(());
            }
            b"lz4" => Packing::Lz4,
            b"zstd" => Packing::Zstd,
            other => {
                let problem = format!("a chunk packed as {:?}", String::from_utf8_lossy(other));
                self.feed.skip(packed)?;
                self.feed.is_sound();
                return Err(Error::content(self.feed.path(), Position::Byte(begin), problem, "record with lz4, zstd or no compression"));
            }
        };
        self.feed.enter(packing, packed, unpacked, Some(crc))
    }

    fn damaged(&self, problem: &str) -> Error {
        Error::content(self.feed.path(), Position::Byte(self.feed.position()), problem, "the recording is damaged here: copy or record it again")
    }
}

impl Records for Mcap {
    fn feed(&mut self) -> &mut Feed {
        &mut self.feed
    }

    fn topics(&self) -> &Topics {
        &self.topics
    }

    fn index(&self) -> Option<&Index> {
        self.index.as_ref()
    }

    fn has_ended(&self) -> bool {
        self.finished
    }

    fn record(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Result<Option<Message>> {
        let at = self.feed.position();
        let (op, size) = self.record_head()?;
        match op {
            SCHEMA => self.schema(size)?,
            CHANNEL => self.channel(size)?,
            CHUNK => self.enter(size)?,
            MESSAGE if size >= MESSAGE_HEAD => {
                let head = self.feed.take(MESSAGE_HEAD)?;
                let mut wire = Wire::packed(&head);
                let (channel, _, time) = (wire.u16(), wire.u32(), wire.u64());
                let topic = channel.and_then(|c| self.topics.get(c.into())).filter(|t| wanted(&self.topics.list()[*t]));
                let size = size - MESSAGE_HEAD;
                match topic.zip(time) {
                    Some((topic, time)) => return Ok(Some(Message { topic, time_ns: time as i64, at, data: self.feed.take(size)? })),
                    None => self.feed.skip(size)?,
                }
            }
            // What follows is the summary.
            DATA_END | FOOTER => self.finished = true,
            0 => return Err(self.damaged("a record without op code")),
            _ => self.feed.skip(size)?,
        }
        Ok(None)
    }
}
