//! Clouds that an odometry has moved into the frame of its poses, such as FAST-LIO's `/cloud_registered`.

use nalgebra::Point3;
use voxelastic::{Cloud, Pose};

/// Names of the frames that maps are in.
pub(crate) const MAP_FRAMES: [&str; 5] = ["map", "odom", "world", "camera_init", "global"];

/// Whether the frame that poses are in is that of a map, by what they are of. Some write the sensor's frame there, and nothing of what the poses are of.
pub(crate) fn is_map(parent: &str, child: &str) -> bool {
    MAP_FRAMES.contains(&parent) || !(parent.is_empty() || child.is_empty() || parent == child)
}

/// Says what is done with clouds of the frame that the poses are in.
pub(crate) fn tell_registered(frame: &str, child: &str) {
    tracing::info!(
        "clouds of {frame} were moved into the frame that the poses are in, and undistorted: they are moved back by their poses, seen from {child} (--t-base-lidar says where the lidar is on it)"
    );
}

/// Takes a cloud back into the frame of the lidar that was moved by its pose. Its points are where they were at its stamp: their times say nothing any more.
pub(crate) fn take_back(cloud: &mut Cloud, t_map_lidar: &Pose) {
    let t_lidar_map = t_map_lidar.inverse();
    for point in cloud.points.iter_mut().filter(|point| Cloud::is_return(point)) {
        // In 64 bits: the map may be far from zero.
        *point = (t_lidar_map * Point3::from(point.map(f64::from))).coords.map(|v| v as f32).into();
    }
    cloud.time = None;
}
