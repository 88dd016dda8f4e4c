//! Samples of an inertial measurement unit, and the rotation that follows from them.

use nalgebra::{UnitQuaternion, Vector3};
use std::collections::VecDeque;

/// Longest gap between samples that is bridged, seconds.
const LONGEST_GAP: f64 = 0.1;
/// Samples older than this before the newest are dropped, seconds.
const HISTORY: f64 = 5.0;

/// One sample of an inertial measurement unit, with axes turned into the lidar's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Seconds, on the clock of the scans.
    pub time: f64,
    /// Angular velocity, radians per second.
    pub angular_velocity: [f64; 3],
    /// Specific force, metres per square second.
    pub acceleration: [f64; 3],
}

/// The samples of the last seconds.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gyro {
    samples: VecDeque<ImuSample>,
}

impl Gyro {
    /// Adds a sample. Those that are not finite or not newer than the last are dropped.
    pub(crate) fn add(&mut self, sample: ImuSample) {
        let is_newer = self.samples.back().is_none_or(|last| sample.time > last.time);
        if is_newer && sample.time.is_finite() && sample.angular_velocity.iter().all(|v| v.is_finite()) {
            self.samples.push_back(sample);
        }
        while self.samples.front().zip(self.samples.back()).is_some_and(|(first, last)| first.time < last.time - HISTORY) {
            self.samples.pop_front();
        }
    }

    /// Rotation from the frame at `from` to that at `to`, if samples cover the interval without gaps.
    pub(crate) fn rotation(&self, from: f64, to: f64) -> Option<UnitQuaternion<f64>> {
        let (from, to, is_backward) = if from <= to { (from, to, false) } else { (to, from, true) };
        let first = self.samples.partition_point(|s| s.time <= from).checked_sub(1)?;
        let mut rotation = UnitQuaternion::identity();
        let mut time = from;
        for pair in self.samples.range(first..).zip(self.samples.range(first + 1..)) {
            let (a, b) = pair;
            if b.time - a.time > LONGEST_GAP {
                return None;
            }
            let end = b.time.min(to);
            let mean = (Vector3::from(a.angular_velocity) + Vector3::from(b.angular_velocity)) * 0.5;
            rotation *= UnitQuaternion::from_scaled_axis(mean * (end - time));
            time = end;
            if time >= to {
                return Some(if is_backward { rotation.inverse() } else { rotation });
            }
        }
        (to <= from).then_some(rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_rate_is_integrated_and_gaps_are_refused() {
        let mut gyro = Gyro::default();
        for k in 0..=100 {
            gyro.add(ImuSample { time: 0.01 * f64::from(k), angular_velocity: [0.0, 0.0, 2.0], acceleration: [0.0, 0.0, 9.8] });
        }
        let rotation = gyro.rotation(0.123, 0.623).unwrap();
        assert!((rotation.scaled_axis() - Vector3::new(0.0, 0.0, 1.0)).norm() < 1e-9);
        assert!((gyro.rotation(0.6, 0.5).unwrap().scaled_axis().z + 0.2).abs() < 1e-9);
        assert!(gyro.rotation(0.9, 1.2).is_none() && gyro.rotation(-0.1, 0.2).is_none());
        gyro.add(ImuSample { time: 2.0, angular_velocity: [0.0; 3], acceleration: [0.0; 3] });
        assert!(gyro.rotation(0.9, 1.5).is_none());
    }
}
