//! Writing CDR, the serialisation of ROS 2 (OMG DDSI-RTPS 2.3, section 10): little-endian, numbers aligned to their size from the end of the header.

use voxelastic::Pose;

/// When and in which frame a message was made.
#[derive(Clone, Copy, Debug)]
pub struct Header<'a> {
    /// Seconds.
    pub stamp: f64,
    /// Name of the frame.
    pub frame: &'a str,
}

/// The header of messages in plain CDR, little-endian.
pub const CDR_HEADER: [u8; 4] = [0, 1, 0, 0];

/// A message under construction.
#[derive(Clone, Debug)]
pub struct MessageWriter(Vec<u8>);

impl MessageWriter {
    /// The header of a message.
    pub fn new() -> Self {
        Self(CDR_HEADER.to_vec())
    }

    /// As [`new`](Self::new), with room for `bytes`.
    pub fn with_capacity(bytes: usize) -> Self {
        let mut message = Vec::with_capacity(bytes + CDR_HEADER.len());
        message.extend(CDR_HEADER);
        Self(message)
    }

    fn align(&mut self, size: usize) {
        let length = self.0.len() - CDR_HEADER.len();
        self.0.resize(CDR_HEADER.len() + length.next_multiple_of(size), 0);
    }

    /// A byte.
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.0.push(value);
        self
    }

    /// A truth value.
    pub fn bool(&mut self, value: bool) -> &mut Self {
        self.u8(value.into())
    }

    /// A number.
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.align(4);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// A number.
    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.u32(value as u32)
    }

    /// A number.
    pub fn i64(&mut self, value: i64) -> &mut Self {
        self.align(8);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// Numbers, without their count.
    pub fn f32s(&mut self, values: &[f32]) -> &mut Self {
        self.align(4);
        values.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    /// Numbers, without their count.
    pub fn f64s(&mut self, values: &[f64]) -> &mut Self {
        self.align(8);
        values.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    /// A string.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.u8(0)
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.u32(bytes.len() as u32);
        self.0.extend(bytes);
        self
    }

    /// Bytes as they are, without their count.
    pub fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend(bytes);
        self
    }

    /// `builtin_interfaces/Time`; times before 1970 are those of its beginning.
    pub fn time(&mut self, seconds: f64) -> &mut Self {
        let seconds = if seconds.is_finite() { seconds.max(0.0) } else { 0.0 };
        // Seconds since 1970 leave no room for nanoseconds in 64 bits: the parts are taken one by one.
        let nanoseconds = (seconds.fract() * 1e9).round() as u64;
        self.u32((seconds as u64 + nanoseconds / 1_000_000_000) as u32).u32((nanoseconds % 1_000_000_000) as u32)
    }

    /// `std_msgs/Header`.
    pub fn header(&mut self, header: Header<'_>) -> &mut Self {
        self.time(header.stamp).text(header.frame)
    }

    /// `geometry_msgs/Pose`; `geometry_msgs/Transform` is laid out in the same way.
    pub fn pose(&mut self, pose: &Pose) -> &mut Self {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        self.f64s(&[t.x, t.y, t.z, q.x, q.y, q.z, q.w])
    }

    /// The message.
    pub fn finish(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0)
    }
}

impl Default for MessageWriter {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::MessageReader;

    #[test]
    fn what_is_written_is_read() {
        let message = MessageWriter::new().u8(7).text("frame").f64s(&[0.5]).bool(true).u32(9).f32s(&[1.5]).i64(-2).finish();
        let mut reader = MessageReader::new(&message).unwrap();
        assert_eq!((reader.bool(), reader.text().as_deref(), reader.f64()), (Some(true), Some("frame"), Some(0.5)));
        assert_eq!((reader.u8(), reader.u32(), reader.f32(), reader.i64()), (Some(1), Some(9), Some(1.5), Some(-2)));
        assert_eq!(reader.u32(), None);
        assert!(MessageReader::new(&[0, 9, 0, 0]).is_none() && MessageReader::new(&[]).is_none());
        let mut garbage = MessageReader::new(&[0, 1, 0, 0, 255, 255, 255, 255]).unwrap();
        assert_eq!(garbage.text(), None);
    }
}
