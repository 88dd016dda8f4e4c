//! The lidar's pose at a time, from any of the sources of poses that recordings have.

use super::message_stream::SensorMessage;
use crate::motion::{LONGEST_GAP_S, PoseTrack, TransformTree};
use voxelastic::Pose;

/// Where the poses come from.
pub(crate) enum PoseSource {
    /// From a file: all are known from the start.
    File(PoseTrack),
    /// From messages of a topic, with the frame of the last one.
    Topic { track: PoseTrack, child: String },
    /// From the transform tree.
    Transforms,
}

/// Collects poses and transforms as they arrive and gives the lidar's pose.
pub(crate) struct PoseLookup {
    source: PoseSource,
    tree: TransformTree,
    /// Pose of the lidar in the vehicle's frame, if the user gave it.
    t_base_lidar: Option<Pose>,
    /// Pose of the lidar in the frame of the poses, once it is known.
    t_child_lidar: Option<Pose>,
    /// How far in time a pose may be from its scan, seconds.
    tolerance_s: f64,
}

impl PoseLookup {
    pub(crate) fn new(source: PoseSource, t_base_lidar: Option<Pose>, tolerance_s: f64) -> Self {
        Self { source, tree: TransformTree::default(), t_base_lidar, t_child_lidar: None, tolerance_s }
    }

    /// Adds a pose or transform; other messages are ignored.
    pub(super) fn add(&mut self, message: SensorMessage) {
        match message {
            SensorMessage::Transform { time, parent, child, pose, is_fixed } => self.tree.add(&parent, &child, time, pose, is_fixed),
            SensorMessage::Pose { time, child: frame, pose, .. } => {
                if let PoseSource::Topic { track, child } = &mut self.source {
                    track.add(time, pose);
                    *child = frame;
                }
            }
            SensorMessage::ClockJump => self.forget(),
            SensorMessage::Cloud(_) | SensorMessage::Corrected(_) | SensorMessage::Imu(_) | SensorMessage::Other => {}
        }
    }

    /// Forgets all poses; fixed transforms stay.
    fn forget(&mut self) {
        self.tree.remove_moving();
        if let PoseSource::Topic { track, .. } = &mut self.source {
            *track = PoseTrack::default();
        }
    }

    /// Time up to which the poses of `frame` are known; `None` if there are none yet.
    pub(super) fn known_until(&self, frame: &str) -> Option<f64> {
        match &self.source {
            PoseSource::File(_) => Some(f64::INFINITY),
            PoseSource::Topic { track, .. } => track.newest(),
            PoseSource::Transforms => self.tree.newest(frame),
        }
    }

    /// Pose of the lidar, whose frame is `frame`, at a time.
    pub(super) fn pose_at(&mut self, time: f64, frame: &str) -> Option<Pose> {
        let tolerance = self.tolerance_s;
        let (pose, child) = match &self.source {
            PoseSource::Transforms => return self.tree.in_root(frame, time, tolerance),
            PoseSource::File(track) => (track.at(time, LONGEST_GAP_S, tolerance)?, ""),
            PoseSource::Topic { track, child } => (track.at(time, LONGEST_GAP_S, tolerance)?, child.as_str()),
        };
        let t_child_lidar = *self.t_child_lidar.get_or_insert_with(|| mounting(&self.tree, child, frame, self.t_base_lidar));
        Some(pose * t_child_lidar)
    }

    /// Pose of the lidar in the frame that a file of corrected poses refers to. With a transform tree that frame is unknown: the lidar's own
    /// is assumed.
    pub(super) fn t_child_lidar(&self) -> Pose {
        self.t_child_lidar.or(self.t_base_lidar).unwrap_or_default()
    }

    /// Removes poses older than `time`.
    pub(super) fn remove_before(&mut self, time: f64) {
        self.tree.remove_before(time);
        if let PoseSource::Topic { track, .. } = &mut self.source {
            track.remove_before(time);
        }
    }
}

/// Pose of the lidar in the frame that the poses are of: as the user says, else by the fixed transforms, else the identity.
fn mounting(tree: &TransformTree, child: &str, lidar: &str, given: Option<Pose>) -> Pose {
    if let Some(pose) = given {
        return pose;
    }
    if child.is_empty() || child == lidar {
        return Pose::identity();
    }
    tree.fixed(child, lidar).unwrap_or_else(|| {
        tracing::warn!("no fixed transform leads from {child} to {lidar}: the poses are taken as those of the lidar (--t-base-lidar says otherwise)");
        Pose::identity()
    })
}
