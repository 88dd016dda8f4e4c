//! Writing MCAP files (mcap.dev/spec): one message after the other without chunks, and a summary with their counts.

use super::messages::MessageKind;
use std::io::{self, Write};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const HEADER: u8 = 0x01;
const FOOTER: u8 = 0x02;
const SCHEMA: u8 = 0x03;
const CHANNEL: u8 = 0x04;
const MESSAGE: u8 = 0x05;
const STATISTICS: u8 = 0x0b;
const DATA_END: u8 = 0x0f;

/// A file that is being written, with one channel for each of its topics.
pub(super) struct McapWriter<W: Write> {
    out: W,
    written: u64,
    topics: Vec<(&'static str, MessageKind)>,
    /// Messages of each topic.
    counts: Vec<u64>,
    /// Times of the first and the last message, nanoseconds.
    times: Option<[u64; 2]>,
}

impl<W: Write> McapWriter<W> {
    /// Begins a file of ROS 2 messages.
    pub(super) fn new(out: W, topics: Vec<(&'static str, MessageKind)>) -> io::Result<Self> {
        let counts = vec![0; topics.len()];
        let mut file = Self { out, written: 0, topics, counts, times: None };
        file.bytes(MAGIC)?;
        let mut header = Vec::new();
        text(&mut header, "ros2");
        text(&mut header, "voxelastic");
        file.record(HEADER, &[&header])?;
        file.describe()?;
        Ok(file)
    }

    /// Writes a message of the topic with this index, recorded at a time in nanoseconds.
    pub(super) fn message(&mut self, topic: usize, time_ns: u64, message: &[u8]) -> io::Result<()> {
        let sequence = self.counts[topic] as u32;
        self.counts[topic] += 1;
        self.times = Some(self.times.map_or([time_ns; 2], |[first, last]| [first.min(time_ns), last.max(time_ns)]));
        let mut head = number(topic).to_le_bytes().to_vec();
        head.extend(sequence.to_le_bytes());
        head.extend(time_ns.to_le_bytes());
        head.extend(time_ns.to_le_bytes());
        self.record(MESSAGE, &[&head, message])
    }

    /// Ends the file with its summary.
    pub(super) fn finish(mut self) -> io::Result<()> {
        self.record(DATA_END, &[&[0; 4]])?;
        let summary = self.written;
        self.describe()?;
        let count = self.topics.len();
        let [first, last] = self.times.unwrap_or_default();
        let mut statistics = self.counts.iter().sum::<u64>().to_le_bytes().to_vec();
        statistics.extend((count as u16).to_le_bytes());
        // Channels, attachments, metadata and chunks.
        [count as u32, 0, 0, 0].iter().for_each(|n| statistics.extend(n.to_le_bytes()));
        statistics.extend(first.to_le_bytes());
        statistics.extend(last.to_le_bytes());
        statistics.extend((10 * count as u32).to_le_bytes());
        for (topic, messages) in self.counts.iter().enumerate() {
            statistics.extend(number(topic).to_le_bytes());
            statistics.extend(messages.to_le_bytes());
        }
        self.record(STATISTICS, &[&statistics])?;
        let mut footer = summary.to_le_bytes().to_vec();
        // No summary offsets, no checksum.
        footer.extend([0; 12]);
        self.record(FOOTER, &[&footer])?;
        self.bytes(MAGIC)
    }

    /// Writes a schema and a channel for each topic.
    fn describe(&mut self) -> io::Result<()> {
        for (k, (topic, kind)) in self.topics.clone().into_iter().enumerate() {
            let id = number(k).to_le_bytes();
            let mut schema = id.to_vec();
            text(&mut schema, kind.name);
            text(&mut schema, "ros2msg");
            text(&mut schema, kind.definition);
            self.record(SCHEMA, &[&schema])?;
            let mut channel = [id, id].concat();
            text(&mut channel, topic);
            text(&mut channel, "cdr");
            // No metadata.
            channel.extend([0; 4]);
            self.record(CHANNEL, &[&channel])?;
        }
        Ok(())
    }

    /// Writes a record of several parts.
    fn record(&mut self, op: u8, parts: &[&[u8]]) -> io::Result<()> {
        self.bytes(&[op])?;
        self.bytes(&parts.iter().map(|part| part.len() as u64).sum::<u64>().to_le_bytes())?;
        parts.iter().try_for_each(|part| self.bytes(part))
    }

    fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.written += bytes.len() as u64;
        self.out.write_all(bytes)
    }
}

/// Number of a topic's schema and channel: 0 means none.
fn number(topic: usize) -> u16 {
    topic as u16 + 1
}

/// A string or array with its length.
fn text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}
