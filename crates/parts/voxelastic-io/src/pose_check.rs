//! Checks of poses before they are written.

use voxelastic::Pose;

/// Whether all numbers of a pose are finite.
pub(crate) fn is_finite(pose: &Pose) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
}
