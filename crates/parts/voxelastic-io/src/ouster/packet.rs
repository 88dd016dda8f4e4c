//! Lidar packets: columns of returns. Layouts as in Ouster's firmware user manual, sections on the lidar data packet formats.

use super::sensor_metadata::{Profile, SensorMetadata};
use std::f64::consts::PI;
use voxelastic::motion::ImuSample;

const STANDARD_GRAVITY: f64 = 9.806_65;

/// Where things are in a packet, bytes.
#[derive(Clone, Copy, Debug)]
struct Layout {
    packet_head: usize,
    column_head: usize,
    column_tail: usize,
    packet_tail: usize,
    /// Bytes of a return, or of a pair.
    pixel: usize,
}

/// One measured return.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Return {
    /// Metres from the lidar's origin; 0 where there is none.
    pub(crate) range: f64,
    pub(crate) reflectivity: u16,
}

/// A column of a packet.
#[derive(Clone, Debug)]
pub(crate) struct Column<'a> {
    /// Nanoseconds in the sensor's clock.
    pub(crate) time_ns: u64,
    /// Place in the turn.
    pub(crate) number: usize,
    /// Number of the turn.
    pub(crate) frame: u16,
    profile: Profile,
    pixels: &'a [u8],
    size: usize,
}

impl Layout {
    fn of(profile: Profile) -> Self {
        let legacy = Self { packet_head: 0, column_head: 16, column_tail: 4, packet_tail: 0, pixel: 12 };
        let new = Self { packet_head: 32, column_head: 12, column_tail: 0, packet_tail: 32, pixel: 12 };
        match profile {
            Profile::Legacy => legacy,
            Profile::Single => new,
            Profile::Dual => Self { pixel: 16, ..new },
            Profile::LowRate => Self { pixel: 4, ..new },
        }
    }

    fn column(&self, rows: usize) -> usize {
        self.column_head + self.pixel * rows + self.column_tail
    }
}

/// Bytes of a packet of a sensor.
pub(crate) fn size(metadata: &SensorMetadata) -> usize {
    let layout = Layout::of(metadata.profile);
    layout.packet_head + metadata.columns_per_packet * layout.column(metadata.rows()) + layout.packet_tail
}

/// A packet without the byte that old drivers put behind it in their messages.
pub(crate) fn trimmed<'a>(metadata: &SensorMetadata, bytes: &'a [u8]) -> &'a [u8] {
    let is_longer = [IMU_PACKET, size(metadata)].contains(&bytes.len().saturating_sub(1));
    if is_longer { &bytes[..bytes.len() - 1] } else { bytes }
}

/// The columns of a packet that were measured; nothing if the packet is of another size.
pub(crate) fn columns<'a>(metadata: &SensorMetadata, packet: &'a [u8]) -> Vec<Column<'a>> {
    let layout = Layout::of(metadata.profile);
    if packet.len() != size(metadata) {
        return Vec::new();
    }
    let u16_at = |bytes: &[u8], at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let frame_of_packet = if layout.packet_head > 0 { u16_at(packet, 2) } else { 0 };
    let size = layout.column(metadata.rows());
    let read = |bytes: &'a [u8]| {
        let (is_valid, frame) = match metadata.profile {
            Profile::Legacy => (bytes[size - 4..] == [0xff; 4], u16_at(bytes, 10)),
            _ => (u16_at(bytes, 10) & 1 == 1, frame_of_packet),
        };
        let number = usize::from(u16_at(bytes, 8));
        let time_ns = bytes.first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
        let pixels = &bytes[layout.column_head..size - layout.column_tail];
        (is_valid && number < metadata.columns).then_some(Column { time_ns, number, frame, profile: metadata.profile, pixels, size: layout.pixel })
    };
    packet[layout.packet_head..].chunks_exact(size).take(metadata.columns_per_packet).filter_map(read).collect()
}

/// Whether a datagram has columns of a sensor.
pub(crate) fn has_columns(metadata: &SensorMetadata, bytes: &[u8]) -> bool {
    !columns(metadata, trimmed(metadata, bytes)).is_empty()
}

/// Bytes of a packet of the inertial measurement unit.
const IMU_PACKET: usize = 48;

/// The sample in a packet of the inertial measurement unit, in its frame; `None` if it is none by its size, or holds what no unit measures.
/// Times are those of the accelerometer's reading, in the clock of the columns.
pub(crate) fn imu(packet: &[u8]) -> Option<ImuSample> {
    if packet.len() != IMU_PACKET {
        return None;
    }
    let time_ns = u64::from_le_bytes(*packet.get(8..)?.first_chunk()?);
    let number = |at: usize| Some(f64::from(f32::from_le_bytes(*packet.get(at..)?.first_chunk()?)));
    let vector = |at: usize, scale: f64| Some([number(at)? * scale, number(at + 4)? * scale, number(at + 8)? * scale]);
    let (acceleration, angular_velocity) = (vector(24, STANDARD_GRAVITY)?, vector(36, PI / 180.0)?);
    let is_plausible = acceleration.iter().chain(&angular_velocity).all(|v| v.abs() < 1e3);
    is_plausible.then_some(ImuSample { time: time_ns as f64 * 1e-9, angular_velocity, acceleration })
}

impl Column<'_> {
    /// What a row measured.
    pub(crate) fn at(&self, row: usize) -> Return {
        let Some(p) = self.pixels.get(row * self.size..(row + 1) * self.size) else { return Return::default() };
        let word = |at: usize| u32::from_le_bytes([p[at], p[at + 1], p[at + 2], p[at + 3]]);
        let metres = |millimetres: u32| f64::from(millimetres) * 1e-3;
        match self.profile {
            Profile::Legacy => Return { range: metres(word(0) & 0x000f_ffff), reflectivity: u16::from(p[4]) },
            Profile::Single => Return { range: metres(word(0) & 0x0007_ffff), reflectivity: u16::from(p[4]) },
            // The second return is the weaker one.
            Profile::Dual => Return { range: metres(word(0) & 0x0007_ffff), reflectivity: u16::from(p[3]) },
            Profile::LowRate => Return { range: metres((word(0) & 0x7fff) << 3), reflectivity: u16::from(p[2]) },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packet_of_the_inertial_unit_is_read_in_our_units() {
        let mut packet = vec![0u8; 48];
        packet[8..16].copy_from_slice(&1_500_000_000u64.to_le_bytes());
        for (at, value) in [(24, 0.5f32), (28, 0.0), (32, 1.0), (36, 180.0), (40, -90.0), (44, 0.0)] {
            packet[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        let sample = imu(&packet).unwrap();
        assert_eq!((sample.time, sample.acceleration), (1.5, [0.5 * STANDARD_GRAVITY, 0.0, STANDARD_GRAVITY]));
        assert_eq!(sample.angular_velocity, [PI, -PI / 2.0, 0.0]);
        packet[24..28].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(imu(&packet).is_none() && imu(&packet[..47]).is_none());
    }
}
