//! How images are found and read.

use std::path::PathBuf;
use voxelastic::Pose;

/// How images are found and read.
#[derive(Clone, Debug, Default)]
pub struct ImageOptions {
    /// The file that describes the cameras; by default `cameras.toml` beside the images. With a recording it says what the recording does not.
    pub cameras: Option<PathBuf>,
    /// Topics of a recording to read images from; empty for all that have intrinsics.
    pub topics: Vec<String>,
    /// The topic of the clouds that the map was made of: the lidar frame is theirs.
    pub cloud_topic: Option<String>,
    /// Pose of the camera in the base frame, for all cameras, instead of what files and recordings say.
    pub t_base_camera: Option<Pose>,
    /// Pose of the lidar in the base frame; if absent, the base is the lidar.
    pub t_base_lidar: Option<Pose>,
}
