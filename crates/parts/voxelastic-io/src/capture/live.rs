//! The packets of a sensor that turns, as they come.

use super::recognise::{DetectedSensor, Kind, is_about_device, sensor_of};
use super::source_choice::{Fate, SensorPacket, SourceChoice};
use super::stream::message;
use super::turn_assembler::TurnAssembler;
use crate::Result;
use crate::playback::{MessageStream, SensorMessage};
use crate::stamped_cloud::StampedCloud;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How long a call waits for a packet.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// The sensor that is heard.
struct Sensor {
    kind: Kind,
    assembler: TurnAssembler,
    frame: &'static str,
}

/// What is known of a source that may be a sensor.
#[derive(Debug, Default)]
struct Known {
    /// What it has said about itself.
    device: Option<Vec<u8>>,
    /// A kind whose packets cannot be read, which was said.
    refused: Option<Kind>,
}

/// The messages of a sensor whose datagrams come. The first source with some that belong together says what sensor it is; what others send is ignored, and
/// said, until that one is silent.
pub(crate) struct SpinningStream {
    packets: Receiver<SensorPacket>,
    /// The file with the angles of the beams, if there is one.
    angles: Option<PathBuf>,
    sensor: Option<Sensor>,
    choice: SourceChoice<Kind, Known>,
    /// Where the datagrams come from, for messages.
    origin: PathBuf,
    start: Instant,
    pending: VecDeque<SensorMessage>,
}

impl SpinningStream {
    pub(crate) fn new(packets: Receiver<SensorPacket>, angles: Option<PathBuf>, origin: PathBuf) -> Self {
        Self { packets, angles, sensor: None, choice: SourceChoice::default(), origin, start: Instant::now(), pending: VecDeque::new() }
    }

    fn add(&mut self, packet: SensorPacket) -> Result<()> {
        let kind = Kind::of(&packet.payload);
        match self.choice.fate(&packet, kind) {
            Fate::Sensor => self.assemble(&packet),
            Fate::Another(address, is_new) => {
                if let (Some(kind), Some(sensor), true) = (kind, &self.sensor, is_new) {
                    let (name, source) = (kind.name(), packet.source);
                    tracing::warn!("packets of a {name} at {source} are ignored: the scans are those of a {} at {address}", sensor.kind.name());
                }
            }
            Fate::Candidate => return self.consider(packet, kind),
        }
        Ok(())
    }

    /// Takes the source of a packet for a sensor if enough of its packets belong together.
    fn consider(&mut self, packet: SensorPacket, kind: Option<Kind>) -> Result<()> {
        let (source, time) = (packet.source, packet.time);
        let is_device = is_about_device(&packet.payload);
        if !is_device && kind.is_none() {
            return Ok(());
        }
        let candidate = self.choice.candidate(source);
        if is_device {
            // Perhaps it was refused for want of this.
            candidate.note = Known { device: Some(packet.payload), refused: None };
            return Ok(());
        }
        let Some(kind) = kind.filter(|kind| candidate.note.refused != Some(*kind)) else { return Ok(()) };
        let Some(packets) = candidate.add(packet, kind) else { return Ok(()) };
        let known = &mut candidate.note;
        let found = sensor_of(kind, self.angles.as_deref(), known.device.clone(), &self.origin).inspect_err(|_| known.refused = Some(kind))?;
        let DetectedSensor { packets: layout, frame, words } = found;
        let old = self.sensor.replace(Sensor { kind, assembler: TurnAssembler::new(layout), frame });
        match self.choice.choose(source, kind, time) {
            None => tracing::info!("sensor: {words}, at {source}"),
            Some(before) => tracing::warn!("the sensor at {before} is silent; from now on the scans are those of another: {words}, at {source}"),
        }
        let unfinished = old.and_then(|mut old| Some(cloud(old.assembler.take_unfinished()?, old.frame, &self.origin)));
        self.pending.extend(unfinished);
        packets.iter().for_each(|packet| self.assemble(packet));
        Ok(())
    }

