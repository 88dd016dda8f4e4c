//! Captures: the datagrams of a sensor in a file.

use super::scan_assembler::ScanAssembler;
use super::sensor_metadata::SensorMetadata;
use crate::Result;
use crate::capture::{CapturedScans, Pcap};
use crate::stamped_cloud::StampedCloud;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::motion::ImuSample;
use voxelastic::sensor::BeamModel;

/// Name of the frame of the clouds.
pub(crate) const FRAME: &str = "os_sensor";

/// A capture that is read front to back.
#[derive(Debug)]
pub struct Capture {
    pcap: Pcap,
    assembler: ScanAssembler,
}

impl Capture {
    /// Opens a capture with the sensor's metadata.
    ///
    /// # Errors
    /// [`Error::Content`](crate::Error::Content) if either file is damaged or of an unknown kind; [`Error::Io`](crate::Error::Io).
    pub fn open(capture: impl AsRef<Path>, metadata: impl AsRef<Path>) -> Result<Self> {
        let metadata = SensorMetadata::read(metadata.as_ref())?;
        Ok(Self { pcap: Pcap::open(capture.as_ref())?, assembler: ScanAssembler::new(metadata) })
    }

    /// The sensor's beams, exactly as it was calibrated.
    ///
    /// # Errors
    /// Tables that no sensor has.
    pub fn model(&self) -> std::result::Result<BeamModel, voxelastic::sensor::SensorError> {
        self.assembler.metadata.model()
    }

    /// Pose of the inertial measurement unit in the sensor's frame, in which the clouds are.
    pub fn t_sensor_imu(&self) -> Pose {
        self.assembler.metadata.t_sensor_imu
    }

    /// The samples of the inertial measurement unit that came since the last call, in its frame and the sensor's clock.
    pub fn take_imu(&mut self) -> Vec<ImuSample> {
        self.assembler.take_imu()
    }

    /// Datagrams so far that were no lidar packets of this sensor, nor those of an inertial unit.
    pub fn skipped(&self) -> usize {
        self.assembler.skipped()
    }

    /// The next scan: its cloud, with times relative to the stamp, which is that of its first column in the sensor's clock, seconds.
    /// An error says once where a capture is cut.
    pub fn next_scan(&mut self) -> Option<Result<StampedCloud>> {
        loop {
            if let Some(scan) = self.assembler.take_scan() {
                return Some(Ok(scan));
            }
            match self.pcap.next() {
                Some(Ok(datagram)) => {
                    self.assembler.add(&datagram.payload);
                }
                Some(Err(error)) => return Some(Err(error)),
                None => return self.assembler.take_rest().map(Ok),
            }
        }
    }
}

impl CapturedScans for Capture {
    fn next_scan(&mut self) -> Option<Result<StampedCloud>> {
        Self::next_scan(self)
    }

    fn take_imu(&mut self) -> Vec<ImuSample> {
        Self::take_imu(self)
    }

    fn frame(&self) -> &'static str {
        FRAME
    }
}
