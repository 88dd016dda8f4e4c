//! Formats of recordings.

use crate::capture::{MAGICS, PCAPNG};
use crate::{Error, Position, Result};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// First bytes of a ROS 1 bag.
pub(crate) const ROS1_MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// First and last bytes of an MCAP file.
pub(crate) const MCAP_MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// First bytes of a SQLite database.
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

/// File formats of recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BagFormat {
    /// ROS 1 `.bag`, version 2.0.
    Ros1,
    /// MCAP, by ROS 2 or ROS 1.
    Mcap,
    /// ROS 2 `.db3`.
    Sqlite,
    /// A sensor's packets in a `.pcap` or `.pcapng`.
    Capture,
}

impl BagFormat {
    /// The format of a file by its first bytes.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn of(path: &Path) -> Result<Option<Self>> {
        // Opening anything else, a pipe for one, could wait forever.
        let metadata = path.metadata().map_err(|e| Error::io(path, "read", e))?;
        if !metadata.is_file() && !metadata.is_dir() {
            let problem = "a pipe or a device, and recordings are read more than once";
            return Err(Error::content(path, Position::File, problem, "write it to a file first"));
        }
        let mut first = Vec::new();
        File::open(path).and_then(|f| f.take(16).read_to_end(&mut first)).map_err(|e| Error::io(path, "read", e))?;
        let known = [(ROS1_MAGIC, Self::Ros1), (MCAP_MAGIC, Self::Mcap), (SQLITE_MAGIC, Self::Sqlite)];
        let is_capture = MAGICS.iter().chain([&PCAPNG]).any(|magic| first.starts_with(magic));
        let bag = known.into_iter().find(|(magic, _)| first.starts_with(magic)).map(|(_, format)| format);
        Ok(bag.or(is_capture.then_some(Self::Capture)))
    }
}

impl fmt::Display for BagFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ros1 => "ROS 1 bag",
            Self::Mcap => "MCAP",
            Self::Sqlite => "ROS 2 sqlite3 bag",
            Self::Capture => "capture of packets",
        })
    }
}
