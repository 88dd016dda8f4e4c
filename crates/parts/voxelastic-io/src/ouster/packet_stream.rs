//! The datagrams of a sensor as a stream of messages, while they come.

use super::capture::FRAME;
use super::scan_assembler::ScanAssembler;
use super::sensor_metadata::SensorMetadata;
use crate::Result;
use crate::capture::message;
use crate::playback::{MessageStream, SensorMessage};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How long a call waits for a datagram.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// The message stream of a sensor. Its time is that of the datagrams' coming.
pub(crate) struct PacketStream {
    packets: Receiver<Vec<u8>>,
    assembler: ScanAssembler,
    /// Where the datagrams come from, for messages.
    origin: PathBuf,
    start: Instant,
    pending: VecDeque<SensorMessage>,
}

impl PacketStream {
    pub(crate) fn new(metadata: SensorMetadata, packets: Receiver<Vec<u8>>, origin: PathBuf) -> Self {
        Self { packets, assembler: ScanAssembler::new(metadata), origin, start: Instant::now(), pending: VecDeque::new() }
    }

    /// Moves what is complete to the messages.
    fn collect(&mut self) {
        self.pending.extend(self.assembler.take_imu().into_iter().map(SensorMessage::Imu));
        while let Some(scan) = self.assembler.take_scan() {
            let time = scan.stamp.unwrap_or(0.0);
            self.pending.push_back(SensorMessage::Cloud(message(scan, time, FRAME, &self.origin)));
        }
    }
}

impl MessageStream for PacketStream {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.pending.pop_front() {
            return Some(Ok(message));
        }
        match self.packets.recv_timeout(POLL_INTERVAL) {
            Ok(packet) => {
                self.assembler.add(&packet);
                self.collect();
                Some(Ok(self.pending.pop_front().unwrap_or(SensorMessage::Other)))
            }
            Err(RecvTimeoutError::Timeout) => Some(Ok(SensorMessage::Other)),
            // A turn that was not completed is worth mapping, too.
            Err(RecvTimeoutError::Disconnected) => {
                let scan = self.assembler.take_rest()?;
                let time = scan.stamp.unwrap_or(0.0);
                Some(Ok(SensorMessage::Cloud(message(scan, time, FRAME, &self.origin))))
            }
        }
    }

    fn now(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }
}
