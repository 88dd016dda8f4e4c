//! What comes to a run.

use voxelastic::event::Event;
use voxelastic_slam::slam::RawScan;

/// Something that comes: pulled from a folder or a recording, or pushed by a program or a robot.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Input {
    /// A scan with its pose, an edge of the pose graph, or corrected poses.
    Event(Event),
    /// A scan without a pose, and its name for messages.
    RawScan(RawScan, String),
    /// Something that came and cannot be used, in words.
    Unusable(String),
}

impl Input {
    /// Time stamp of a scan, seconds; none for everything else.
    pub fn time(&self) -> Option<f64> {
        match self {
            Self::Event(Event::Scan(scan)) => Some(scan.time),
            Self::RawScan(scan, _) => Some(scan.time),
            _ => None,
        }
    }

    /// Whether it is a scan, or was to be one.
    pub fn is_scan(&self) -> bool {
        self.time().is_some() || matches!(self, Self::Unusable(_))
    }
}
