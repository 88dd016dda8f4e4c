//! Poses of the lidar at the times of images.

use nalgebra::Translation3;
use voxelastic::Pose;

/// Poses are not interpolated over longer gaps than this, seconds, unless the lidar has hardly moved.
pub const LONGEST_GAP_S: f64 = 3.0;
/// So far it may have moved then: metres, radians.
const RESTING: (f64, f64) = (0.05, 0.02);

/// Poses by time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseTrack {
    poses: Vec<(f64, Pose)>,
    motion: Vec<(f64, Pose)>,
}

impl PoseTrack {
    /// A track of poses with their times in seconds, in any order. Of several at one time the first is kept.
    pub fn new(poses: Vec<(f64, Pose)>) -> Self {
        Self { poses: sorted(poses), motion: Vec::new() }
    }

    /// The same track, with what lies between its poses taken from `motion`: poses of the same lidar in any frame, closer in time, such as those of
    /// odometry. Its drift does not matter: only motion from one pose of the track to the next is used.
    #[must_use]
    pub fn with_motion(self, motion: Vec<(f64, Pose)>) -> Self {
        Self { motion: sorted(motion), ..self }
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Times of the first and the last pose.
    pub fn span(&self) -> Option<[f64; 2]> {
        Some([self.poses.first()?.0, self.poses.last()?.0])
    }

    /// The pose at a time: between two poses, by the motion in between if it is known there, else interpolated. `None` before the first pose, after the
    /// last, and in gaps.
    pub fn at(&self, time: f64) -> Option<Pose> {
        let after = self.poses.partition_point(|(t, _)| *t < time);
        let (b_time, b) = self.poses.get(after)?;
        if *b_time == time {
            return Some(*b);
        }
        let (a_time, a) = &self.poses[after.checked_sub(1)?];
        let fraction = (time - a_time) / (b_time - a_time);
        if let (Some(m_a), Some(m), Some(m_b)) = (within(&self.motion, *a_time), within(&self.motion, time), within(&self.motion, *b_time)) {
            // From both ends, so that it is continuous at both.
            return between(&(a * m_a.inv_mul(&m)), &(b * m_b.inv_mul(&m)), fraction);
        }
        let is_at_rest = (a.translation.vector - b.translation.vector).norm() < RESTING.0 && a.rotation.angle_to(&b.rotation) < RESTING.1;
        if b_time - a_time > LONGEST_GAP_S && !is_at_rest { None } else { between(a, b, fraction) }
    }
}

fn sorted(mut poses: Vec<(f64, Pose)>) -> Vec<(f64, Pose)> {
    poses.retain(|(time, _)| time.is_finite());
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    poses.dedup_by(|next, kept| next.0 == kept.0);
    poses
}

/// The pose of a dense track at a time.
fn within(track: &[(f64, Pose)], time: f64) -> Option<Pose> {
    let after = track.partition_point(|(t, _)| *t < time);
    let (b_time, b) = track.get(after)?;
    if *b_time == time {
        return Some(*b);
    }
    let (a_time, a) = &track[after.checked_sub(1)?];
    if b_time - a_time > LONGEST_GAP_S { None } else { between(a, b, (time - a_time) / (b_time - a_time)) }
}

/// Interpolates; `None` if the rotations are opposite.
fn between(a: &Pose, b: &Pose, fraction: f64) -> Option<Pose> {
    let translation = Translation3::from(a.translation.vector.lerp(&b.translation.vector, fraction));
    Some(Pose::from_parts(translation, a.rotation.try_slerp(&b.rotation, fraction, 1e-9)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn x(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    #[test]
    fn poses_are_interpolated_within_the_track_only() {
        let track = PoseTrack::new(vec![(3.0, x(3.0)), (1.0, x(1.0)), (2.0, x(2.0)), (20.0, x(3.0)), (30.0, x(9.0)), (f64::NAN, x(0.0))]);
        let at = |t| track.at(t).map(|p| p.translation.x);
        assert_eq!((track.len(), track.span()), (5, Some([1.0, 30.0])));
        assert!((at(2.25).unwrap() - 2.25).abs() < 1e-12);
        assert_eq!((at(1.0), at(0.99), at(30.1)), (Some(1.0), None, None));
        assert_eq!((at(10.0), at(25.0)), (Some(3.0), None), "at rest, and in a gap");
        assert_eq!(PoseTrack::default().at(1.0), None);
    }

    #[test]
    fn motion_fills_what_lies_between_and_its_drift_does_not_matter() {
        // Odometry in a frame of its own that drifts by a tenth; between the two poses it goes forth by 4 m and back by 2.
        let odometry: Vec<(f64, Pose)> =
            (0..=100).map(|k| f64::from(k) * 0.1).map(|t| (t, x(50.0 + 1.1 * if t < 5.0 { 0.8 * t } else { 4.0 - 0.4 * (t - 5.0) }))).collect();
        let track = PoseTrack::new(vec![(0.0, x(0.0)), (10.0, x(2.0))]).with_motion(odometry);
        let at = |t| track.at(t).unwrap().translation.x;
        assert!((at(5.0) - 4.3).abs() < 1e-9, "{}", at(5.0));
        assert!((at(10.0 - 1e-9) - 2.0).abs() < 1e-6 && at(1e-9).abs() < 1e-6);
    }
}
