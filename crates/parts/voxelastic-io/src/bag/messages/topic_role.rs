//! Message types that are used.

use super::packets::PacketLayout;
use crate::bag::containers::container::{Encoding, Topic};

/// What a topic is used for, by its message type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TopicRole {
    /// `sensor_msgs/PointCloud2`.
    PointCloud2,
    /// `livox_ros_driver/CustomMsg` and `livox_ros_driver2/CustomMsg`.
    Livox,
    /// `nav_msgs/Odometry`.
    Odometry,
    /// `geometry_msgs/PoseStamped`, with or without covariance.
    PoseStamped,
    /// `nav_msgs/Path`.
    Path,
    /// `tf2_msgs/TFMessage`, `tf/tfMessage`.
    Transforms,
    /// `sensor_msgs/Imu`.
    Imu,
    /// Packets of a sensor, see [`PacketLayout`].
    Packets,
    /// Packets of the inertial unit in an Ouster sensor.
    ImuPackets,
    /// What a sensor says about itself: an Ouster's metadata, a RoboSense's packets about the device.
    SensorInfo,
}

impl TopicRole {
    pub(crate) fn of(topic: &Topic) -> Option<Self> {
        if topic.encoding == Encoding::Other {
            return None;
        }
        match topic.kind.as_str() {
            "sensor_msgs/PointCloud2" => Some(Self::PointCloud2),
            "livox_ros_driver/CustomMsg" | "livox_ros_driver2/CustomMsg" => Some(Self::Livox),
            "nav_msgs/Odometry" => Some(Self::Odometry),
            "geometry_msgs/PoseStamped" | "geometry_msgs/PoseWithCovarianceStamped" => Some(Self::PoseStamped),
            "nav_msgs/Path" => Some(Self::Path),
            "tf2_msgs/TFMessage" | "tf/tfMessage" => Some(Self::Transforms),
            "sensor_msgs/Imu" => Some(Self::Imu),
            "std_msgs/String" if topic.name.ends_with("metadata") => Some(Self::SensorInfo),
            kind => PacketLayout::of(kind).map(|layout| match layout {
                PacketLayout::Stamped(_) => Self::SensorInfo,
                PacketLayout::Bare if topic.name.ends_with("imu_packets") => Self::ImuPackets,
                _ => Self::Packets,
            }),
        }
    }

    /// Whether scans are made of its messages.
    pub(crate) fn is_cloud(self) -> bool {
        matches!(self, Self::PointCloud2 | Self::Livox | Self::Packets)
    }

    pub(crate) fn is_poses(self) -> bool {
        matches!(self, Self::Odometry | Self::PoseStamped | Self::Path)
    }
}
