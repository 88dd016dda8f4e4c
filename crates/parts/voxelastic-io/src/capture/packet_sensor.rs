//! A sensor whose packets are in messages, and the scans that they make.

use super::clock::HostClock;
use super::datagrams::Datagram;
use super::recognise::{Recognised, SpinningSensor, is_about_device, known, recognise_in};
use super::turn_assembler::TurnAssembler;
use crate::ouster::{ScanAssembler, SensorMetadata};
use crate::stamped_cloud::StampedCloud;
use crate::{Error, Result};
use std::path::{Path, PathBuf};
use voxelastic::motion::ImuSample;

/// A sensor whose packets are in the messages of a topic.
#[derive(Clone, Debug)]
pub(crate) enum PacketSensor {
    /// One of Ouster, as it describes itself.
    Ouster(Box<SensorMetadata>),
    /// Another one.
    Spinning(SpinningSensor),
}

impl PacketSensor {
    /// The sensor that turns that sent the first `packets` of a topic, and what was found, in words. Its beams have the `angles` of the file that the user names, or of
    /// the one that `beside` finds. `topic` is what the packets are from, for messages.
    ///
    /// # Errors
    /// [`Error::Dataset`] for sensors that are not read; as [`read_angles`](super::files::read_angles).
    pub(crate) fn recognise(
        packets: Vec<Vec<u8>>,
        path: &Path,
        topic: &str,
        angles: Option<&Path>,
        beside: impl FnOnce() -> Option<PathBuf>,
    ) -> Result<(Self, Vec<String>)> {
        let count = packets.len();
        let datagrams = packets.into_iter().map(|payload| Datagram { source: 0, port: 0, payload, time: 0.0, at: 0 });
        match recognise_in(datagrams, path, angles, beside)? {
            Recognised::Sensor(sensor, notes) => Ok((Self::Spinning(sensor), notes)),
            Recognised::Unreadable(name, remedy) => Err(Error::dataset(path, format!("{topic} has packets of a {name}, which are not read"), remedy)),
            Recognised::Nothing => {
                let problem = format!("{topic} has no packets of a sensor that is known ({}) among the first {count}", known().join(", "));
                Err(Error::dataset(path, problem, "have the sensor's driver make clouds of it, and record those"))
            }
        }
    }

    /// What makes scans of its packets.
    ///
    /// # Errors
    /// A file with angles that cannot be read any more.
    pub(crate) fn scans(&self) -> Result<PacketScans> {
        let assembler = match self {
            Self::Ouster(metadata) => Assembler::Ouster(Box::new(ScanAssembler::new((**metadata).clone()))),
            Self::Spinning(sensor) => Assembler::Spinning(Box::new(TurnAssembler::new(sensor.packets()?))),
        };
        Ok(PacketScans { assembler, host: HostClock::default() })
    }
}

#[derive(Debug)]
enum Assembler {
    Ouster(Box<ScanAssembler>),
    Spinning(Box<TurnAssembler>),
}

/// Makes scans of the packets of a sensor, with the times of the machine that received them.
#[derive(Debug)]
pub(crate) struct PacketScans {
    assembler: Assembler,
    host: HostClock,
}

impl PacketScans {
    /// Adds a packet that came at a time, seconds; whether it is one of the sensor.
    pub(crate) fn add(&mut self, packet: &[u8], came: f64) -> bool {
        let time = match &mut self.assembler {
            Assembler::Ouster(assembler) => assembler.add(packet),
            Assembler::Spinning(_) if is_about_device(packet) => None,
            Assembler::Spinning(assembler) => assembler.add(packet, came),
        };
        time.into_iter().for_each(|time| self.host.note(time, came));
        time.is_some()
    }

    /// The next complete scan.
    pub(crate) fn take_scan(&mut self) -> Option<StampedCloud> {
        let scan = match &mut self.assembler {
            Assembler::Ouster(assembler) => assembler.take_scan(),
            Assembler::Spinning(assembler) => assembler.take_scan(),
        };
        scan.map(|scan| self.in_host_time(scan))
    }

    /// The scan that is being collected, as far as it is worth mapping.
    pub(crate) fn take_unfinished(&mut self) -> Option<StampedCloud> {
        let scan = match &mut self.assembler {
            Assembler::Ouster(assembler) => assembler.take_rest(),
            Assembler::Spinning(assembler) => assembler.take_unfinished(),
        };
        scan.map(|scan| self.in_host_time(scan))
    }

    /// The samples of the sensor's inertial unit since the last call.
    pub(crate) fn take_imu(&mut self) -> Vec<ImuSample> {
        let Assembler::Ouster(assembler) = &mut self.assembler else { return Vec::new() };
        let at = |sample: ImuSample| ImuSample { time: self.host.time(sample.time), ..sample };
        assembler.take_imu().into_iter().map(at).collect()
    }

    /// What could not be used, in words.
    pub(crate) fn losses(&self) -> Option<String> {
        match &self.assembler {
            Assembler::Ouster(assembler) => {
                Some(assembler.skipped()).filter(|count| *count > 0).map(|count| format!("{count} packets are damaged or of another kind"))
            }
            Assembler::Spinning(assembler) => assembler.counts().words(0),
        }
    }

    fn in_host_time(&self, scan: StampedCloud) -> StampedCloud {
        StampedCloud { stamp: scan.stamp.map(|stamp| self.host.time(stamp)), ..scan }
    }
}
