//! Trajectories as text files.

mod write;

pub use write::{write_kitti, write_tum};

use voxelastic::Pose;

/// Whether all numbers of a pose are finite.
pub(crate) fn is_finite(pose: &Pose) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
}
