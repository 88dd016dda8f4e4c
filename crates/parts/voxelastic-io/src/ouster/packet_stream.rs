//! The datagrams of a sensor as a stream of messages, while they come.

use super::capture::FRAME;
use super::packet::has_columns;
use super::scan_assembler::ScanAssembler;
use super::sensor_metadata::SensorMetadata;
use crate::Result;
use crate::capture::{Fate, SensorPacket, SourceChoice, message};
use crate::playback::{MessageStream, SensorMessage};
use crate::stamped_cloud::StampedCloud;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How long a call waits for a datagram.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// The message stream of a sensor. Its time is that of the datagrams' coming. The first source with some packets of this sensor, one after the other, is the
/// sensor; what others send is ignored, and said, until that one is silent.
pub(crate) struct PacketStream {
    packets: Receiver<SensorPacket>,
    assembler: ScanAssembler,
    choice: SourceChoice<()>,
    /// Where the datagrams come from, for messages.
    origin: PathBuf,
    start: Instant,
    pending: VecDeque<SensorMessage>,
}

impl PacketStream {
    pub(crate) fn new(metadata: SensorMetadata, packets: Receiver<SensorPacket>, origin: PathBuf) -> Self {
        let assembler = ScanAssembler::new(metadata);
        Self { packets, assembler, choice: SourceChoice::default(), origin, start: Instant::now(), pending: VecDeque::new() }
    }

    fn add(&mut self, packet: SensorPacket) {
        let kind = has_columns(&self.assembler.metadata, &packet.payload).then_some(());
        match self.choice.fate(&packet, kind) {
            Fate::Sensor => self.assemble(&packet.payload),
            Fate::Another(address, true) => {
                tracing::warn!("packets of another sensor at {} are ignored: the scans are those of the one at {address}", packet.source);
            }
            Fate::Candidate if kind.is_some() => self.consider(packet),
            Fate::Another(..) | Fate::Candidate => {}
        }
    }

    /// Takes the source of a packet of columns for the sensor if enough of them came.
    fn consider(&mut self, packet: SensorPacket) {
        let (address, time) = (packet.source, packet.time);
        let Some(packets) = self.choice.candidate(address).add(packet, ()) else { return };
        match self.choice.choose(address, (), time) {
            None => tracing::info!("the sensor is at {address}"),
            Some(before) => {
                tracing::warn!("the sensor at {before} is silent; from now on the scans are those of the one at {address}");
                let rest = self.assembler.take_rest();
                self.pending.extend(rest.map(|scan| cloud(scan, &self.origin)));
            }
        }
        packets.iter().for_each(|packet| self.assemble(&packet.payload));
    }

    /// Adds a packet of the sensor, and moves what is complete to the messages.
    fn assemble(&mut self, payload: &[u8]) {
        self.assembler.add(payload);
        self.pending.extend(self.assembler.take_imu().into_iter().map(SensorMessage::Imu));
        while let Some(scan) = self.assembler.take_scan() {
            self.pending.push_back(cloud(scan, &self.origin));
        }
    }
}

fn cloud(scan: StampedCloud, origin: &Path) -> SensorMessage {
    let time = scan.stamp.unwrap_or(0.0);
    SensorMessage::Cloud(message(scan, time, FRAME, origin))
}

