//! Where up is in the map, by an inertial unit over some seconds.
//!
//! The specific force that a unit measures, turned into the map frame and summed over a time, is the change of the velocity and what holds the unit against
//! gravity. The odometry knows the velocities at both ends, so the rest is gravity: an error of 0.1 m/s at the ends of ten seconds turns it by 2 mrad.

use super::inertial::GRAVITY;
use super::level::Level;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use voxelastic::geometry::stored::StoredVector;

/// Time over which forces are summed, seconds.
const WINDOW: f64 = 10.0;
/// Standard deviation of an outcome, radians: mostly the bias of usual accelerometers, 0.05 metres per square second.
pub(crate) const SIGMA: f64 = 6e-3;
/// What is measured as gravity differs from it by at most this share.
const MOST_OFF: f64 = 0.03;

/// Where up is, as it was measured over the last seconds and as it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct MeasuredVertical {
    /// As measured, in the map frame with the odometry's errors up to here, a unit vector.
    pub measured: Vector3<f64>,
    /// In the map frame of the first scan: z if that is level by gravity, else what was measured first.
    pub expected: Vector3<f64>,
}

/// Sums forces until they say where up is.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct VerticalEstimator {
    begun: Option<Window>,
    first: Option<StoredVector>,
}

/// A time that began in the middle between two scans.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Window {
    /// At its beginning, map frame.
    velocity: StoredVector,
    /// Sum of the specific force over the time, map frame, metres per second.
    impulse: StoredVector,
    seconds: f64,
    /// Time of the last scan, seconds.
    until: f64,
}

/// What happened from one scan to the next, in the map frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interval {
    /// Times of the scans, seconds.
    pub(crate) times: [f64; 2],
    /// Sum of the specific force, metres per second.
    pub(crate) impulse: Vector3<f64>,
    pub(crate) moved: Vector3<f64>,
}

impl VerticalEstimator {
    /// Adds an interval; one that does not follow the last begins a new time. Returns where up is, where a time is complete and what was measured is gravity.
    pub(crate) fn add(&mut self, interval: &Interval, level: Level) -> Option<MeasuredVertical> {
        let measured = self.sum(interval)?;
        let first = Vector3::from(*self.first.get_or_insert(measured.into()));
        Some(MeasuredVertical { measured, expected: if level == Level::Gravity { Vector3::z() } else { first } })
    }

    fn sum(&mut self, Interval { times: [from, to], impulse, moved }: &Interval) -> Option<Vector3<f64>> {
        let seconds = to - from;
        // The mean velocity of an interval is that in its middle.
        let velocity = moved / seconds;
        let next = Window { velocity: velocity.into(), impulse: (0.5 * impulse).into(), seconds: 0.5 * seconds, until: *to };
        let Some(window) = self.begun.as_mut().filter(|window| window.until == *from) else {
            self.begun = Some(next);
            return None;
        };
        let so_far: Vector3<f64> = window.impulse.into();
        if window.seconds + 0.5 * seconds < WINDOW {
            (window.impulse, window.seconds, window.until) = ((so_far + impulse).into(), window.seconds + seconds, *to);
            return None;
        }
        let (all, time) = (so_far + 0.5 * impulse, window.seconds + 0.5 * seconds);
        let rest = (all - (velocity - Vector3::from(window.velocity))) / time;
        self.begun = Some(next);
        ((rest.norm() - GRAVITY).abs() < MOST_OFF * GRAVITY).then(|| rest.normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(mut interval: impl FnMut(u32) -> Interval) -> Vec<MeasuredVertical> {
        let mut estimator = VerticalEstimator::default();
        (0..1000).filter_map(|k| estimator.add(&interval(k), Level::Unknown)).collect()
    }

    const STEP: f64 = 0.05;

    fn times(k: u32) -> [f64; 2] {
        [STEP * f64::from(k), STEP * f64::from(k + 1)]
    }

    #[test]
    fn up_is_what_is_left_of_the_force_when_the_motion_is_taken_away() {
        let up = Vector3::new(0.1, -0.05, 1.0).normalize();
        // Back and forth with strong accelerations.
        let position = |t: f64| Vector3::new((1.3 * t).sin(), 0.5 * (0.7 * t).cos(), 0.1 * (3.0 * t).sin());
        let velocity = |t: f64| (position(t + 1e-4) - position(t - 1e-4)) / 2e-4;
        let found = found(|k| {
            let [from, to] = times(k);
            Interval { times: [from, to], impulse: velocity(to) - velocity(from) + up * (GRAVITY * STEP), moved: position(to) - position(from) }
        });
        assert_eq!(found.len(), 4);
        assert!(found.iter().all(|f| f.measured.angle(&up) < 1e-3 && f.expected == found[0].measured), "{found:?}");
    }

    #[test]
    fn nothing_is_said_of_forces_that_are_not_gravity_and_across_gaps() {
        let still = |times, force: f64| Interval { times, impulse: Vector3::z() * STEP * force, moved: Vector3::zeros() };
        assert!(found(|k| still(times(k), 5.0)).is_empty());
        let later = |[from, to]: [f64; 2], k: u32| [from + f64::from(k / 150), to + f64::from(k / 150)];
        assert!(found(|k| still(later(times(k), k), GRAVITY)).is_empty());
        assert_eq!(found(|k| still(times(k), GRAVITY)).len(), 4);
    }
}
