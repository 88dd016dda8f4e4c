//! What the packets of sensors that turn have in common, whatever the make.

use std::fmt;

/// What the beams measured while the head stood in one direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Firing {
    /// Seconds.
    pub(super) time: f64,
    /// Direction of the head, degrees from 0 to 360.
    pub(super) head: f64,
    /// Number of returns in the packet up to the end of this firing.
    pub(super) end: usize,
}

/// A measured return.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SpinningReturn {
    /// Seconds.
    pub(super) time: f64,
    /// Row, in the order that drivers of the make count them.
    pub(super) ring: u16,
    /// As the sensor gives it, 0 to 255.
    pub(super) intensity: u8,
    /// Sensor frame, metres.
    pub(super) point: [f32; 3],
}

/// The returns of a packet, in the order of its firings.
#[derive(Clone, Debug, Default)]
pub(super) struct PacketReturns {
    pub(super) firings: Vec<Firing>,
    pub(super) returns: Vec<SpinningReturn>,
}

impl PacketReturns {
    /// Ends a firing: the returns since the last one are its own.
    pub(super) fn end_firing(&mut self, time: f64, head: f64) {
        self.firings.push(Firing { time, head: head.rem_euclid(360.0), end: self.returns.len() });
    }

    pub(super) fn clear(&mut self) {
        self.firings.clear();
        self.returns.clear();
    }
}

/// Reads the packets of one sensor of a make.
pub(super) trait SpinningPackets: Send + fmt::Debug {
    /// The returns of a packet that came at `came`, seconds; false if it is not one of this sensor.
    fn read(&mut self, packet: &[u8], came: f64, out: &mut PacketReturns) -> bool;
}

/// What a unit of a packet's angles is, degrees.
pub(super) const HUNDREDTH: f64 = 0.01;

/// A number of two bytes, little-endian; 0 beyond the end.
pub(super) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    bytes.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u16::from_le_bytes(*b))
}

/// A number of four bytes, little-endian; 0 beyond the end.
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u32::from_le_bytes(*b))
}
