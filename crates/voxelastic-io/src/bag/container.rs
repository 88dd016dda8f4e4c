//! Messages of a recording, whatever holds them.

use super::mcap::Mcap;
use super::ros1::Ros1;
use super::sqlite::Sqlite;
use crate::{Error, Position, Result};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// How messages are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// ROS 1: packed, little-endian.
    Ros1,
    /// ROS 2: CDR, aligned, byte order in the first bytes.
    Cdr,
    /// Anything else; not read.
    Other,
}

/// A channel of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Topic {
    /// Such as `/points_raw`.
    pub(super) name: String,
    /// Type as package/Type, ROS 2's `/msg/` left out.
    pub(super) kind: String,
    pub(super) encoding: Encoding,
}

impl Topic {
    pub(super) fn new(name: String, kind: &str, encoding: Encoding) -> Self {
        Self { name, kind: kind.replace("/msg/", "/"), encoding }
    }
}

/// A message that was asked for.
#[derive(Debug)]
pub(super) struct Message {
    /// Number of its topic in [`Container::topics`].
    pub(super) topic: usize,
    /// When it was recorded, nanoseconds.
    pub(super) time_ns: i64,
    /// Where in the file it is (its chunk, if it is in one); the number of its row in a database.
    pub(super) at: u64,
    pub(super) data: Vec<u8>,
}

/// What the index of a file says, without reading its messages.
#[derive(Clone, Debug, Default)]
pub(super) struct Index {
    /// Messages of each topic, in the order of the topics.
    pub(super) counts: Vec<u64>,
    /// Times of the first and the last message, nanoseconds.
    pub(super) times_ns: Option<(i64, i64)>,
}

/// The kinds of files that recordings are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BagFormat {
    /// ROS 1 `.bag`, version 2.0.
    Ros1,
    /// MCAP, by ROS 2 or ROS 1.
    Mcap,
    /// ROS 2 `.db3`.
    Sqlite,
    /// An Ouster sensor's packets in a `.pcap`, see [`crate::ouster`].
    Ouster,
}

impl BagFormat {
    /// The format of a file by its first bytes.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn of(path: &Path) -> Result<Option<Self>> {
        let mut first = Vec::new();
        File::open(path).and_then(|f| f.take(16).read_to_end(&mut first)).map_err(|e| Error::io(path, "read", e))?;
        let known = [(super::ros1::MAGIC, Self::Ros1), (super::mcap::MAGIC, Self::Mcap), (super::sqlite::MAGIC, Self::Sqlite)];
        let capture = crate::ouster::MAGICS.iter().any(|magic| first.starts_with(magic)).then_some(Self::Ouster);
        Ok(known.into_iter().find(|(magic, _)| first.starts_with(magic)).map(|(_, format)| format).or(capture))
    }
}

impl fmt::Display for BagFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ros1 => "ROS 1 bag",
            Self::Mcap => "MCAP",
            Self::Sqlite => "ROS 2 sqlite3 bag",
            Self::Ouster => "Ouster capture",
        })
    }
}

/// A file of messages.
pub(super) trait Container: Send {
    /// The topics that are known so far; more may come while messages are read.
    fn topics(&self) -> &[Topic];

    /// What the file's index says, if it has one and it is whole.
    fn index(&self) -> Option<Index>;

    /// The next message of a topic that is wanted, in the order of the file. An error names a place that cannot be read; the next
    /// call goes on behind it, if anything can be made out there.
    fn next(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Option<Result<Message>>;
}

/// Opens a file of messages.
///
/// # Errors
/// [`Error::Content`] if it is of no known kind or its head is damaged; [`Error::Io`].
pub(super) fn open(path: &Path) -> Result<Box<dyn Container>> {
    match BagFormat::of(path)? {
        Some(BagFormat::Ros1) => Ok(Box::new(Ros1::open(path)?)),
        Some(BagFormat::Mcap) => Ok(Box::new(Mcap::open(path)?)),
        Some(BagFormat::Sqlite) => Ok(Box::new(Sqlite::open(path)?)),
        Some(BagFormat::Ouster) | None => Err(Error::content(
            path,
            Position::Byte(0),
            "not a recording by its first bytes",
            "give a ROS 1 .bag (version 2.0), an .mcap, a ROS 2 .db3 or an Ouster .pcap; unpack .zst and .zstd first",
        )),
    }
}
