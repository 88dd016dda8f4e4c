//! A camera beside the LiDAR.

use voxelastic::Pose;
use voxelastic_colour::CameraModel;

/// A camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Its name in `cameras.toml`, or its topic.
    pub name: String,
    /// Its intrinsics.
    pub model: CameraModel,
    /// Its pose in the lidar frame: x to the right of the image, y down, z ahead.
    pub t_lidar_camera: Pose,
}
