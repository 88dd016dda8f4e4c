//! Writing messages of ROS 2 into MCAP files.

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::io::{self, Seek, Write};
use voxelastic_io::ros::definition;

/// A file that is being written, with a channel for each of its topics.
pub(super) struct TopicWriter<W: Write + Seek> {
    file: Writer<W>,
    /// Channels of the topics, and how many messages each has.
    channels: Vec<(u16, u32)>,
}

impl<W: Write + Seek> TopicWriter<W> {
    /// Begins a file with these topics: names, and types of their messages. Messages are large: chunks would gather one each.
    pub(super) fn new(out: W, topics: &[(&str, &str)]) -> io::Result<Self> {
        let options = WriteOptions::new().profile("ros2").library("voxelastic").compression(None).use_chunks(false);
        let mut file = options.create(out).map_err(as_io)?;
        let mut channels = Vec::new();
        for (name, kind) in topics {
            let schema = file.add_schema(kind, "ros2msg", definition(kind).unwrap_or_default().as_bytes()).map_err(as_io)?;
            channels.push((file.add_channel(schema, name, "cdr", &BTreeMap::new()).map_err(as_io)?, 0));
        }
        Ok(Self { file, channels })
    }

    /// Writes a message of the topic with this index, recorded at a time in nanoseconds.
    pub(super) fn message(&mut self, topic: usize, time_ns: u64, message: &[u8]) -> io::Result<()> {
        let (channel_id, sequence) = self.channels[topic];
        self.channels[topic].1 += 1;
        let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        self.file.write_to_known_channel(&header, message).map_err(as_io)
    }

    /// Ends the file with its summary.
    pub(super) fn finish(mut self) -> io::Result<()> {
        self.file.finish().map_err(as_io).map(|_| ())
    }
}

fn as_io(error: McapError) -> io::Error {
    if let McapError::Io(error) = error { error } else { io::Error::other(error) }
}
