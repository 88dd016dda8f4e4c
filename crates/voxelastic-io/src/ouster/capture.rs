//! Packets to clouds, one per revolution of the sensor.

use super::packet;
use super::pcap::Pcap;
use super::sensor_metadata::SensorMetadata;
use crate::Result;
use crate::stamped_cloud::StampedCloud;
use std::path::Path;
use voxelastic::motion::ImuSample;
use voxelastic::sensor::BeamModel;
use voxelastic::{Cloud, Pose};

/// Time of a column that was not received.
const NO_COLUMN: u64 = u64::MAX;

/// A capture that is read front to back.
#[derive(Debug)]
pub struct Capture {
    pcap: Pcap,
    metadata: SensorMetadata,
    /// The revolution that is being collected.
    current: Option<Revolution>,
    /// A complete revolution: a column of the next one has arrived.
    complete: Option<Revolution>,
    skipped: usize,
    /// Samples of the inertial measurement unit since they were last taken.
    samples: Vec<ImuSample>,
}

/// The returns of one revolution, staggered as they were fired.
#[derive(Debug)]
struct Revolution {
    frame: u16,
    /// Time of each column, nanoseconds; [`NO_COLUMN`] where it is missing.
    times: Vec<u64>,
    /// Metres, `row * columns + column`, staggered.
    ranges: Vec<f32>,
    reflectivity: Vec<f32>,
}

impl Revolution {
    fn new(metadata: &SensorMetadata, frame: u16) -> Self {
        let pixels = metadata.rows() * metadata.columns;
        Self { frame, times: vec![NO_COLUMN; metadata.columns], ranges: vec![0.0; pixels], reflectivity: vec![0.0; pixels] }
    }
}

impl Capture {
    /// Opens a capture with the sensor's metadata.
    ///
    /// # Errors
    /// [`Error::Content`](crate::Error::Content) if either file is damaged or of an unknown kind; [`Error::Io`](crate::Error::Io).
    pub fn open(capture: impl AsRef<Path>, metadata: impl AsRef<Path>) -> Result<Self> {
        let metadata = SensorMetadata::read(metadata.as_ref())?;
        Ok(Self { metadata, pcap: Pcap::open(capture.as_ref())?, current: None, complete: None, skipped: 0, samples: Vec::new() })
    }

    /// The sensor's beams, exactly as it was calibrated.
    ///
    /// # Errors
    /// Tables that no sensor has.
    pub fn model(&self) -> std::result::Result<BeamModel, voxelastic::sensor::SensorError> {
        self.metadata.model()
    }

    /// Pose of the inertial measurement unit in the sensor's frame, in which the clouds are.
    pub fn t_sensor_imu(&self) -> Pose {
        self.metadata.t_sensor_imu
    }

    /// The samples of the inertial measurement unit that came since the last call, in its frame and the sensor's clock.
    pub fn take_imu(&mut self) -> Vec<ImuSample> {
        std::mem::take(&mut self.samples)
    }

    /// Datagrams so far that were no lidar packets of this sensor, nor those of an inertial unit.
    pub fn skipped(&self) -> usize {
        self.skipped
    }

    /// The next scan: its cloud, with times relative to the stamp, which is that of its first column in the sensor's clock, seconds.
    /// An error says once where a capture is cut.
    pub fn next_scan(&mut self) -> Option<Result<StampedCloud>> {
        loop {
            if let Some(revolution) = self.complete.take() {
                return Some(Ok(self.cloud(&revolution)));
            }
            match self.pcap.next() {
                Some(Ok(datagram)) => self.add(&datagram.payload),
                Some(Err(error)) => return Some(Err(error)),
                None => return self.current.take().map(|revolution| Ok(self.cloud(&revolution))),
            }
        }
    }

    fn add(&mut self, payload: &[u8]) {
        if let Some(sample) = packet::imu(payload) {
            self.samples.push(sample);
            return;
        }
        let columns = packet::columns(&self.metadata, payload);
        self.skipped += usize::from(columns.is_empty());
        for column in columns {
            if self.current.as_ref().is_some_and(|revolution| revolution.frame != column.frame) {
                self.complete = self.current.take();
            }
            let revolution = self.current.get_or_insert_with(|| Revolution::new(&self.metadata, column.frame));
            revolution.times[column.number] = column.time_ns;
            for row in 0..self.metadata.rows() {
                let measured = column.at(row);
                let pixel = row * self.metadata.columns + column.number;
                revolution.ranges[pixel] = measured.range as f32;
                revolution.reflectivity[pixel] = measured.reflectivity.into();
            }
        }
    }

    /// The points of a revolution, destaggered.
    fn cloud(&self, revolution: &Revolution) -> StampedCloud {
        let (rows, columns) = (self.metadata.rows(), self.metadata.columns);
        let first = revolution.times.iter().copied().filter(|t| *t != NO_COLUMN).min().unwrap_or(0);
        let mut cloud = Cloud {
            points: vec![[f32::NAN; 3]; rows * columns],
            width: columns,
            height: rows,
            intensity: Some(vec![0.0; rows * columns]),
            ring: Some((0..rows * columns).map(|k| (k / columns) as u16).collect()),
            time: Some(vec![0.0; rows * columns]),
            colours: None,
            motion: None,
        };
        let (Some(intensity), Some(times)) = (&mut cloud.intensity, &mut cloud.time) else {
            return StampedCloud { cloud, stamp: None };
        };
        for row in 0..rows {
            let shift = self.metadata.shift(row);
            for column in 0..columns {
                let (from, to) = (row * columns + column, row * columns + (column + shift) % columns);
                let (range, time) = (f64::from(revolution.ranges[from]), revolution.times[column]);
                if time != NO_COLUMN {
                    times[to] = (time.saturating_sub(first)) as f32 * 1e-9;
                }
                if range > 0.0 {
                    let (direction, origin) = self.metadata.beam(row, column);
                    // Ranges are measured from the lidar's origin; beams start at a distance from it.
                    let along = range - self.metadata.origin_radius;
                    cloud.points[to] = std::array::from_fn(|k| (origin[k] + direction[k] * along) as f32);
                    intensity[to] = revolution.reflectivity[from];
                }
            }
        }
        StampedCloud { cloud, stamp: Some(first as f64 * 1e-9) }
    }
}
