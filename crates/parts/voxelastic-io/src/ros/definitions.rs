//! Definitions of messages, which recordings carry for readers without ROS.

macro_rules! definitions {
    ($($name:literal),*) => {
        &[$(($name, include_str!(concat!("definitions/", $name, ".msg")))),*]
    };
}

/// Definitions by the last part of their types: common_interfaces, geometry2, navigation_msgs, octomap_msgs and livox_ros_driver2, as in ROS 2 Jazzy.
const DEFINITIONS: &[(&str, &str)] = definitions!(
    "CameraInfo",
    "CompressedImage",
    "CustomMsg",
    "DiagnosticArray",
    "Imu",
    "MarkerArray",
    "OccupancyGrid",
    "OccupancyGridUpdate",
    "Octomap",
    "Odometry",
    "Path",
    "PointCloud2",
    "PoseArray",
    "PoseStamped",
    "PoseWithCovarianceStamped",
    "TFMessage"
);

/// The definition of a type of messages such as `sensor_msgs/msg/Imu`, with those of its parts, in ROS 2's `.msg` format; `None` for a type that is not
/// known here.
pub fn definition(kind: &str) -> Option<&'static str> {
    let base = kind.rsplit('/').next().unwrap_or(kind);
    DEFINITIONS.iter().find(|(name, _)| *name == base).map(|(_, definition)| *definition)
}
