//! Poses by time: trajectories that grow while a recording is read, transform trees, the lidar's motion during a sweep, clouds that were moved by poses, and samples of inertial units
//! moved to the lidar.

mod imu_mount;
mod pose_track;
mod registered;
mod sweep;
mod transform_tree;

pub(crate) use imu_mount::ImuMount;
pub(crate) use pose_track::{LONGEST_GAP_S, PoseTrack};
pub(crate) use registered::{MAP_FRAMES, is_map, take_back, tell_registered};
pub(crate) use sweep::{sweep_motion, time_span};
pub(crate) use transform_tree::TransformTree;
