//! The frames that messages are in, for those who publish poses of the map.

use crate::motion::TransformTree;
use crate::playback::PlaybackLog;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// The pose that a scan came with, before any correction.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Reported {
    /// The scan's node.
    pub node: NodeId,
    /// Time stamp of the scan, seconds.
    pub time: f64,
    /// Pose of the lidar in the frame that the poses came in.
    pub t_odom_lidar: Pose,
}

/// What is known about frames so far; shared with the thread that reads messages.
#[derive(Clone, Debug, Default)]
pub struct LiveFrames {
    names: Arc<Mutex<Names>>,
    log: Arc<PlaybackLog>,
}

#[derive(Debug, Default)]
struct Names {
    /// Of the clouds.
    lidar: Option<String>,
    /// That the poses of a topic are in.
    poses: Option<String>,
    tree: TransformTree,
    /// Of a simulation, seconds.
    clock: Option<f64>,
}

impl LiveFrames {
    pub(super) fn new(log: Arc<PlaybackLog>) -> Self {
        Self { names: Arc::default(), log }
    }

    fn names(&self) -> MutexGuard<'_, Names> {
        self.names.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn set_lidar(&self, frame: &str) {
        let mut names = self.names();
        if names.lidar.as_deref() != Some(frame) {
            names.lidar = Some(frame.to_owned());
        }
    }

    pub(super) fn set_poses(&self, parent: &str) {
        let mut names = self.names();
        if names.poses.as_deref() != Some(parent) {
            names.poses = Some(parent.to_owned());
        }
    }

    pub(super) fn add_transform(&self, [parent, child]: [&str; 2], pose: Pose, is_fixed: bool) {
        // Of moving links only the names are needed.
        self.names().tree.add(parent, child, 0.0, pose, is_fixed);
    }

    pub(super) fn set_clock(&self, time: f64) {
        self.names().clock = Some(time);
    }

    /// The time of the simulation, seconds; none without one.
    pub fn clock(&self) -> Option<f64> {
        self.names().clock
    }

    /// Pose of `frame` in the frame of the clouds, through fixed transforms.
    pub(super) fn beside_lidar(&self, frame: &str) -> Option<Pose> {
        let names = self.names();
        let lidar = names.lidar.as_deref()?;
        if lidar == frame { Some(Pose::identity()) } else { names.tree.fixed(lidar, frame) }
    }

    /// The frame of the clouds, once one has come.
    pub fn lidar(&self) -> Option<String> {
        self.names().lidar.clone()
    }

    /// The frame that the poses are in: that of the topic, else the root of the transform tree.
    pub fn odom(&self) -> Option<String> {
        let names = self.names();
        names.poses.clone().or_else(|| {
            let lidar = names.lidar.as_deref()?;
            names.tree.moves(lidar).then(|| names.tree.ancestors(lidar).last().map(|root| (*root).to_owned()))?
        })
    }

    /// The frame of the robot, and its pose in the frame of the clouds: the end of the chain of fixed transforms from the lidar.
    pub fn base(&self) -> Option<(String, Pose)> {
        let names = self.names();
        let lidar = names.lidar.as_deref()?;
        let fixed = names.tree.ancestors(lidar).into_iter().map_while(|frame| Some((frame.to_owned(), names.tree.fixed(lidar, frame)?)));
        fixed.last().or_else(|| Some((lidar.to_owned(), Pose::identity())))
    }

    /// The pose that the last scan came with; none where poses are estimated.
    pub fn reported(&self) -> Option<Reported> {
        let reported = self.log.reported()?;
        Some(Reported { node: reported.node, time: reported.time, t_odom_lidar: reported.t_odom_lidar })
    }

    /// Scans of which is kept how they could be read again.
    #[cfg(test)]
    pub(super) fn kept(&self) -> usize {
        self.log.kept()
    }

    /// Scans without a pose so far.
    pub fn without_pose(&self) -> usize {
        self.log.without_pose.load(std::sync::atomic::Ordering::Relaxed)
    }
}
