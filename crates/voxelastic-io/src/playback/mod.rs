//! Playing back what was recorded with times: scans and poses come one after the other, and leave as registered scans.
//!
//! A recording is read once, front to back. Scans wait until the poses around them have come, which SLAM systems publish late; then
//! the keyframes among them are decoded. Memory does not grow with the recording.

mod corrections;
mod player;
mod reread;
mod select;
pub(crate) mod sweep;
mod track;

pub(crate) use corrections::{Corrections, read_track};
pub(crate) use player::{Player, PlayerOptions, Poses};
pub(crate) use reread::Reread;
pub(crate) use select::{Ledger, Selection, Taken};
pub(crate) use track::{LONGEST_GAP_S, Track, Tree};

use crate::{Result, StampedCloud};
use voxelastic::Pose;

/// Something that was recorded.
pub(crate) enum Heard {
    /// A scan.
    Cloud(HeardCloud),
    /// A pose of the vehicle or the lidar.
    Pose {
        /// Seconds.
        time: f64,
        /// The frame whose pose it is; empty where that is not said.
        child: String,
        /// Its pose in the map frame.
        pose: Pose,
    },
    /// A pose of one frame in another.
    Transform {
        /// Seconds.
        time: f64,
        parent: String,
        child: String,
        pose: Pose,
        /// Whether it holds for ever.
        is_fixed: bool,
    },
    /// Nothing of interest; time went on.
    Nothing,
}

/// A scan that has been heard of and not been decoded.
pub(crate) struct HeardCloud {
    /// Time that its points' times count from, seconds.
    pub(crate) time: f64,
    /// Its frame.
    pub(crate) frame: String,
    /// Bytes that it holds while it waits.
    pub(crate) bytes: usize,
    /// Decodes it.
    pub(crate) decode: Box<dyn FnOnce() -> Result<StampedCloud> + Send>,
}

/// What plays: a recording that is read front to back.
pub(crate) trait Tape: Send {
    /// The next thing that was recorded; an error names a place that could not be read.
    fn next(&mut self) -> Option<Result<Heard>>;

    /// Time of recording of what was heard last, seconds.
    fn now(&self) -> f64;
}

/// Makes a tape anew, from its beginning.
pub(crate) type OpenTape = std::sync::Arc<dyn Fn() -> Result<Box<dyn Tape>> + Send + Sync>;
