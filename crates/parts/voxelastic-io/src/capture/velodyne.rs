//! Velodyne's packets: twelve blocks of 32 returns.
//!
//! Layout, timing and angles as in the user manuals of VLP-16 (63-9243), VLP-32C (63-9325) and HDL-32E (63-9113). The frame is that of the ROS driver: x where
//! the head looks at azimuth 0, y to the left. Of two returns, the stronger one is used.

mod models;

use super::clock::SensorClock;
use super::head_turn::HeadTurn;
use super::spinning::{HUNDREDTH, PacketReturns, SpinningPackets, SpinningReturn, u16_at, u32_at};
pub(super) use models::Model;

const PACKET: usize = 1206;
const BLOCK: usize = 100;
const BLOCKS: usize = 12;
/// Returns of a block.
const LASERS: usize = 32;
const FLAG: [u8; 2] = [0xff, 0xee];
/// Places of the time, the return mode and the product in a packet.
const TIME: usize = 1200;
const MODE: usize = 1204;
const PRODUCT: usize = 1205;
/// Both the strongest and the last return.
const DUAL: u8 = 0x39;

/// What a packet says about the sensor, if it is one of Velodyne's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Product {
    /// By its number.
    Known(u8),
    /// Its packets have two kinds of blocks, and angles of its own that a file has.
    Hdl64,
}

impl Product {
    /// That of a packet.
    pub(super) fn of(packet: &[u8]) -> Option<Self> {
        if packet.len() != PACKET {
            return None;
        }
        let flags: Vec<&[u8]> = packet.chunks(BLOCK).take(BLOCKS).map(|block| &block[..2]).collect();
        if flags.iter().all(|flag| *flag == FLAG) {
            return Some(Self::Known(packet[PRODUCT]));
        }
        flags.chunks(2).all(|pair| *pair == [&FLAG[..], &[0xff, 0xdd]]).then_some(Self::Hdl64)
    }

    /// Its name, whether it can be read or not.
    pub(super) fn name(self) -> String {
        match self {
            Self::Hdl64 => "HDL-64E".into(),
            Self::Known(0xa1) => "VLS-128".into(),
            Self::Known(number) => Model::of(number).map_or_else(|| format!("product 0x{number:02x}"), |model| model.name.into()),
        }
    }
}

/// Reads the packets of a sensor.
#[derive(Debug)]
pub(super) struct VelodynePackets {
    model: &'static Model,
    /// Row of each laser, counted from below, as the ROS driver does.
    rings: Vec<u16>,
    clock: SensorClock,
    turn: HeadTurn,
}

impl VelodynePackets {
    pub(super) fn new(model: &'static Model) -> Self {
        let below = |elevation: &f64| model.elevations.iter().filter(|other| *other < elevation).count() as u16;
        Self { model, rings: model.elevations.iter().map(below).collect(), clock: SensorClock::of_the_hour(), turn: HeadTurn::default() }
    }
}

impl SpinningPackets for VelodynePackets {
    fn read(&mut self, packet: &[u8], came: f64, out: &mut PacketReturns) -> bool {
        if Product::of(packet) != Some(Product::Known(self.model.product)) {
            return false;
        }
        let is_dual = packet[MODE] == DUAL;
        // Of a pair, the second block has the strongest returns.
        let used: Vec<&[u8]> = packet.chunks(BLOCK).take(BLOCKS).skip(usize::from(is_dual)).step_by(1 + usize::from(is_dual)).collect();
        let azimuths: Vec<u16> = used.iter().map(|block| u16_at(block, 2)).collect();
        if azimuths.iter().any(|azimuth| *azimuth >= 36_000) {
            return false;
        }
        let steps = self.turn.steps(&azimuths);
        let model = self.model;
        let lasers = model.elevations.len();
        let cycles = LASERS / lasers;
        let block_us = model.cycle_us * cycles as f64;
        let start = self.clock.time(f64::from(u32_at(packet, TIME)) * 1e-6, came);
        for (k, (block, step)) in used.iter().zip(steps).enumerate() {
            let (azimuth, per_us) = (f64::from(azimuths[k]), step / block_us);
            for cycle in 0..cycles {
                let cycle_us = model.cycle_us * cycle as f64;
                for laser in 0..lasers {
                    let at = 4 + 3 * (cycle * lasers + laser);
                    let distance = u16_at(block, at);
                    if distance == 0 {
                        continue;
                    }
                    let fired_us = cycle_us + model.fired_us(laser);
                    let angle = ((azimuth + per_us * fired_us) * HUNDREDTH + model.azimuths[laser]).to_radians();
                    let (sin, cos) = model.elevations[laser].to_radians().sin_cos();
                    let range = f64::from(distance) * model.unit;
                    out.returns.push(SpinningReturn {
                        time: start + (block_us * k as f64 + fired_us) * 1e-6,
                        ring: self.rings[laser],
                        intensity: block[at + 2],
                        // Azimuths are clockwise.
                        point: [range * cos * angle.cos(), -range * cos * angle.sin(), range * sin - model.origin * sin / cos].map(|v| v as f32),
                    });
                }
                out.end_firing(start + (block_us * k as f64 + cycle_us) * 1e-6, (azimuth + per_us * cycle_us) * HUNDREDTH);
            }
        }
        true
    }
}
