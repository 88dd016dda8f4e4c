//! The input of odometry and localisation: scans without poses, from a folder or a recording.

use clap::Args;
use std::path::{Path, PathBuf};
use voxelastic_io::raw::{self, RawScans};
use voxelastic_io::{OpenOptions, PointTimes};
use voxelastic_run::{Source, Warnings};

/// Arguments that select and describe scans without poses.
#[derive(Debug, Args)]
#[command(next_help_heading = "Input")]
pub struct RawDataArgs {
    /// Folder with scans, or a recording: .bag, .mcap, .db3, the folder of a ROS 2 bag, a .pcap of an Ouster, Velodyne, Hesai or RoboSense sensor. Poses in it are not used
    #[arg(value_name = "DATA", help_heading = None)]
    data: PathBuf,
    /// The topic of the clouds in a recording, if there are several
    #[arg(long, value_name = "TOPIC")]
    cloud_topic: Option<String>,
    /// The topic of the inertial measurement unit in a recording, if it is to be another than the first whose place relative to the lidar is known
    #[arg(long, value_name = "TOPIC", conflicts_with = "no_imu")]
    imu_topic: Option<String>,
    /// Do not use the inertial measurement unit of the data
    #[arg(long)]
    no_imu: bool,
    /// Of packets: the metadata (.json) of an Ouster sensor, or the angles of the beams (.csv) of a Hesai or RoboSense, if they are not found by name
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    metadata: Option<PathBuf>,
    /// What the times of points mean: what they say (given), the part of a sweep that takes until the next cloud comes, of ten a second where clouds have no times (over-interval), or nothing, because clouds are undistorted already (undistorted) [default: given; where they contradict the interval between clouds, or clouds seem to be undistorted already, the reading under which surfaces are sharpest]
    #[arg(long, value_name = "WHAT", hide_short_help = true)]
    point_times: Option<PointTimes>,
}

impl RawDataArgs {
    /// The folder or file.
    pub fn path(&self) -> &Path {
        &self.data
    }

    /// Opens the folder or recording, with what the times of its points mean decided. Also whether clouds are to be undistorted.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(&self, warnings: &mut Warnings) -> voxelastic_run::Result<(RawScans, bool)> {
        let options = OpenOptions {
            cloud_topic: self.cloud_topic.clone(),
            imu_topic: self.imu_topic.clone(),
            use_imu: !self.no_imu,
            metadata: self.metadata.clone(),
            point_times: self.point_times.unwrap_or_default(),
            ..OpenOptions::default()
        };
        let (_, options) = Source::open_decided(&self.data, &options, Some(true), warnings)?;
        Ok((raw::open(&self.data, &options)?, options.point_times != PointTimes::Undistorted))
    }
}
