//! The first field of most messages.

use crate::ros::{Encoding, MessageReader};

/// When and in which frame a message was made.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    /// Seconds.
    pub(crate) time: f64,
    pub(crate) frame: String,
}

pub(super) fn header(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<Header> {
    if encoding == Encoding::Ros1 {
        cursor.u32()?; // sequence number
    }
    Some(Header { time: time(cursor)?, frame: frame(cursor.text()?) })
}

/// A time stamp, seconds.
pub(super) fn time(cursor: &mut MessageReader<'_>) -> Option<f64> {
    let (seconds, nanoseconds) = (cursor.u32()?, cursor.u32()?);
    Some(f64::from(seconds) + f64::from(nanoseconds) * 1e-9)
}

/// The frame's name without a leading slash.
pub(super) fn frame(name: String) -> String {
    name.strip_prefix('/').map_or_else(|| name.clone(), str::to_owned)
}
