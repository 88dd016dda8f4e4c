//! The trajectory of a map: where the sensor was at any time between its scans.

use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;

/// Speed may change by this between two scans, metres per square second: a fix between them is less sure along the motion.
const ACCELERATION: f64 = 0.3;
/// Between scans farther apart than this, nobody knows where the sensor was: metres, seconds.
const FARTHEST: (f64, f64) = (20.0, 60.0);

/// Poses of the sensor by time, map frame.
#[derive(Clone, Debug, Default)]
pub struct Track {
    times: Vec<f64>,
    poses: Vec<Pose>,
}

/// Where the sensor was at the time of a fix.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Index of the pose that is nearest in time.
    pub nearest: usize,
    /// Pose of the sensor at the time, in the frame of that pose.
    pub t_nearest_sensor: Pose,
    /// Pose of the sensor at the time, map frame.
    pub t_map_sensor: Pose,
    /// What the interpolation does not know, map frame, square metres.
    pub covariance: Matrix3<f64>,
}

impl Track {
    /// Of poses with times, in any order; times that come again are left out.
    pub fn new(stamped: impl IntoIterator<Item = (f64, Pose)>) -> Self {
        let mut all: Vec<(f64, Pose)> = stamped.into_iter().filter(|(time, _)| time.is_finite()).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.dedup_by(|a, b| a.0 == b.0);
        let (times, poses) = all.into_iter().unzip();
        Self { times, poses }
    }

    /// Times, seconds.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Poses, by time.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Where the sensor was at a time; none before the first scan, after the last one, and in long gaps.
    pub fn at(&self, time: f64) -> Option<Moment> {
        let after = self.times.partition_point(|t| *t < time);
        if self.times.get(after) == Some(&time) {
            let t_map_sensor = self.poses[after];
            return Some(Moment { nearest: after, t_nearest_sensor: Pose::identity(), t_map_sensor, covariance: Matrix3::zeros() });
        }
        let before = after.checked_sub(1)?;
        let (a, b) = (&self.poses[before], self.poses.get(after)?);
        let (since, until) = (time - self.times[before], self.times[after] - time);
        let motion = a.inv_mul(b);
        let step = motion.translation.vector.norm();
        if step > FARTHEST.0 || since + until > FARTHEST.1 {
            return None;
        }
        let t_map_sensor = a * along(&motion, since / (since + until));
        let nearest = if since <= until { before } else { after };
        let unsure = (0.5 * ACCELERATION * since * until).min(0.5 * step);
        let direction = (b.translation.vector - a.translation.vector).try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
        let covariance = direction * direction.transpose() * (unsure * unsure);
        Some(Moment { nearest, t_nearest_sensor: self.poses[nearest].inv_mul(&t_map_sensor), t_map_sensor, covariance })
    }
}

/// A fraction of a motion on its screw: on the arc of a curve, and not on its chord.
fn along(motion: &Pose, fraction: f64) -> Pose {
    let turn = motion.rotation.scaled_axis();
    let Some(whole) = arc(&turn).try_inverse() else { return Pose::identity() };
    let translation = arc(&(turn * fraction)) * (whole * motion.translation.vector) * fraction;
    Pose::from_parts(Translation3::from(translation), UnitQuaternion::from_scaled_axis(turn * fraction))
}

/// What takes the velocity of a constant turn to the way that it goes.
fn arc(turn: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, hat) = (turn.norm(), turn.cross_matrix());
    if angle < 1e-6 {
        return Matrix3::identity() + 0.5 * hat;
    }
    Matrix3::identity() + hat * ((1.0 - angle.cos()) / (angle * angle)) + hat * hat * ((angle - angle.sin()) / angle.powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_on_a_circle_is_on_it_between_scans() {
        let on_circle = |angle: f64| {
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
            Pose::from_parts(Translation3::from(rotation * Vector3::new(0.0, -5.0, 1.0)), rotation)
        };
        let track = Track::new((0..10).map(|k| (f64::from(k), on_circle(0.4 * f64::from(k)))));
        let moment = track.at(3.25).unwrap();
        assert!((moment.t_map_sensor.translation.vector - on_circle(1.3).translation.vector).norm() < 1e-12);
        assert_eq!(moment.nearest, 3);
        assert!((track.poses()[3] * moment.t_nearest_sensor * moment.t_map_sensor.inverse()).translation.vector.norm() < 1e-12);
        // A quarter and three quarters of a second from scans: 0.5 * 0.3 * 0.25 * 0.75 metres along the chord.
        assert!((moment.covariance.trace().sqrt() - 0.028_125).abs() < 1e-9);
        assert!(track.at(-0.1).is_none() && track.at(9.1).is_none() && track.at(9.0).is_some());
        assert!(Track::new([(0.0, Pose::identity()), (10.0, Pose::translation(50.0, 0.0, 0.0))]).at(5.0).is_none());
    }
}
