//! Poses by time: trajectories that grow while a recording is read, transform trees, the lidar's motion during a sweep, and samples of inertial units
//! moved to the lidar.

mod imu_mount;
mod pose_track;
mod sweep;
mod transform_tree;

pub(crate) use imu_mount::ImuMount;
pub(crate) use pose_track::{LONGEST_GAP_S, PoseTrack};
pub(crate) use sweep::{sweep_motion, time_span};
pub(crate) use transform_tree::TransformTree;
