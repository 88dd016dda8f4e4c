//! A capture as what was heard: one scan after the other.

use super::Capture;
use crate::playback::{Heard, HeardCloud, Tape};
use crate::{Error, Result};
use std::path::Path;
use voxelastic::Cloud;

/// A capture that plays.
pub(crate) struct CaptureTape {
    capture: Capture,
    path: std::path::PathBuf,
    now: f64,
}

impl CaptureTape {
    pub(crate) fn open(capture: &Path, metadata: &Path) -> Result<Self> {
        Ok(Self { capture: Capture::open(capture, metadata)?, path: capture.into(), now: 0.0 })
    }
}

impl Tape for CaptureTape {
    fn next(&mut self) -> Option<Result<Heard>> {
        let scan = match self.capture.next_scan()? {
            Ok(scan) => scan,
            Err(error) => return Some(Err(error)),
        };
        self.now = scan.stamp.unwrap_or(self.now);
        let path = self.path.clone();
        let bytes = scan.cloud.len() * 24;
        let decode = Box::new(move || {
            let has_return = scan.cloud.points.iter().any(Cloud::is_return);
            let points = scan.cloud.len();
            if has_return { Ok(scan) } else { Err(Error::NoReturn { path, points }) }
        });
        Some(Ok(Heard::Cloud(HeardCloud { time: self.now, frame: "os_sensor".into(), bytes, decode })))
    }

    fn now(&self) -> f64 {
        self.now
    }
}
