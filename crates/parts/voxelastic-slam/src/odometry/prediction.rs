//! Prediction of the next pose, and how wrong predictions are.

use super::inertial::Inertial;
use nalgebra::{Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use voxelastic::geometry::Pose;
use voxelastic::motion::ImuSample;

/// Predictions this near to the outcome say nothing about the motion, metres.
const LEAST_MOTION: f64 = 0.1;
/// What a squared error still weighs one error later.
const KEEP: f64 = 0.9;
/// The error that is expected before anything is known, metres.
const FIRST_ERROR: f64 = 2.0;
/// A gap between scans longer than so many times the gap before predicts no motion.
const LONGEST_GAP: f64 = 4.0;

/// Shorter times between scans are no gap, seconds.
const LEAST_GAP: f64 = 1.0;
/// Dead reckoning over longer gaps is worse than none: its error grows with the square of the time, seconds.
const LONGEST_RECKONING: f64 = 2.0;

/// Constant velocity, with the rotation of a gyro where there is one. The error to expect is the adaptive threshold of KISS-ICP (Vizzo et
/// al. 2023), but with forgetting.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Predictor {
    /// Motion from the scan before the last to the last.
    #[serde(with = "voxelastic::geometry::stored")]
    motion: Pose,
    /// Seconds that it took, if the scans have times.
    duration: Option<f64>,
    squares: f64,
    weight: f64,
    pub(crate) inertial: Inertial,
}

impl Predictor {
    pub(crate) fn new() -> Self {
        Self { motion: Pose::identity(), duration: None, squares: FIRST_ERROR * FIRST_ERROR, weight: 1.0, inertial: Inertial::default() }
    }

    /// Forgets the velocity and how well it predicted.
    pub(crate) fn restart(&mut self) {
        *self = Self { inertial: std::mem::take(&mut self.inertial), ..Self::new() };
    }

    pub(crate) fn add_imu(&mut self, sample: ImuSample) {
        self.inertial.add(sample);
    }

    /// The pose of the lidar, from that of the last scan: by dead reckoning where there is an inertial unit whose velocity is known.
    pub(crate) fn pose(&self, last: &Pose, from: Option<f64>, seconds: Option<f64>) -> Pose {
        let reckoned = from.zip(seconds).filter(|(_, s)| *s <= LONGEST_RECKONING).and_then(|(from, s)| self.inertial.predict(last, from, from + s));
        reckoned.unwrap_or_else(|| last * self.motion(from, seconds))
    }

    /// Motion of the lidar over an interval, in its frame at the beginning; `seconds` is `None` where scans have no times.
    pub(crate) fn motion(&self, from: Option<f64>, seconds: Option<f64>) -> Pose {
        let share = match (seconds, self.duration) {
            (Some(seconds), Some(duration)) if duration > 0.0 => seconds / duration,
            _ => 1.0,
        };
        let mut motion = if share.abs() <= LONGEST_GAP { scaled(&self.motion, share) } else { Pose::identity() };
        if let Some(rotation) = from.zip(seconds).and_then(|(from, seconds)| self.inertial.rotation(from, from + seconds)) {
            motion.rotation = rotation;
        }
        motion
    }

    /// Whether so many seconds since the last scan are a gap.
    pub(crate) fn is_gap(&self, seconds: f64) -> bool {
        seconds > LEAST_GAP && self.duration.is_some_and(|duration| duration > 0.0 && seconds > LONGEST_GAP * duration)
    }

    /// Whether a velocity in metres and radians per second is known.
    pub(crate) fn has_velocity(&self) -> bool {
        self.duration.is_some_and(|d| d > 0.0)
    }

    /// Error to expect of the next prediction, metres, for a point at the scan's radius.
    pub(crate) fn sigma(&self) -> f64 {
        (self.squares / self.weight).sqrt()
    }

    /// Sets the motion from the last scan to this one.
    pub(crate) fn set_motion(&mut self, motion: Pose, seconds: Option<f64>) {
        (self.motion, self.duration) = (motion, seconds);
    }

    /// Adds how far a prediction was from the outcome, for a point at `radius`.
    pub(crate) fn add_error(&mut self, deviation: &Pose, radius: f64) {
        let moved = deviation.translation.vector.norm() + 2.0 * radius * (0.5 * deviation.rotation.angle()).sin();
        if moved > LEAST_MOTION {
            self.squares = KEEP * self.squares + moved * moved;
            self.weight = KEEP * self.weight + 1.0;
        }
    }
}

/// A share of a motion, at constant velocity.
fn scaled(motion: &Pose, share: f64) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(motion.rotation.scaled_axis() * share);
    Pose::from_parts(Translation3::from(motion.translation.vector * share), rotation)
}