impl MessageStream for PacketStream {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.pending.pop_front() {
            return Some(Ok(message));
        }
        match self.packets.recv_timeout(POLL_INTERVAL) {
            Ok(packet) => {
                self.add(packet);
                Some(Ok(self.pending.pop_front().unwrap_or(SensorMessage::Other)))
            }
            Err(RecvTimeoutError::Timeout) => Some(Ok(SensorMessage::Other)),
            // A turn that was not completed is worth mapping, too.
            Err(RecvTimeoutError::Disconnected) => Some(Ok(cloud(self.assembler.take_rest()?, &self.origin))),
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

    const SENSOR: [u8; 4] = [10, 0, 0, 1];
    const OTHER: [u8; 4] = [10, 0, 0, 2];
    /// Of a packet with the old layout: sixteen columns of sixteen rows.
    const COLUMN: usize = 16 + 12 * 16 + 4;

    fn stream() -> (Sender<SensorPacket>, PacketStream) {
        let json = serde_json::json!({
            "beam_altitude_angles": (0..16).map(|row| f64::from(8 - row)).collect::<Vec<_>>(),
            "beam_azimuth_angles": vec![0.0; 16],
            "lidar_mode": "512x10",
        });
        let metadata = SensorMetadata::parse(json.to_string().as_bytes(), Path::new("test")).unwrap();
        let (sender, packets) = channel();
        (sender, PacketStream::new(metadata, packets, "test".into()))
    }

    /// Packets of turns of a sensor whose walls are so many metres away; the last turn has a single one.
    fn packets(from: [u8; 4], start: f64, distance: u32) -> Vec<SensorPacket> {
        let packet = |k: usize| {
            let column = |number: usize| {
                let mut column = vec![0; COLUMN];
                let turn = (start as usize + k / 32) as u16;
                column[..8].copy_from_slice(&(((start * 10.0) as u64 + k as u64) * 1_000_000).to_le_bytes());
                column[8..10].copy_from_slice(&(number as u16).to_le_bytes());
                column[10..12].copy_from_slice(&turn.to_le_bytes());
                (0..16).for_each(|row| column[16 + 12 * row..20 + 12 * row].copy_from_slice(&(distance * 1000).to_le_bytes()));
                column[COLUMN - 4..].fill(0xff);
                column
            };
            let payload = (0..16).flat_map(|c| column(k % 32 * 16 + c)).collect();
            SensorPacket { payload, source: from.into(), time: start + k as f64 * 0.003 }
        };
        (0..65).map(packet).collect()
    }

    /// Distances of the walls in the scans that come of the packets.
    fn seen(stream: &mut PacketStream, sent: Vec<SensorPacket>) -> Vec<f32> {
        sent.into_iter().for_each(|packet| stream.add(packet));
        let distance = |message| match message {
            SensorMessage::Cloud(cloud) => {
                let cloud = (cloud.decode)().unwrap().cloud;
                let [x, y, z] = *cloud.points.iter().find(|point| point[0].is_finite()).unwrap();
                Some((x * x + y * y + z * z).sqrt().round())
            }
            _ => None,
        };
        stream.pending.drain(..).filter_map(distance).collect()
    }

    #[test]
    fn one_packet_does_not_choose_the_sensor() {
        let (_sender, mut stream) = stream();
        let mut mixed = packets(SENSOR, 100.0, 8);
        mixed.insert(0, packets(OTHER, 7.0, 5).remove(0));
        for k in (20..60).step_by(10) {
            mixed.insert(k, packets(OTHER, 100.0, 5).remove(k));
            // None of this sensor, and none of its inertial unit.
            mixed.insert(k, SensorPacket { payload: vec![7; 48], source: OTHER.into(), time: 100.1 });
        }
        assert_eq!(seen(&mut stream, mixed), [8.0, 8.0], "nothing of the beginning is lost");
        assert_eq!(stream.choice.ignored(), 1, "said once");
    }

    #[test]
    fn a_sensor_that_is_silent_is_given_up() {
        let (_sender, mut stream) = stream();
        assert_eq!(seen(&mut stream, packets(SENSOR, 100.0, 8)), [8.0, 8.0]);
        assert_eq!(seen(&mut stream, packets(OTHER, 102.0, 5)), [0.0; 0], "the other was heard just now");
        // The turn that the first one had begun comes, too.
        assert_eq!(seen(&mut stream, packets(OTHER, 120.0, 5)), [8.0, 5.0, 5.0]);
        assert_eq!(seen(&mut stream, packets(SENSOR, 120.3, 8)), [0.0; 0]);
    }
}
