//! Plays a recording without poses: clouds, each with the samples of the inertial measurement unit up to its end.

use crate::Result;
use crate::motion::{ImuMount, time_span};
use crate::playback::{ClockWatch, DeliveredScan, MessageStream, PlaybackLog, Polled, SensorMessage};
use crate::scan_list::NODES_OF_SENSOR;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::motion::ImuSample;

/// A cloud waits this long for the samples of its sweep, in seconds of recording: some drivers publish them late.
const LONGEST_WAIT_S: f64 = 0.5;

/// A cloud of a recording with its time.
pub(crate) struct RecordedScan {
    /// Index among all clouds of the recording.
    pub(crate) index: usize,
    pub(crate) node: NodeId,
    /// Seconds.
    pub(crate) time: f64,
    pub(crate) cloud: Cloud,
    /// Samples at the lidar since the cloud before, up to the end of this one.
    pub(crate) imu: Vec<ImuSample>,
}

/// Plays a stream.
pub(super) struct RawPlayer {
    /// `None` once it has ended.
    stream: Option<ClockWatch>,
    mount: Option<ImuMount>,
    log: Arc<PlaybackLog>,
    /// Clouds so far, and those of each sensor.
    clouds: usize,
    of_sensors: BTreeMap<u16, NodeId>,
    /// Samples that belong to no cloud yet.
    samples: Vec<ImuSample>,
    /// Clouds that wait for the samples of their sweeps, with the time at which each came.
    waiting: VecDeque<(f64, RecordedScan)>,
    /// Whether the clock went back, so that the samples so far are of no use to what comes.
    jumped: bool,
}

impl RawPlayer {
    pub(super) fn new(stream: Box<dyn MessageStream>, mount: Option<ImuMount>, log: Arc<PlaybackLog>) -> Self {
        Self {
            stream: Some(ClockWatch::new(stream)),
            mount,
            log,
            clouds: 0,
            of_sensors: BTreeMap::new(),
            samples: Vec::new(),
            waiting: VecDeque::new(),
            jumped: false,
        }
    }

    /// One that has nothing to play.
    pub(super) fn ended(log: Arc<PlaybackLog>) -> Self {
        Self { stream: None, mount: None, log, clouds: 0, of_sensors: BTreeMap::new(), samples: Vec::new(), waiting: VecDeque::new(), jumped: false }
    }

    /// The next cloud, or a part that cannot be read.
    pub(super) fn next(&mut self) -> Option<Result<RecordedScan>> {
        loop {
            match self.poll() {
                Polled::Item(scan) => return Some(scan),
                Polled::Nothing => {}
                Polled::End => return None,
            }
        }
    }

    /// One step: a cloud that is ready, else a message is read.
    pub(super) fn poll(&mut self) -> Polled<Result<RecordedScan>> {
        if self.jumped && self.waiting.is_empty() {
            self.samples.clear();
            self.jumped = false;
        }
        if self.is_ready() {
            return self.release().map_or(Polled::Nothing, |scan| Polled::Item(Ok(scan)));
        }
        match self.stream.as_mut().and_then(|stream| stream.next()) {
            None => {
                self.stream = None;
                self.release().map_or(Polled::End, |scan| Polled::Item(Ok(scan)))
            }
            Some(Ok(SensorMessage::Cloud(message))) => {
                let (index, time, sensor, sweep) = (self.clouds, message.time, message.sensor, message.sweep);
                self.clouds += 1;
                let of_sensor = self.of_sensors.entry(sensor).or_default();
                let node = NodeId::from(sensor) * NODES_OF_SENSOR + *of_sensor;
                *of_sensor += 1;
                match (message.decode)() {
                    Ok(decoded) => {
                        self.log.add(node, DeliveredScan { index: index as u64, motion: None, moved_by: None });
                        let scan = RecordedScan { index, node, time, cloud: Cloud { sensor, ..decoded.relative_to(time, sweep) }, imu: Vec::new() };
                        self.waiting.push_back((self.stream.as_ref().map_or(0.0, |stream| stream.now()), scan));
                        Polled::Nothing
                    }
                    Err(error) => Polled::Item(Err(error)),
                }
            }
            Some(Ok(SensorMessage::Imu(sample))) => {
                if let Some(mount) = &mut self.mount {
                    self.samples.push(mount.at_lidar(sample));
                }
                Polled::Nothing
            }
            Some(Ok(SensorMessage::ClockJump)) => {
                // What waits is of before, and gets no samples of after.
                self.waiting.iter_mut().for_each(|(came, _)| *came = f64::NEG_INFINITY);
                self.jumped = true;
                Polled::Nothing
            }
            Some(Ok(_)) => Polled::Nothing,
            Some(Err(error)) => Polled::Item(Err(error)),
        }
    }

    /// Whether the first cloud that waits need not wait any longer.
    fn is_ready(&self) -> bool {
        let Some((came, scan)) = self.waiting.front() else { return false };
        let is_covered = || self.samples.last().is_some_and(|sample| sample.time >= end(scan));
        self.mount.is_none() || is_covered() || self.stream.as_ref().is_none_or(|stream| stream.now() > came + LONGEST_WAIT_S)
    }

    /// Takes the first cloud that waits, with its samples.
    fn release(&mut self) -> Option<RecordedScan> {
        let (_, mut scan) = self.waiting.pop_front()?;
        let end = end(&scan);
        let count = if self.stream.is_none() && self.waiting.is_empty() {
            self.samples.len()
        } else {
            (self.samples.partition_point(|sample| sample.time < end) + 1).min(self.samples.len())
        };
        scan.imu = self.samples.drain(..count).collect();
        Some(scan)
    }
}

/// Time of the last point.
fn end(scan: &RecordedScan) -> f64 {
    scan.time + time_span(&scan.cloud).map_or(0.0, |(_, last)| f64::from(last)).max(0.0)
}
