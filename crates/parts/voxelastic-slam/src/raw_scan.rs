//! A scan without a pose.

use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::motion::ImuSample;

/// A scan without a pose.
#[derive(Clone, Debug)]
pub struct RawScan {
    /// The node that it becomes.
    pub node: NodeId,
    /// Time stamp in seconds.
    pub time: f64,
    /// The points, in the lidar frame.
    pub cloud: Cloud,
    /// Samples of an inertial measurement unit at the lidar since the scan before, up to the end of this one; empty without one.
    pub imu: Vec<ImuSample>,
}
