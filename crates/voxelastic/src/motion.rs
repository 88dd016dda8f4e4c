//! Motion during a sweep (the paper's future work, Sec. VI): where the lidar was when each point was measured.

use crate::Cloud;
use crate::geometry::{Pose, Rigid};

/// Steps that a sweep is cut into at most; within one the lidar counts as standing. A sweep of 0.1 s at 10 m/s moves by half a
/// millimetre in each, and no sensor fires more columns.
const STEPS: usize = 2048;

/// How the lidar moved while a cloud was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Seconds after the cloud's time stamp, ascending.
    times: Vec<f32>,
    /// Pose of the lidar at each time in the lidar frame at the time stamp.
    poses: Vec<Pose>,
}

impl Motion {
    /// A motion through poses of the lidar in its own frame at the cloud's time stamp, each with its time in seconds after the stamp.
    /// `None` unless there are two or more, in ascending order of time, all finite.
    pub fn through(samples: impl IntoIterator<Item = (f32, Pose)>) -> Option<Self> {
        let (times, poses): (Vec<f32>, Vec<Pose>) = samples.into_iter().unzip();
        let is_finite = |pose: &Pose| pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite());
        let ascends = times.windows(2).all(|t| t[0] < t[1]) && times.iter().all(|t| t.is_finite());
        (times.len() > 1 && ascends && poses.iter().all(is_finite)).then_some(Self { times, poses })
    }

    /// Pose of the lidar so many seconds after the time stamp, in the lidar frame at the time stamp; beyond the ends that of the end.
    pub fn at(&self, time: f32) -> Pose {
        let after = self.times.partition_point(|t| *t < time).clamp(1, self.times.len() - 1);
        let (a, b) = (after - 1, after);
        let fraction = f64::from((time - self.times[a]) / (self.times[b] - self.times[a])).clamp(0.0, 1.0);
        let translation = self.poses[a].translation.vector.lerp(&self.poses[b].translation.vector, fraction);
        Pose::from_parts(translation.into(), self.poses[a].rotation.slerp(&self.poses[b].rotation, fraction))
    }

    /// Writes the points of a cloud, each measured in the lidar frame of its own time, in the lidar frame at the time stamp, and where the
    /// lidar was then. False, and nothing is written, if the points have no times or all the same one.
    pub fn undistort(&self, cloud: &Cloud, points: &mut Vec<[f32; 3]>, origins: &mut Vec<[f32; 3]>) -> bool {
        let Some(times) = cloud.time.as_ref().filter(|t| t.len() == cloud.len()) else { return false };
        let finite = || times.iter().zip(&cloud.points).filter(|(t, p)| t.is_finite() && Cloud::is_return(p)).map(|(t, _)| *t);
        let (low, high) = finite().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        if low >= high {
            return false;
        }
        let per_second = STEPS as f32 / (high - low);
        let moves: Vec<Rigid> = (0..STEPS).map(|k| Rigid::from(&self.at(low + (k as f32 + 0.5) / per_second))).collect();
        let pose = |t: &f32| &moves[(((t - low) * per_second).max(0.0) as usize).min(STEPS - 1)];
        points.clear();
        // No return stays what it is: the grid of an organised cloud is kept.
        points.extend(cloud.points.iter().zip(times).map(|(p, t)| if Cloud::is_return(p) { pose(t).apply(*p) } else { *p }));
        origins.clear();
        origins.extend(times.iter().map(|t| pose(t).translation));
        true
    }
}

impl Cloud {
    /// The cloud in the lidar frame at its time stamp, if it is known how the lidar moved and when each point was measured.
    pub fn undistorted(&self) -> Option<Self> {
        let (mut points, mut origins) = (Vec::new(), Vec::new());
        let motion = self.motion.as_ref().filter(|motion| motion.undistort(self, &mut points, &mut origins));
        motion.map(|_| Self { points, motion: None, time: None, ..self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PoseExt;
    use nalgebra::{Point3, Translation3, UnitQuaternion};

    /// 3 m/s along x and 90 degrees a second about z.
    fn riding(t: f64) -> Pose {
        Pose::from_parts(Translation3::new(3.0 * t, 0.0, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, t * std::f64::consts::FRAC_PI_2))
    }

    #[test]
    fn a_standing_wall_stands() {
        let motion = Motion::through((0..=10).map(|k| (k as f32 * 0.01, riding(0.01 * f64::from(k))))).unwrap();
        // The same corner of the world, measured at many times of the sweep.
        let corner = Point3::new(8.0, -3.0, 1.0);
        let times: Vec<f32> = (0..1000).map(|k| k as f32 * 1e-4).collect();
        let seen = |t: &f32| riding(f64::from(*t)).inverse() * corner;
        let mut cloud = Cloud::from_points(times.iter().map(seen).map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect());
        cloud.points[500] = [f32::NAN; 3];
        cloud.time = Some(times);
        cloud.motion = Some(motion);
        let still = cloud.undistorted().unwrap();
        let off = |p: &[f32; 3]| (0..3).map(|k| f64::from(p[k]) - corner[k]).map(|d| d * d).sum::<f64>().sqrt();
        let worst = still.points.iter().filter(|p| Cloud::is_return(p)).map(off).fold(0.0, f64::max);
        assert!(worst < 4e-4, "{worst} m");
        assert!(off(&cloud.points[999]) > 1.0 && still.points[500][0].is_nan() && still.undistorted().is_none());
    }

    #[test]
    fn a_motion_needs_two_poses_in_order() {
        let pose = Pose::identity();
        assert!(Motion::through([(0.0, pose)]).is_none() && Motion::through([(0.1, pose), (0.0, pose)]).is_none());
        assert!(Motion::through([(0.0, pose), (f32::NAN, pose)]).is_none());
        let motion = Motion::through([(0.0, pose), (0.1, riding(0.1))]).unwrap();
        assert!((motion.at(0.05).translation.x - 0.15).abs() < 1e-6);
        for (time, end) in [(-1.0, pose), (9.0, riding(0.1))] {
            let at = motion.at(time);
            assert!(at.translation_distance(&end) < 1e-9 && at.rotation_distance(&end) < 1e-6, "ends stay: {at:?}");
        }
        // Without times, or with one for all, there is nothing to do.
        let mut cloud = Cloud { motion: Some(motion), ..Cloud::from_points(vec![[1.0, 0.0, 0.0]; 3]) };
        assert!(cloud.undistorted().is_none());
        cloud.time = Some(vec![0.05; 3]);
        assert!(cloud.undistorted().is_none());
    }
}
