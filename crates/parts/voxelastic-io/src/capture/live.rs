//! The packets of a sensor that turns, as they come.

use super::recognise::{DetectedSensor, is_about_device, sensor_of};
use super::stream::message;
use super::turn_assembler::TurnAssembler;
use crate::Result;
use crate::playback::{MessageStream, SensorMessage};
use crate::stamped_cloud::StampedCloud;
use std::collections::VecDeque;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How long a call waits for a packet.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// A datagram of a sensor.
#[derive(Clone, Debug)]
pub struct SensorPacket {
    /// Its content.
    pub payload: Vec<u8>,
    /// Who sent it.
    pub source: IpAddr,
    /// When it came, seconds since 1970.
    pub time: f64,
}

/// A sensor that was recognised.
struct Sensor {
    source: IpAddr,
    assembler: TurnAssembler,
    frame: &'static str,
}

/// The messages of a sensor whose datagrams come. The first one that is recognised says what sensor it is; what others send is ignored from then on.
pub(crate) struct SpinningStream {
    packets: Receiver<SensorPacket>,
    /// The file with the angles of the beams, if there is one.
    angles: Option<PathBuf>,
    sensor: Option<Sensor>,
    /// What a sensor that was not recognised yet said about itself.
    device: Option<(IpAddr, Vec<u8>)>,
    /// Whether it was said that packets cannot be read.
    is_refused: bool,
    /// Where the datagrams come from, for messages.
    origin: PathBuf,
    start: Instant,
    pending: VecDeque<SensorMessage>,
}

impl SpinningStream {
    pub(crate) fn new(packets: Receiver<SensorPacket>, angles: Option<PathBuf>, origin: PathBuf) -> Self {
        Self { packets, angles, sensor: None, device: None, is_refused: false, origin, start: Instant::now(), pending: VecDeque::new() }
    }

    fn add(&mut self, packet: &SensorPacket) -> Result<()> {
        if self.sensor.is_none() && is_about_device(&packet.payload) {
            // Perhaps it was refused for want of this.
            (self.device, self.is_refused) = (Some((packet.source, packet.payload.clone())), false);
            return Ok(());
        }
        if self.sensor.is_none() && !self.is_refused {
            let device = self.device.as_ref().filter(|(source, _)| *source == packet.source).map(|(_, device)| device.clone());
            let found = sensor_of(&packet.payload, self.angles.as_deref(), device, &self.origin).inspect_err(|_| self.is_refused = true)?;
            self.sensor = found.map(|DetectedSensor { packets, frame, words }| {
                tracing::info!("sensor: {words}, at {}", packet.source);
                Sensor { source: packet.source, assembler: TurnAssembler::new(packets), frame }
            });
        }
        if let Some(sensor) = self.sensor.as_mut().filter(|sensor| sensor.source == packet.source) {
            sensor.assembler.add(&packet.payload, packet.time);
            while let Some(scan) = sensor.assembler.take_scan() {
                self.pending.push_back(cloud(scan, sensor.frame, &self.origin));
            }
        }
        Ok(())
    }
}

fn cloud(scan: StampedCloud, frame: &str, origin: &Path) -> SensorMessage {
    let time = scan.stamp.unwrap_or(0.0);
    SensorMessage::Cloud(message(scan, time, frame, origin))
}

impl MessageStream for SpinningStream {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.pending.pop_front() {
            return Some(Ok(message));
        }
        match self.packets.recv_timeout(POLL_INTERVAL) {
            Ok(packet) => Some(self.add(&packet).map(|()| self.pending.pop_front().unwrap_or(SensorMessage::Other))),
            Err(RecvTimeoutError::Timeout) => Some(Ok(SensorMessage::Other)),
            // A turn that was not completed is worth mapping, too.
            Err(RecvTimeoutError::Disconnected) => {
                let Sensor { mut assembler, frame, .. } = self.sensor.take()?;
                Some(Ok(cloud(assembler.take_unfinished()?, frame, &self.origin)))
            }
        }
    }

    fn now(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }
}
