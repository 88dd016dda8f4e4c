//! Scans of further sensors: odometry registers those of the first sensor, and these have its poses at their own times.

use crate::raw_scan::RawScan;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::motion::Motion;

/// Poses are interpolated only between such that are this near in time, seconds.
const LONGEST_GAP_S: f64 = 0.35;
/// Times that differ by no more than this are equal, seconds.
const SAME_TIME_S: f64 = 1e-4;
/// Interval at which the motion during a sweep is sampled, seconds, and the largest number of samples.
const STEP_S: f32 = 0.005;
const MOST_STEPS: usize = 200;
/// Poses of the first sensor that are kept: those around the scans that wait.
const KEPT: usize = 16;

/// A pose of the first sensor.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct TimedPose {
    time: f64,
    /// Number of the piece of the trajectory.
    piece: usize,
    #[serde(with = "voxelastic::geometry::stored")]
    t_map_first: Pose,
}

/// A scan of a further sensor whose pose is known.
#[derive(Debug)]
pub(crate) struct FollowingScan {
    /// With the motion of its sensor during the sweep, where points have times.
    pub(crate) scan: RawScan,
    pub(crate) t_map_lidar: Pose,
    pub(crate) piece: usize,
}

/// Scans of further sensors that wait for poses of the first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Followers {
    /// Pose of each further sensor in the frame of the first.
    t_first_sensor: Vec<Pose>,
    track: VecDeque<TimedPose>,
    waiting: Vec<RawScan>,
}

impl Followers {
    pub(crate) fn new(t_first_sensor: Vec<Pose>) -> Self {
        Self { t_first_sensor, ..Self::default() }
    }

    /// The poses that it knows; none while scans wait.
    pub(crate) fn state(&self) -> Option<Vec<TimedPose>> {
        self.waiting.is_empty().then(|| self.track.iter().copied().collect())
    }

    /// Goes on with known poses.
    pub(crate) fn resume(&mut self, track: Vec<TimedPose>) {
        self.track = track.into();
    }

    /// Adds the pose of a scan of the first sensor.
    pub(crate) fn add_pose(&mut self, time: f64, piece: usize, t_map_first: &Pose) {
        if self.t_first_sensor.is_empty() || !time.is_finite() {
            return;
        }
        if self.track.len() == KEPT {
            self.track.pop_front();
        }
        self.track.push_back(TimedPose { time, piece, t_map_first: *t_map_first });
    }

    /// Adds a scan of a further sensor.
    pub(crate) fn wait(&mut self, scan: RawScan) {
        self.waiting.push(scan);
    }

    /// The scans that wait no longer, as the first sensor has a pose after them; and those of which it has none before them, or too long before.
    pub(crate) fn take_due(&mut self) -> (Vec<FollowingScan>, Vec<NodeId>) {
        let newest = self.track.back().map_or(f64::NEG_INFINITY, |pose| pose.time + SAME_TIME_S);
        let (due, waiting) = std::mem::take(&mut self.waiting).into_iter().partition(|scan| scan.time <= newest);
        self.waiting = waiting;
        let (mut following, mut without_pose) = (Vec::new(), Vec::new());
        for scan in due {
            match self.following(scan) {
                Ok(scan) => following.push(scan),
                Err(node) => without_pose.push(node),
            }
        }
        (following, without_pose)
    }

    /// The scans that still wait at the end: no pose came after them.
    pub(crate) fn finish(&mut self) -> Vec<NodeId> {
        std::mem::take(&mut self.waiting).into_iter().map(|scan| scan.node).collect()
    }

    fn following(&self, mut scan: RawScan) -> Result<FollowingScan, NodeId> {
        let node = scan.node;
        let t_first_lidar = usize::from(scan.cloud.sensor).checked_sub(1).and_then(|k| self.t_first_sensor.get(k)).copied().ok_or(node)?;
        let (t_map_first, piece) = self.pose_at(scan.time).ok_or(node)?;
        let t_map_lidar = t_map_first * t_first_lidar;
        if scan.cloud.motion.is_none() {
            scan.cloud.motion = self.motion(&scan, piece, &t_map_lidar, &t_first_lidar);
        }
        Ok(FollowingScan { scan, t_map_lidar, piece })
    }

    /// The pose of the first sensor at a time that is not after the last pose, and the piece of its trajectory.
    fn pose_at(&self, time: f64) -> Option<(Pose, usize)> {
        let is_same = |pose: &&TimedPose| (pose.time - time).abs() <= SAME_TIME_S;
        if let Some(pose) = self.track.iter().find(is_same) {
            return Some((pose.t_map_first, pose.piece));
        }
        let after = self.track.iter().position(|pose| pose.time >= time)?;
        let (a, b) = (self.track.get(after.checked_sub(1)?)?, self.track.get(after)?);
        Some((between(a, b, time)?, a.piece))
    }

