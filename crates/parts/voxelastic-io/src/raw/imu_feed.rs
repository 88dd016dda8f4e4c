//! The samples of an inertial measurement unit in a folder, dealt out to the scans.

use crate::motion::{ImuMount, time_span};
use crate::{Result, imu_csv};
use std::path::Path;
use std::sync::Arc;
use voxelastic::Cloud;
use voxelastic::motion::ImuSample;

/// Samples at the lidar.
#[derive(Clone, Debug)]
pub(super) struct FolderImu(Arc<[ImuSample]>);

impl FolderImu {
    /// The samples of a folder, if it has some.
    pub(super) fn find(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(imu_csv::FOLDER).join(imu_csv::FILE);
        if !path.is_file() {
            return Ok(None);
        }
        let (t_lidar_imu, samples) = imu_csv::read(path)?;
        let mut mount = ImuMount::new(t_lidar_imu);
        Ok(Some(Self(samples.into_iter().map(|sample| mount.at_lidar(sample)).collect())))
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Those after the `from`th that a scan needs: up to the first at or after the end of its sweep.
    pub(super) fn until(&self, from: usize, cloud: &Cloud, time: f64) -> &[ImuSample] {
        let end = time + time_span(cloud).map_or(0.0, |(_, last)| f64::from(last)).max(0.0);
        let rest = self.0.get(from..).unwrap_or_default();
        let count = rest.partition_point(|sample| sample.time < end);
        &rest[..(count + 1).min(rest.len())]
    }
}
