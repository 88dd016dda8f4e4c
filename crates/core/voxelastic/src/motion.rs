//! How the sensor moved during a sweep (the paper's future work, Sec. VI), and samples of inertial measurement units.

use crate::geometry::stored::StoredPose;
use crate::geometry::{Pose, Rigid};
use serde::{Deserialize, Serialize};

/// Number of steps into which a sweep is divided; the pose is constant within a step. A sweep of 0.1 s at 10 m/s moves by half a millimetre
/// per step, and no sensor fires more columns.
const STEPS: usize = 2048;

/// One sample of an inertial measurement unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImuSample {
    /// Seconds, on the clock of the scans.
    pub time: f64,
    /// Angular velocity about the axes of the frame it is given in, radians per second.
    pub angular_velocity: [f64; 3],
    /// Specific force along the axes of that frame, metres per square second: at rest it is 9.8 upwards.
    pub acceleration: [f64; 3],
}

/// The motion of the lidar during a sweep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "StoredMotion", try_from = "StoredMotion")]
pub struct Motion {
    /// Seconds after the cloud's time stamp, ascending.
    times: Vec<f32>,
    /// Pose of the lidar at each time, in the lidar frame at the time stamp.
    poses: Vec<Pose>,
}

/// The serialised form: the samples.
#[derive(Serialize, Deserialize)]
struct StoredMotion(Vec<(f32, StoredPose)>);

impl From<Motion> for StoredMotion {
    fn from(motion: Motion) -> Self {
        Self(motion.times.into_iter().zip(motion.poses.into_iter().map(StoredPose)).collect())
    }
}

impl TryFrom<StoredMotion> for Motion {
    type Error = &'static str;

    fn try_from(stored: StoredMotion) -> Result<Self, Self::Error> {
        Self::through(stored.0.into_iter().map(|(time, StoredPose(pose))| (time, pose))).ok_or("a motion needs two poses in ascending order of time")
    }
}

impl Motion {
    /// A motion through poses of the lidar, each with its time in seconds after the cloud's time stamp, in the lidar frame at that stamp.
    /// `None` unless there are two or more, in ascending order of time, all finite.
    pub fn through(samples: impl IntoIterator<Item = (f32, Pose)>) -> Option<Self> {
        let (times, poses): (Vec<f32>, Vec<Pose>) = samples.into_iter().unzip();
        let is_finite = |pose: &Pose| pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite());
        let ascends = times.windows(2).all(|t| t[0] < t[1]) && times.iter().all(|t| t.is_finite());
        (times.len() > 1 && ascends && poses.iter().all(is_finite)).then_some(Self { times, poses })
    }

    /// Pose of the lidar `time` seconds after the time stamp, in the lidar frame at the time stamp. Before the first and after the last sample it is
    /// that sample's pose.
    pub fn at(&self, time: f32) -> Pose {
        let after = self.times.partition_point(|t| *t < time).clamp(1, self.times.len() - 1);
        let (a, b) = (after - 1, after);
        let fraction = f64::from((time - self.times[a]) / (self.times[b] - self.times[a])).clamp(0.0, 1.0);
        let translation = self.poses[a].translation.vector.lerp(&self.poses[b].translation.vector, fraction);
        Pose::from_parts(translation.into(), self.poses[a].rotation.slerp(&self.poses[b].rotation, fraction))
    }

    /// The motion between two times as a table of poses that are cheap to apply.
    pub(crate) fn sampled(&self, from: f32, to: f32) -> SampledMotion {
        let per_second = STEPS as f32 / (to - from);
        let poses = (0..STEPS).map(|k| Rigid::from(&self.at(from + (k as f32 + 0.5) / per_second))).collect();
        SampledMotion { from, per_second, poses }
    }
}

/// A [`Motion`] at evenly spaced times.
pub(crate) struct SampledMotion {
    from: f32,
    per_second: f32,
    poses: Vec<Rigid>,
}

impl SampledMotion {
    /// Pose of the lidar at the step nearest to `time`.
    pub(crate) fn pose(&self, time: f32) -> &Rigid {
        &self.poses[(((time - self.from) * self.per_second).max(0.0) as usize).min(STEPS - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PoseExt;
    use nalgebra::{Translation3, UnitQuaternion};

    #[test]
    fn a_motion_needs_two_poses_in_order() {
        let pose = Pose::identity();
        assert!(Motion::through([(0.0, pose)]).is_none() && Motion::through([(0.1, pose), (0.0, pose)]).is_none());
        assert!(Motion::through([(0.0, pose), (f32::NAN, pose)]).is_none());
        let moved = Pose::from_parts(Translation3::new(0.3, 0.0, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, 0.15));
        let motion = Motion::through([(0.0, pose), (0.1, moved)]).unwrap();
        assert!((motion.at(0.05).translation.x - 0.15).abs() < 1e-6);
        for (time, end) in [(-1.0, pose), (9.0, moved)] {
            let at = motion.at(time);
            assert!(at.translation_distance(&end) < 1e-9 && at.rotation_distance(&end) < 1e-6, "the ends are constant: {at:?}");
        }
    }
}
