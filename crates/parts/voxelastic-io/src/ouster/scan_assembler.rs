//! Packets to clouds, one per revolution of the sensor.

use super::packet;
use super::sensor_metadata::SensorMetadata;
use crate::stamped_cloud::StampedCloud;
use std::collections::VecDeque;
use voxelastic::Cloud;
use voxelastic::motion::ImuSample;

/// Time of a column that was not received.
const NO_COLUMN: u64 = u64::MAX;

/// Collects the packets of a sensor.
#[derive(Debug)]
pub(crate) struct ScanAssembler {
    pub(super) metadata: SensorMetadata,
    /// The revolution that is being collected.
    current: Option<Revolution>,
    /// Revolutions of which columns of the next one have arrived.
    complete: VecDeque<Revolution>,
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

impl ScanAssembler {
    pub(crate) fn new(metadata: SensorMetadata) -> Self {
        Self { metadata, current: None, complete: VecDeque::new(), skipped: 0, samples: Vec::new() }
    }

    /// The samples of the inertial measurement unit that came since the last call.
    pub(crate) fn take_imu(&mut self) -> Vec<ImuSample> {
        std::mem::take(&mut self.samples)
    }

    /// Datagrams so far that were no packets of this sensor.
    pub(crate) fn skipped(&self) -> usize {
        self.skipped
    }

    /// The next complete scan.
    pub(crate) fn take_scan(&mut self) -> Option<StampedCloud> {
        let revolution = self.complete.pop_front()?;
        Some(self.cloud(&revolution))
    }

    /// The scan that is being collected, as far as it is there.
    pub(crate) fn take_rest(&mut self) -> Option<StampedCloud> {
        let revolution = self.current.take()?;
        Some(self.cloud(&revolution))
    }

    /// Adds the content of a datagram. Returns its time in the sensor's clock, seconds, if it is one of the sensor.
    pub(crate) fn add(&mut self, payload: &[u8]) -> Option<f64> {
        let payload = packet::trimmed(&self.metadata, payload);
        if let Some(sample) = packet::imu(payload) {
            self.samples.push(sample);
            return Some(sample.time);
        }
        let columns = packet::columns(&self.metadata, payload);
        self.skipped += usize::from(columns.is_empty());
        let time = columns.first().map(|column| column.time_ns as f64 * 1e-9);
        for column in columns {
            if self.current.as_ref().is_some_and(|revolution| revolution.frame != column.frame) {
                self.complete.extend(self.current.take());
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
        time
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
            sensor: 0,
        };
        let (Some(intensity), Some(times)) = (&mut cloud.intensity, &mut cloud.time) else {
            return StampedCloud::new(cloud, None);
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
        StampedCloud::new(cloud, Some(first as f64 * 1e-9))
    }
}
