//! Where inputs come from.

use voxelastic::event::Event;
use voxelastic_slam::slam::RawScan;

/// An input.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Incoming {
    /// A scan with its pose, an edge of the pose graph, or corrected poses.
    Event(Event),
    /// A scan without a pose, and its name for messages.
    RawScan(RawScan, String),
    /// Something that came and cannot be used, in words.
    Unusable(String),
}

impl Incoming {
    /// Time stamp of a scan, seconds; none for everything else.
    pub fn time(&self) -> Option<f64> {
        match self {
            Self::Event(Event::Scan(scan)) => Some(scan.time),
            Self::RawScan(scan, _) => Some(scan.time),
            _ => None,
        }
    }
}

/// A source of inputs: a recording, or a robot's middleware.
pub trait Transport: Send {
    /// The next input; waits for it. None when there will be none any more, or when `is_stopped` has become true, which it asks at least
    /// ten times a second while it waits.
    fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Incoming>;
}
