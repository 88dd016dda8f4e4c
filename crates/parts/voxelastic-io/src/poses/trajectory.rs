//! A list of poses.

use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseChange;

/// Poses in the order of their file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Poses in the map frame. The file does not say of which frame: lidar or base.
    pub poses: Vec<Pose>,
    /// Time of each pose in seconds, increasing, if the format has times.
    pub times: Option<Vec<f64>>,
    /// Identifier of each pose's node, ascending, if the poses come from a pose graph.
    pub nodes: Option<Vec<NodeId>>,
}

impl Trajectory {
    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The poses, read otherwise.
    pub(crate) fn changed(self, change: &PoseChange) -> Self {
        if change.is_none() { self } else { Self { poses: self.poses.iter().map(|pose| change.apply(pose)).collect(), ..self } }
    }

    /// The same poses, each so many seconds earlier.
    pub(crate) fn earlier(&self, seconds: f64) -> Self {
        let times = self.times.as_ref().map(|times| times.iter().map(|time| time - seconds).collect());
        Self { times, ..self.clone() }
    }

    /// The lidar's poses, if these are the base's: `t_map_lidar = t_map_base * t_base_lidar`. Unchanged without `t_base_lidar`.
    pub(crate) fn in_lidar_frame(self, t_base_lidar: Option<&Pose>) -> Self {
        let Some(t_base_lidar) = t_base_lidar else { return self };
        Self { poses: self.poses.iter().map(|t_map_base| t_map_base * t_base_lidar).collect(), ..self }
    }
}