    /// Adds a packet of the sensor to its scans.
    fn assemble(&mut self, packet: &SensorPacket) {
        let Some(sensor) = &mut self.sensor else { return };
        sensor.assembler.add(&packet.payload, packet.time);
        while let Some(scan) = sensor.assembler.take_scan() {
            self.pending.push_back(cloud(scan, sensor.frame, &self.origin));
        }
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
            Ok(packet) => Some(self.add(packet).map(|()| self.pending.pop_front().unwrap_or(SensorMessage::Other))),
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Sender, channel};
    use voxelastic_testing::packets;

    const SENSOR: [u8; 4] = [10, 0, 0, 1];
    const OTHER: [u8; 4] = [10, 0, 0, 2];

    fn stream() -> (Sender<SensorPacket>, SpinningStream) {
        let (sender, packets) = channel();
        (sender, SpinningStream::new(packets, None, "test".into()))
    }

    /// Packets of a sensor whose walls are `distance` metres away; the last turn is not complete.
    fn packets(from: [u8; 4], start: f64, distance: f64) -> Vec<SensorPacket> {
        let made = packets::velodyne(start, 2.8, |_| (distance, 9));
        made.into_iter().map(|(time, payload)| SensorPacket { payload, source: from.into(), time }).collect()
    }

    /// Distances of the walls in the scans that come of the packets, and how many errors there were.
    fn seen(stream: &mut SpinningStream, sent: Vec<SensorPacket>) -> (Vec<f32>, usize) {
        let errors = sent.into_iter().filter_map(|packet| stream.add(packet).err()).count();
        let distance = |message| match message {
            SensorMessage::Cloud(cloud) => {
                let cloud = (cloud.decode)().unwrap().cloud;
                let [x, y, z] = cloud.points[0];
                Some((x * x + y * y + z * z).sqrt().round())
            }
            _ => None,
        };
        (stream.pending.drain(..).filter_map(distance).collect(), errors)
    }

    /// As if it were of a product that is not known.
    fn unknown(mut packet: SensorPacket) -> SensorPacket {
        *packet.payload.last_mut().unwrap() = 0xff;
        packet
    }

    #[test]
    fn one_packet_does_not_choose_the_sensor() {
        for (first, errors) in [(packets(OTHER, 0.0, 5.0).remove(0), 0), (unknown(packets(SENSOR, 0.0, 5.0).remove(0)), 0)] {
            let (_sender, mut stream) = stream();
            assert_eq!(seen(&mut stream, [vec![first], packets(SENSOR, 1.0, 8.0)].concat()), (vec![8.0, 8.0], errors));
        }
        // Nothing of the beginning is lost, and what comes between is left out.
        let (_sender, mut stream) = stream();
        let mut mixed = packets(SENSOR, 1.0, 8.0);
        for k in (20..100).step_by(10) {
            mixed.insert(k, unknown(mixed[k].clone()));
            mixed.insert(k, packets(OTHER, 1.0, 5.0).remove(k));
        }
        assert_eq!(seen(&mut stream, mixed), (vec![8.0, 8.0], 0));
        assert_eq!(stream.choice.ignored(), 2, "said once of each");
    }

    #[test]
    fn a_sensor_that_cannot_be_read_is_said_once_and_others_are_heard() {
        let (_sender, mut stream) = stream();
        let strange: Vec<_> = packets(SENSOR, 0.0, 5.0).into_iter().map(unknown).collect();
        assert_eq!(seen(&mut stream, strange), (vec![], 1));
        assert_eq!(seen(&mut stream, packets(SENSOR, 1.0, 8.0)), (vec![8.0, 8.0], 0));
    }

    #[test]
    fn a_sensor_that_is_silent_is_given_up() {
        let (_sender, mut stream) = stream();
        assert_eq!(seen(&mut stream, packets(SENSOR, 1.0, 8.0)).0, [8.0, 8.0]);
        assert_eq!(seen(&mut stream, packets(OTHER, 2.0, 5.0)).0, [0.0; 0], "the other was heard just now");
        // The turn that the first one had begun comes, too.
        assert_eq!(seen(&mut stream, packets(OTHER, 20.0, 5.0)).0, [8.0, 5.0, 5.0]);
        assert_eq!(seen(&mut stream, packets(SENSOR, 20.3, 8.0)).0, [0.0; 0]);
    }
}
