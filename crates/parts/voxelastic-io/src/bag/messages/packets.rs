//! Messages with the packets of sensors: `velodyne_msgs`, `pandar_msgs`, `hesai_lidar`, `rslidar_msgs`, `rslidar_msg`, `nebula_msgs` and `ouster_ros`.

use super::header::{Header, header, time};
use crate::ros::{Encoding, MessageReader};

/// How packets are laid out in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PacketLayout {
    /// A header and a list of packets, each with its time and its bytes: so many, or a sequence, and perhaps how many of them are used.
    List { bytes: Option<usize>, has_size: bool },
    /// One with a header and two flags before it.
    Flagged,
    /// One with its time, of so many bytes.
    Stamped(usize),
    /// Only its bytes.
    Bare,
}

impl PacketLayout {
    /// That of a type of messages, if it has packets.
    pub(crate) fn of(kind: &str) -> Option<Self> {
        Some(match kind {
            "velodyne_msgs/VelodyneScan" => Self::List { bytes: Some(1206), has_size: false },
            "rslidar_msgs/rslidarScan" => Self::List { bytes: Some(1248), has_size: false },
            "rslidar_msgs/rslidarPacket" => Self::Stamped(1248),
            "rslidar_msg/RslidarPacket" => Self::Flagged,
            "pandar_msgs/PandarScan" => Self::List { bytes: Some(1500), has_size: true },
            "hesai_lidar/PandarScan" => Self::List { bytes: None, has_size: true },
            "nebula_msgs/NebulaPackets" => Self::List { bytes: None, has_size: false },
            "ouster_ros/PacketMsg" | "ouster_sensor_msgs/PacketMsg" => Self::Bare,
            _ => return None,
        })
    }

    /// The packets of a message, each with the time at which it came: where messages do not say, that of `recorded`. `None` if it ends early.
    pub(super) fn packets<'a>(self, cursor: &mut MessageReader<'a>, encoding: Encoding, recorded: f64) -> Option<Vec<(f64, &'a [u8])>> {
        match self {
            Self::List { bytes, has_size } => {
                header(cursor, encoding)?;
                let count = cursor.count(8)?;
                let mut packet = || {
                    let came = time(cursor)?;
                    let data = sequence(cursor, bytes)?;
                    let used = if has_size { cursor.u32()? as usize } else { data.len() };
                    Some((came, data.get(..used)?))
                };
                (0..count).map(|_| packet()).collect()
            }
            Self::Flagged => {
                let Header { time, .. } = header(cursor, encoding)?;
                cursor.bytes(2)?;
                Some(vec![(time, sequence(cursor, None)?)])
            }
            Self::Stamped(bytes) => Some(vec![(time(cursor)?, cursor.bytes(bytes)?)]),
            Self::Bare => Some(vec![(recorded, sequence(cursor, None)?)]),
        }
    }
}

/// So many bytes, or as many as there are said to be.
fn sequence<'a>(cursor: &mut MessageReader<'a>, bytes: Option<usize>) -> Option<&'a [u8]> {
    let count = if let Some(bytes) = bytes { bytes } else { cursor.u32()? as usize };
    cursor.bytes(count)
}
