//! A scan after its registration.

use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_slam::odometry::{OdometryReport, Status};

/// What is known of a scan after its registration.
pub struct Tracked {
    /// The scan's node, as its dataset numbers it.
    pub node: NodeId,
    /// Seconds.
    pub time: f64,
    /// The outcome.
    pub report: OdometryReport,
}

impl Tracked {
    /// Whether the pose was measured.
    pub fn is_tracked(&self) -> bool {
        !matches!(self.report.status, Status::Failed(_))
    }

    /// Pose of the lidar in the map frame.
    pub fn pose(&self) -> &Pose {
        &self.report.t_map_lidar
    }
}