    /// The motion of a sensor during a sweep, sampled; beyond the last pose, and before the first, as between the two next to it.
    fn motion(&self, scan: &RawScan, piece: usize, t_map_lidar: &Pose, t_first_lidar: &Pose) -> Option<Motion> {
        let times = scan.cloud.time.as_ref().filter(|times| times.len() == scan.cloud.len())?.iter().filter(|t| t.is_finite());
        let (low, high) = times.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(*t), high.max(*t)));
        if low >= high {
            return None;
        }
        let track: Vec<&TimedPose> = self.track.iter().filter(|pose| pose.piece == piece).collect();
        let pose_at = |time: f64| {
            let after = track.partition_point(|pose| pose.time < time).clamp(1, track.len().max(2) - 1);
            between(track.get(after - 1)?, track.get(after)?, time)
        };
        let count = (((high - low) / STEP_S).ceil() as usize).clamp(1, MOST_STEPS);
        let samples: Option<Vec<(f32, Pose)>> = (0..=count)
            .map(|k| low + (high - low) * k as f32 / count as f32)
            .map(|t| Some((t, t_map_lidar.inv_mul(&(pose_at(scan.time + f64::from(t))? * t_first_lidar)))))
            .collect();
        Motion::through(samples?)
    }
}

/// The pose at a time by two poses of one piece; none if they are of two, or too far apart.
fn between(a: &TimedPose, b: &TimedPose, time: f64) -> Option<Pose> {
    let gap = b.time - a.time;
    if a.piece != b.piece || gap > LONGEST_GAP_S || gap <= 0.0 {
        return None;
    }
    let fraction = (time - a.time) / gap;
    let translation = a.t_map_first.translation.vector.lerp(&b.t_map_first.translation.vector, fraction);
    Some(Pose::from_parts(translation.into(), a.t_map_first.rotation.try_slerp(&b.t_map_first.rotation, fraction, 1e-9)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use voxelastic::Cloud;
    use voxelastic::geometry::PoseExt;

    /// A first sensor that drives a curve at constant speed.
    fn first_at(time: f64) -> Pose {
        let turn = 0.4 * time;
        Pose::new(Vector3::new(20.0 * turn.sin(), 20.0 * (1.0 - turn.cos()), 0.0), Vector3::z() * turn)
    }

    fn mount() -> Pose {
        Pose::new(Vector3::new(-0.5, 0.2, 0.1), Vector3::new(0.1, 0.0, 1.5))
    }

    fn scan(node: NodeId, time: f64, sensor: u16) -> RawScan {
        let cloud = Cloud { time: Some(vec![-0.05, 0.05]), sensor, ..Cloud::from_points(vec![[3.0, 0.0, 0.0], [0.0, 3.0, 0.0]]) };
        RawScan { node, time, cloud, imu: Vec::new() }
    }

    fn close(a: &Pose, b: &Pose) -> bool {
        a.translation_distance(b) < 0.01 && a.rotation_distance(b) < 1e-3
    }

    #[test]
    fn scans_have_the_poses_of_the_first_sensor_at_their_own_times() {
        let mut followers = Followers::new(vec![mount()]);
        for k in 0..5u32 {
            followers.wait(scan(NodeId::from(k), 0.1 * f64::from(k) + 0.03, 1));
            followers.add_pose(0.1 * f64::from(k), 0, &first_at(0.1 * f64::from(k)));
            let (due, without_pose) = followers.take_due();
            assert!(without_pose.is_empty() && due.len() == usize::from(k > 0), "{k}");
            for FollowingScan { scan, t_map_lidar, piece } in due {
                assert!(piece == 0 && close(&t_map_lidar, &(first_at(scan.time) * mount())), "{k}");
                let motion = scan.cloud.motion.as_ref().unwrap();
                for t in [-0.05, 0.05] {
                    assert!(close(&(t_map_lidar * motion.at(t)), &(first_at(scan.time + f64::from(t)) * mount())), "{k} {t}");
                }
            }
            assert!(followers.state().is_none());
        }
        assert_eq!(followers.finish(), [4]);
        assert_eq!(followers.state().map(|track| track.len()), Some(5));
    }

    #[test]
    fn scans_between_pieces_in_gaps_and_of_unknown_sensors_have_none() {
        let mut followers = Followers::new(vec![mount()]);
        for (time, piece) in [(0.0, 0), (0.1, 0), (0.2, 1), (0.3, 1), (0.8, 1)] {
            followers.add_pose(time, piece, &first_at(time));
        }
        for (node, time, sensor) in [(0, -0.05, 1), (1, 0.05, 1), (2, 0.15, 1), (3, 0.2, 1), (4, 0.5, 1), (5, 0.05, 2), (6, 0.8, 1)] {
            followers.wait(scan(node, time, sensor));
        }
        let (due, without_pose) = followers.take_due();
        assert_eq!(due.iter().map(|due| (due.scan.node, due.piece)).collect::<Vec<_>>(), [(1, 0), (3, 1), (6, 1)]);
        assert_eq!(without_pose, [0, 2, 4, 5]);
    }
}
