//! Hesai's packets: blocks of all channels.
//!
//! Layouts as in the user manuals of Pandar40P, Pandar64, PandarQT, PandarXT and PandarXT-16. The frame is that of the maker's driver: y where the head looks at
//! azimuth 0, x to the right of it. Of two returns, the stronger one is used where the packets say which it is. Times are those of blocks, and of channels where
//! they fire evenly; elsewhere they may be off by less than a tenth of a millisecond.

mod models;

use super::clock::SensorClock;
use super::date::seconds;
use super::files::read_angles;
use super::spinning::{HUNDREDTH, PacketReturns, SpinningPackets, SpinningReturn, u16_at, u32_at};
use crate::{Error, Position, Result};
pub(super) use models::{Model, ModelId};
use std::path::Path;

/// Return modes: the last and the strongest, the first and the strongest, the last and the first.
const LAST_STRONGEST: u8 = 0x39;
const FIRST_STRONGEST: u8 = 0x3c;
const LAST_FIRST: u8 = 0x3b;

/// Reads the packets of a sensor.
#[derive(Debug)]
pub(super) struct HesaiPackets {
    model: &'static Model,
    /// Sine and cosine of the elevation of each channel, and its azimuth, radians.
    beams: Vec<[f64; 3]>,
    clock: SensorClock,
}

impl HesaiPackets {
    /// With the angles in a file, else those of its kind.
    ///
    /// # Errors
    /// [`Error::Content`] if the file has none, or those of another sensor; [`Error::Io`].
    pub(super) fn new(model: &'static Model, file: Option<&Path>) -> Result<Self> {
        let angles = match file {
            None => model.angles(),
            Some(file) => {
                let angles = read_angles(file)?;
                if angles.len() != model.channels {
                    let problem = format!("angles of {} channels, but a {} has {}", angles.len(), model.name, model.channels);
                    return Err(Error::content(file, Position::File, problem, "give the angle correction of the sensor of the capture"));
                }
                angles
            }
        };
        let beam = |[elevation, azimuth]: &[f64; 2]| {
            let (sin, cos) = elevation.to_radians().sin_cos();
            [sin, cos, azimuth.to_radians()]
        };
        Ok(Self { model, beams: angles.iter().map(beam).collect(), clock: SensorClock::default() })
    }
}

impl SpinningPackets for HesaiPackets {
    fn read(&mut self, packet: &[u8], came: f64, out: &mut PacketReturns) -> bool {
        let model = self.model;
        if ModelId::of(packet).is_none_or(|id| !std::ptr::eq(id.model(), model)) {
            return false;
        }
        let block_bytes = model.block_bytes();
        let tail = &packet[model.head + model.blocks * block_bytes..];
        let mode = tail.get(model.mode).copied().unwrap_or(0);
        let is_dual = matches!(mode, LAST_STRONGEST | FIRST_STRONGEST | LAST_FIRST);
        let skipped = usize::from(is_dual && mode != LAST_FIRST);
        let step = 1 + usize::from(is_dual);
        let blocks: Vec<&[u8]> = packet[model.head..].chunks(block_bytes).take(model.blocks).skip(skipped).step_by(step).collect();
        let azimuths = blocks.iter().map(|block| u16_at(block, model.block_head - 2));
        let azimuths: Vec<u16> = azimuths.collect();
        if azimuths.iter().any(|azimuth| *azimuth >= 36_000) {
            return false;
        }
        let counted = seconds(tail.get(model.date..model.date + 6).unwrap_or_default()) + f64::from(u32_at(tail, model.microseconds)) * 1e-6;
        let end = self.clock.time(counted, came);
        let unit = model.distance_unit(packet);
        for (k, (block, azimuth)) in blocks.iter().zip(&azimuths).enumerate() {
            let start = end - model.block_us * 1e-6 * (blocks.len() - 1 - k) as f64;
            let head = f64::from(*azimuth) * HUNDREDTH;
            for (channel, [sin, cos, offset]) in self.beams.iter().enumerate() {
                let at = model.block_head + channel * model.unit;
                let distance = u16_at(block, at);
                if distance == 0 {
                    continue;
                }
                let range = f64::from(distance) * unit;
                let angle = head.to_radians() + offset;
                out.returns.push(SpinningReturn {
                    time: start + model.channel_us * 1e-6 * channel as f64,
                    ring: channel as u16,
                    intensity: block[at + 2],
                    point: [range * cos * angle.sin(), range * cos * angle.cos(), range * sin].map(|v| v as f32),
                });
            }
            out.end_firing(start, head);
        }
        true
    }
}
