//! The messages of a recording, independent of its format.

use crate::Result;
use crate::motion::PoseTrack;
use crate::stamped_cloud::{StampedCloud, SweepTime};
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::motion::ImuSample;

/// A message of a recording.
pub(crate) enum SensorMessage {
    /// A scan.
    Cloud(CloudMessage),
    /// A pose of the vehicle or the lidar.
    Pose {
        /// Seconds.
        time: f64,
        /// The frame that it is in.
        parent: String,
        /// The frame whose pose it is; empty where the message does not say.
        child: String,
        /// Its pose in the map frame.
        pose: Pose,
        /// Whether it is the last in its message: a path begins with old poses each time.
        is_last: bool,
    },
    /// A pose of one frame in another.
    Transform {
        /// Seconds.
        time: f64,
        parent: String,
        child: String,
        pose: Pose,
        /// Whether it holds at all times.
        is_fixed: bool,
    },
    /// Corrected poses of the vehicle or the lidar, at the times of scans.
    Corrected(PoseTrack),
    /// The clock of the messages went back: poses that came before say nothing about scans that come now.
    ClockJump,
    /// A sample of an inertial measurement unit, with the axes of its own frame.
    Imu(ImuSample),
    /// A message that is not used; only its time counts.
    Other,
}

/// A scan that has not been decoded.
pub(crate) struct CloudMessage {
    /// Time that its points' times are relative to, seconds.
    pub(crate) time: f64,
    /// Its frame.
    pub(crate) frame: String,
    /// Which of the sensors took it, in the order in which they were chosen.
    pub(crate) sensor: u16,
    /// How long a sweep of its sensor takes, as far as its clouds have shown it.
    pub(crate) sweep: SweepTime,
    /// Whether its points have times of their own, as far as that is known before it is decoded.
    pub(crate) has_times: bool,
    /// Memory that it holds until it is decoded, bytes.
    pub(crate) bytes: usize,
    /// Decodes it.
    pub(crate) decode: Box<dyn FnOnce() -> Result<StampedCloud> + Send>,
}

/// A recording that is read from front to back.
pub(crate) trait MessageStream: Send {
    /// The next message. An error names a part that could not be read; the stream continues after it.
    fn next(&mut self) -> Option<Result<SensorMessage>>;

    /// Recording time of the last message, seconds.
    fn now(&self) -> f64;
}

/// Opens the stream from its beginning.
pub(crate) type OpenStream = Arc<dyn Fn() -> Result<Box<dyn MessageStream>> + Send + Sync>;
