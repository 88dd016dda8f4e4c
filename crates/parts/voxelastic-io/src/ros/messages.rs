//! Messages that recordings and topics have in common.

use super::{Header, MessageWriter};
use voxelastic::Pose;

/// Type of a field of `sensor_msgs/PointCloud2`, with its number in `sensor_msgs/PointField`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldType {
    /// `uint16`
    U16 = 4,
    /// `uint32`
    U32 = 6,
    /// `float32`
    F32 = 7,
}

impl FieldType {
    /// Bytes of a number.
    pub fn size(self) -> usize {
        if self == Self::U16 { 2 } else { 4 }
    }
}

/// `sensor_msgs/PointCloud2` of little-endian points, row after row, whose fields follow each other without gaps. `is_dense` says that all
/// coordinates are finite.
pub fn point_cloud(header: Header<'_>, [height, width]: [usize; 2], fields: &[(&str, FieldType)], data: &[u8], is_dense: bool) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(data.len() + 512);
    message.header(header).u32(height as u32).u32(width as u32).u32(fields.len() as u32);
    let mut step = 0;
    for (name, kind) in fields {
        message.text(name).u32(step as u32).u8(*kind as u8).u32(1);
        step += kind.size();
    }
    message.bool(false).u32(step as u32).u32((step * width) as u32).bytes(data).bool(is_dense).finish()
}

/// `tf2_msgs/TFMessage`: poses of frames in those of their headers.
pub fn transforms(links: &[(Header<'_>, &str, Pose)]) -> Vec<u8> {
    let mut message = MessageWriter::new();
    message.u32(links.len() as u32);
    for (header, child, pose) in links {
        message.header(*header).text(child).pose(pose);
    }
    message.finish()
}
