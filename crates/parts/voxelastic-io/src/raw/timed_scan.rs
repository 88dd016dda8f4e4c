//! A scan with its time.

use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::motion::ImuSample;

/// A scan with its time and without a pose.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TimedScan {
    /// Name of the file without extension; in a recording the number of the scan.
    pub name: String,
    /// Position among all scans, 0-based.
    pub index: usize,
    /// The number in the file's name if all names have one, else `index`. As in a [`Dataset`](crate::Dataset) of the same folder.
    pub node: NodeId,
    /// Time in seconds that [`Cloud::time`] is relative to.
    pub time: f64,
    /// Start and end of the sweep in the clock of `time`, seconds, if there are files for them.
    pub sweep: Option<[f64; 2]>,
    /// The points, in the lidar frame.
    pub cloud: Cloud,
    /// What an inertial measurement unit at the lidar's origin with the lidar's axes would have measured since the scan before, up to the end of
    /// this one; empty if the data have no such unit.
    pub imu: Vec<ImuSample>,
}
