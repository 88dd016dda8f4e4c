//! RoboSense's packets: twelve blocks of 32 returns, numbers big-endian.
//!
//! Layouts, timing and angles as in the user manuals of RS-LiDAR-16, RS-LiDAR-32 and RS-Helios and as the maker's driver reads them. Returns come in MSOP packets;
//! DIFOP packets, which come once or twice a second, have the angles of the piece and the return mode. The frame is that of the maker's driver: x where the head looks at azimuth
//! 0, y to the left. Of two returns, the first one of a pair is used.

mod models;

use super::clock::SensorClock;
use super::date::seconds;
use super::files::read_angles;
use super::head_turn::HeadTurn;
use super::spinning::{HUNDREDTH, PacketReturns, SpinningPackets, SpinningReturn};
use crate::{Error, Position, Result};
use models::{BLOCK, BLOCKS, HEAD, PACKET, big_endian};
pub(super) use models::{Kind, Model};
use std::path::Path;

/// Returns of a block.
const RETURNS: usize = 32;
/// How packets about the device begin.
const DIFOP: [u8; 8] = [0xa5, 0xff, 0x00, 0x5a, 0x11, 0x11, 0x55, 0x55];
/// Place of the time in packets with returns.
const TIME: usize = 20;
/// The return mode in packets about the device, and its value for two returns.
const MODE: usize = 300;
const DUAL: u8 = 0;

/// Whether a packet is about the device.
pub(super) fn is_about_device(packet: &[u8]) -> bool {
    packet.len() == PACKET && packet.starts_with(&DIFOP)
}

/// What is particular to a piece.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    /// Elevation and azimuth of each laser, degrees.
    angles: Vec<[f64; 2]>,
    is_dual: bool,
}

impl Piece {
    /// What a packet about the device says of a sensor; no angles if they were not set.
    pub(super) fn of(model: &Model, device: Option<&[u8]>) -> (Option<Vec<[f64; 2]>>, bool) {
        let Some(device) = device.filter(|packet| is_about_device(packet)) else { return (None, false) };
        (model.angles_in(device), device[MODE] == DUAL)
    }

    /// With the angles in a file, else those in a packet about the device, else those of its kind.
    ///
    /// # Errors
    /// [`Error::Content`] if the file has none, or those of another sensor; [`Error::Io`]. `Ok(None)` if there are no angles anywhere.
    pub(super) fn new(model: &'static Model, file: Option<&Path>, device: Option<&[u8]>) -> Result<Option<Self>> {
        let (sent, is_dual) = Self::of(model, device);
        let angles = match file {
            Some(file) => {
                let angles = read_angles(file)?;
                if angles.len() != model.lasers {
                    let problem = format!("angles of {} channels, but an {} has {}", angles.len(), model.name, model.lasers);
                    return Err(Error::content(file, Position::File, problem, "give the angles of the sensor of the capture"));
                }
                Some(angles)
            }
            None => sent.or_else(|| model.usual_angles()),
        };
        Ok(angles.map(|angles| Self { angles, is_dual }))
    }
}

/// Reads the packets of a sensor.
#[derive(Debug)]
pub(super) struct RoboSensePackets {
    model: &'static Model,
    piece: Piece,
    /// Row of each laser, counted from below, as the maker's driver does.
    rings: Vec<u16>,
    clock: SensorClock,
    turn: HeadTurn,
}

impl RoboSensePackets {
    pub(super) fn new(model: &'static Model, piece: Piece) -> Self {
        let below = |[elevation, _]: &[f64; 2]| piece.angles.iter().filter(|[other, _]| other < elevation).count() as u16;
        let rings = piece.angles.iter().map(below).collect();
        Self { model, piece, rings, clock: SensorClock::default(), turn: HeadTurn::default() }
    }

    /// The blocks that are used: of two returns the first, in a block of its own or in the first half of each.
    fn used<'a>(&self, packet: &'a [u8]) -> Vec<&'a [u8]> {
        let blocks = packet[HEAD..].chunks(BLOCK).take(BLOCKS);
        let in_pairs = self.piece.is_dual && self.model.lasers == RETURNS;
        blocks.step_by(1 + usize::from(in_pairs)).collect()
    }
}

impl SpinningPackets for RoboSensePackets {
    fn read(&mut self, packet: &[u8], came: f64, out: &mut PacketReturns) -> bool {
        if Kind::of(packet).and_then(Kind::model).is_none_or(|model| !std::ptr::eq(model, self.model)) {
            return false;
        }
        let used = self.used(packet);
        let azimuths: Vec<u16> = used.iter().map(|block| big_endian(&block[2..4]) as u16).collect();
        if azimuths.iter().any(|azimuth| *azimuth >= 36_000) {
            return false;
        }
        let steps = self.turn.steps(&azimuths);
        let Self { model, piece, rings, clock, .. } = self;
        let lasers = model.lasers;
        let cycles = if piece.is_dual { 1 } else { RETURNS / lasers };
        let block_us = model.cycle_us * cycles as f64;
        let start = clock.time(model.time(packet), came);
        for (k, (block, step)) in used.iter().zip(steps).enumerate() {
            let (azimuth, per_us) = (f64::from(azimuths[k]), step / block_us);
            for cycle in 0..cycles {
                let cycle_us = model.cycle_us * cycle as f64;
                for (laser, (&ring, [elevation, offset])) in rings.iter().zip(&piece.angles).enumerate() {
                    let at = 4 + 3 * (cycle * lasers + laser);
                    let distance = big_endian(&block[at..at + 2]);
                    if distance == 0 {
                        continue;
                    }
                    let fired_us = cycle_us + (model.fired_us)(laser);
                    let head = ((azimuth + per_us * fired_us) * HUNDREDTH).to_radians();
                    let (angle, (sin, cos)) = (head + offset.to_radians(), elevation.to_radians().sin_cos());
                    let range = distance as f64 * model.unit;
                    // Azimuths are clockwise; the lens turns with the head.
                    let [x, y] = [range * cos * angle.cos() + model.lens * head.cos(), -range * cos * angle.sin() - model.lens * head.sin()];
                    out.returns.push(SpinningReturn {
                        time: start + (block_us * k as f64 + fired_us) * 1e-6,
                        ring,
                        intensity: block[at + 2],
                        point: [x, y, range * sin].map(|v| v as f32),
                    });
                }
                out.end_firing(start + (block_us * k as f64 + cycle_us) * 1e-6, (azimuth + per_us * cycle_us) * HUNDREDTH);
            }
        }
        true
    }
}

impl Model {
    /// What the clock of the sensor shows in a packet, seconds since 1970.
    fn time(&self, packet: &[u8]) -> f64 {
        let time = &packet[TIME..TIME + 10];
        if self.counts_seconds {
            return big_endian(&time[..6]) as f64 + big_endian(&time[6..]) as f64 * 1e-6;
        }
        seconds(&time[..6]) + big_endian(&time[6..8]) as f64 * 1e-3 + big_endian(&time[8..]) as f64 * 1e-6
    }
}
