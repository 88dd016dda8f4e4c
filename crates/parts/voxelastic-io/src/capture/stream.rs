//! A capture as a stream of messages: one scan after the other.

use crate::playback::{CloudMessage, MessageStream, SensorMessage};
use crate::stamped_cloud::{StampedCloud, SweepTime};
use crate::{Error, Result};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use voxelastic::Cloud;
use voxelastic::motion::ImuSample;

/// Memory of a decoded point, bytes: coordinates, intensity, ring and time.
const POINT_BYTES: usize = 24;

/// The scans of a capture, front to back.
pub(crate) trait CapturedScans: Send {
    /// The next scan. An error says once where a capture is cut.
    fn next_scan(&mut self) -> Option<Result<StampedCloud>>;

    /// The samples of the inertial measurement unit that came since the last call.
    fn take_imu(&mut self) -> Vec<ImuSample> {
        Vec::new()
    }

    /// Name of the frame of the scans.
    fn frame(&self) -> &'static str;
}

/// The message stream of a capture.
pub(crate) struct CaptureStream {
    scans: Box<dyn CapturedScans>,
    path: PathBuf,
    now: f64,
    /// Samples that came before a scan, and the scan.
    pending: VecDeque<SensorMessage>,
}

impl CaptureStream {
    pub(crate) fn new(scans: Box<dyn CapturedScans>, path: &Path) -> Self {
        Self { scans, path: path.into(), now: 0.0, pending: VecDeque::new() }
    }
}

impl MessageStream for CaptureStream {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.pending.pop_front() {
            return Some(Ok(message));
        }
        let scan = self.scans.next_scan();
        self.pending.extend(self.scans.take_imu().into_iter().map(SensorMessage::Imu));
        let scan = match scan {
            Some(Ok(scan)) => scan,
            Some(Err(error)) => return Some(Err(error)),
            None => return self.pending.pop_front().map(Ok),
        };
        self.now = scan.stamp.unwrap_or(self.now);
        self.pending.push_back(SensorMessage::Cloud(message(scan, self.now, self.scans.frame(), &self.path)));
        self.pending.pop_front().map(Ok)
    }

    fn now(&self) -> f64 {
        self.now
    }
}

/// A scan as a message; `path` is where it came from.
pub(crate) fn message(scan: StampedCloud, time: f64, frame: &str, path: &Path) -> CloudMessage {
    let path = path.to_owned();
    let bytes = scan.cloud.len() * POINT_BYTES;
    let decode = Box::new(move || {
        let has_return = scan.cloud.points.iter().any(Cloud::is_return);
        let points = scan.cloud.len();
        if has_return { Ok(scan) } else { Err(Error::NoReturn { path, points }) }
    });
    CloudMessage { time, frame: frame.into(), sensor: 0, sweep: SweepTime::default(), has_times: true, bytes, decode }
}
