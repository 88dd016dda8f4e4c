//! Opening a file of messages of any format.

use super::container::Container;
use super::format::BagFormat;
use super::mcap::Mcap;
use super::ros1::Ros1;
use super::sqlite::Sqlite;
use crate::{Error, Position, Result};
use std::path::Path;

/// Opens a file of messages.
///
/// # Errors
/// [`Error::Content`] if its format is unknown or its header is damaged; [`Error::Io`].
pub(crate) fn open(path: &Path) -> Result<Box<dyn Container>> {
    match BagFormat::of(path)? {
        Some(BagFormat::Ros1) => Ok(Box::new(Ros1::open(path)?)),
        Some(BagFormat::Mcap) => Ok(Box::new(Mcap::open(path)?)),
        Some(BagFormat::Sqlite) => Ok(Box::new(Sqlite::open(path)?)),
        Some(BagFormat::Capture) | None => Err(Error::content(
            path,
            Position::Byte(0),
            "not a recording by its first bytes",
            "give a ROS 1 .bag (version 2.0), an .mcap, a ROS 2 .db3 or a .pcap; unpack .zst and .zstd first",
        )),
    }
}
