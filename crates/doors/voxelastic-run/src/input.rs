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
    /// A pose that cannot be used, in words; no scan is lost with it.
    BadPose(String),
}

impl From<voxelastic_io::Error> for Input {
    fn from(problem: voxelastic_io::Error) -> Self {
        let words = crate::error::one_line(&problem);
        if matches!(problem, voxelastic_io::Error::BadPose { .. }) { Self::BadPose(words) } else { Self::Unusable(words) }
    }
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
