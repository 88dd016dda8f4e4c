//! The input: a folder of scans and poses, or a recording, and the selection of its scans.

use crate::failure::Failure;
use clap::Args;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::geometry::PoseChange;
use voxelastic_io::source::Source;
use voxelastic_io::{Keyframing, OpenOptions, PointTimes, PoseKind, SensorFolder, SensorTopic};
use voxelastic_run::precision::{LARGEST_VEHICLE, near};
use voxelastic_run::source::Examination;
use voxelastic_run::{HoldOut, PosesCheck, Warnings};

/// Largest time difference between a scan and its pose if nothing else is said, seconds.
const TIME_TOLERANCE_S: f64 = 0.01;

/// Arguments that select and describe the input.
#[derive(Debug, Args)]
#[command(next_help_heading = "Input")]
pub struct DataArgs {
    /// Folder with scans and poses, or a recording: .bag, .mcap, .db3, the folder of a ROS 2 bag, a .pcap of an Ouster, Velodyne, Hesai or RoboSense sensor
    #[arg(value_name = "DATA", help_heading = None)]
    data: PathBuf,
    #[command(flatten)]
    reading: ReadingArgs,
}

/// Arguments that say how the input is read.
#[derive(Clone, Debug, PartialEq, Args)]
#[command(next_help_heading = "Input")]
pub struct ReadingArgs {
    /// The pose file, if there are several: a path, or a part of a file name in DATA that is unique
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// The g2o pose graph with loop and odometry edges, named as for --poses; for a recording also a folder of corrected
    /// trajectories, each named by the time from which it holds (poses@SECONDS.tum)
    #[arg(long, value_name = "FILE.g2o", hide_short_help = true)]
    graph: Option<PathBuf>,
    /// Pose of the lidar in the vehicle frame, where the poses in the files are those of the vehicle; for several sensors one for each --cloud-topic
    #[arg(long, value_name = "\"X Y Z QX QY QZ QW\"", value_parser = pose, allow_hyphen_values = true)]
    t_base_lidar: Vec<Pose>,
    /// Read the poses otherwise than they are written, parts with commas: inverse, w-first, scale=FACTOR, rows=N (scan k has the pose of scan k + N), seconds=S (a scan has the pose of S seconds later)
    #[arg(long, value_name = "PARTS", value_parser = pose_change, default_value = "", hide_default_value = true, hide_short_help = true)]
    pose_change: PoseChange,
    /// Interval between the scans used: scan (all), a number (every Nth), a distance (2m) or a time (0.5s) [default: scan; for recordings 2m]
    #[arg(long, value_name = "scan|N|METRESm|SECONDSs")]
    every: Option<Keyframing>,
    /// The topic of the clouds in a recording, if there are several; given more than once, the sensors are mapped together. Poses that do not say whose they are
    /// are those of the first
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    cloud_topic: Vec<String>,
    /// A folder with the scans and poses of a further sensor, which is mapped together with DATA; may be given several times. With --t-base-lidar there is one
    /// for each folder, in their order. Where the poses are estimated, they are those of DATA, and --t-base-lidar says where the others are
    #[arg(long, value_name = "FOLDER", hide_short_help = true)]
    also: Vec<PathBuf>,
    /// The topic of the poses in a recording (odometry, path, stamped poses, /tf), if there are several
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    pose_topic: Option<String>,
    /// The topic of corrected poses of the scans so far: paths with the time stamps of the scans, as SLAM systems publish them after a loop
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    correction_topic: Option<String>,
    /// Without poses: the topic of the inertial measurement unit in a recording, if it is to be another than the first whose place relative to the lidar is known
    #[arg(long, value_name = "TOPIC", conflicts_with = "no_imu", hide_short_help = true)]
    imu_topic: Option<String>,
    /// Without poses: do not use the inertial measurement unit of the data
    #[arg(long, hide_short_help = true)]
    no_imu: bool,
    /// Of packets: the metadata (.json) of an Ouster sensor, or the angles of the beams (.csv) of a Hesai or RoboSense, if they are not found by name
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    metadata: Option<PathBuf>,
    /// What the times of points mean: what they say (given), the part of a sweep that takes until the next cloud comes, of ten a second where clouds have no times (over-interval), or nothing, because clouds are undistorted already (undistorted) [default: given; where they contradict the interval between clouds, or clouds seem to be undistorted already, the reading under which surfaces are sharpest]
    #[arg(long, value_name = "WHAT", hide_short_help = true)]
    point_times: Option<PointTimes>,
    /// Largest time difference between a scan and its pose, seconds
    #[arg(long, value_name = "S", default_value_t = TIME_TOLERANCE_S, value_parser = seconds, hide_short_help = true)]
    time_tolerance: f64,
}

impl Default for ReadingArgs {
    fn default() -> Self {
        Self {
            poses: None,
            graph: None,
            t_base_lidar: Vec::new(),
            pose_change: PoseChange::default(),
            every: None,
            cloud_topic: Vec::new(),
            also: Vec::new(),
            pose_topic: None,
            correction_topic: None,
            imu_topic: None,
            no_imu: false,
            metadata: None,
            point_times: None,
            time_tolerance: TIME_TOLERANCE_S,
        }
    }
}

impl DataArgs {
    /// Data at `data`, read as `reading` says.
    pub fn at(data: &Path, reading: &ReadingArgs) -> Self {
        Self { data: data.to_owned(), reading: reading.clone() }
    }

    /// The folder or file.
    pub fn path(&self) -> &Path {
        &self.data
    }

    /// Whether anything was said of how the input is read.
    pub fn says_how_to_read(&self) -> bool {
        self.reading != ReadingArgs::default()
    }

    /// How the data are read, in words.
    pub fn identity(&self) -> String {
        format!("{:?}", self.options(false))
    }

    /// The flag about poses that was given, if one was. Of several sensors --t-base-lidar says where they are on each other, with poses and without.
    pub fn names_poses(&self) -> Option<&'static str> {
        let given = [
            ("--poses", self.reading.poses.is_some()),
            ("--graph", self.reading.graph.is_some()),
            ("--pose-change", !self.reading.pose_change.is_none()),
            ("--pose-topic", self.reading.pose_topic.is_some()),
            ("--correction-topic", self.reading.correction_topic.is_some()),
            ("--t-base-lidar", !self.reading.t_base_lidar.is_empty() && !self.has_several_sensors()),
        ];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(flag, _)| flag)
    }

    /// Options for reading the input; `strict` makes scans without a pose an error.
    pub fn options(&self, strict: bool) -> OpenOptions {
        OpenOptions {
            poses: self.reading.poses.clone(),
            pose_kind: PoseKind::default(),
            graph: self.reading.graph.clone(),
            t_base_lidar: self.reading.t_base_lidar.first().copied(),
            pose_change: self.reading.pose_change,
            strict,
            keyframing: self.reading.every,
            cloud_topic: self.reading.cloud_topic.first().cloned(),
            more_sensors: self.more_sensors(),
            more_folders: self.more_folders(),
            pose_topic: self.reading.pose_topic.clone(),
            correction_topic: self.reading.correction_topic.clone(),
            imu_topic: self.reading.imu_topic.clone(),
            use_imu: !self.reading.no_imu,
            metadata: self.reading.metadata.clone(),
            point_times: self.reading.point_times.unwrap_or_default(),
            time_tolerance_s: self.reading.time_tolerance,
            mount_timeout_s: None,
        }
    }

    /// The sensors after the first.
    fn more_sensors(&self) -> Vec<SensorTopic> {
        let ReadingArgs { cloud_topic, t_base_lidar, .. } = &self.reading;
        let sensor = |(k, topic): (usize, &String)| SensorTopic { topic: topic.clone(), t_base_lidar: t_base_lidar.get(k).copied() };
        cloud_topic.iter().enumerate().skip(1).map(sensor).collect()
    }

    /// The folders after the first.
    fn more_folders(&self) -> Vec<SensorFolder> {
        let ReadingArgs { also, t_base_lidar, .. } = &self.reading;
        let folder = |(k, path): (usize, &PathBuf)| SensorFolder { path: path.clone(), t_base_lidar: t_base_lidar.get(k + 1).copied() };
        also.iter().enumerate().map(folder).collect()
    }

    /// Whether several sensors are named.
    fn has_several_sensors(&self) -> bool {
        !self.reading.also.is_empty() || self.reading.cloud_topic.len() > 1
    }

    /// Refuses poses of sensors that are not named, and flags about poses where `slam` has them estimated.
    ///
    /// # Errors
    /// A usage error.
    pub fn check(&self, slam: bool) -> Result<(), Failure> {
        if slam && let Some(flag) = self.names_poses() {
            return Err(Failure::usage(format!("--slam estimates the poses, so {flag} has no meaning with it"), "do without one of the two"));
        }
        let (topics, poses, also) = (self.reading.cloud_topic.len(), self.reading.t_base_lidar.len(), self.reading.also.len());
        if also > 0 && poses > 0 && poses != also + 1 {
            let problem = format!("{poses} x --t-base-lidar, but {} folders", also + 1);
            return Err(Failure::usage(problem, "give one pose for each folder, in their order, or none"));
        }
        if also > 0 {
            return Ok(());
        }
        if poses > 1 && poses != topics {
            let problem = format!("{poses} x --t-base-lidar, but {topics} x --cloud-topic");
            return Err(Failure::usage(problem, "give one pose for each topic of clouds, in their order"));
        }
        Ok(())
    }

    /// Opens the data: with its poses, which are compared with the scans, or raw if it has none or `slam` asks for that. Also what was seen, unless `poses` says not to look.
    ///
    /// # Errors
    /// A usage error, or when the data cannot be read.
    pub fn source(
        &self,
        strict: bool,
        slam: bool,
        pose_kind: PoseKind,
        poses: PosesCheck,
        warnings: &mut Warnings,
    ) -> anyhow::Result<(voxelastic_run::Source, Option<Examination>)> {
        self.check(slam)?;
        let options = OpenOptions { pose_kind, ..self.options(strict) };
        Ok(voxelastic_run::Source::open_checked(&self.data, &options, slam.then_some(true), poses, warnings)?)
    }

    /// Opens the folder or recording, whose poses it needs; `strict` makes scans without a pose an error.
    pub fn open(&self, strict: bool) -> anyhow::Result<Box<Source>> {
        match voxelastic_run::Source::open_decided(&self.data, &self.options(strict), Some(false), &mut Warnings::default())?.0 {
            voxelastic_run::Source::Registered(source) => Ok(source),
            voxelastic_run::Source::Raw(_) => unreachable!("poses are needed"),
        }
    }
}

/// Interval of the held-out scans.
pub fn hold_out(text: &str) -> Result<HoldOut, String> {
    text.parse()
}

/// A pose as seven numbers.
pub fn pose(text: &str) -> Result<Pose, String> {
    let wrong = || "must be seven numbers: x y z qx qy qz qw (metres, unit quaternion)".to_owned();
    let numbers: Option<Vec<f64>> =
        text.split([' ', ',']).filter(|word| !word.is_empty()).map(|n| n.parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let [x, y, z, qx, qy, qz, qw]: [f64; 7] = numbers.ok_or_else(wrong)?.try_into().map_err(|_| wrong())?;
    let rotation = Quaternion::new(qw, qx, qy, qz);
    if (rotation.norm() - 1.0).abs() > 1e-2 {
        return Err(format!("the norm of the quaternion is {:.3}, but must be 1; the order is qx qy qz qw", rotation.norm()));
    }
    near(Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(rotation)), LARGEST_VEHICLE)
}

fn pose_change(text: &str) -> Result<PoseChange, String> {
    text.parse()
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s: &f64| *s >= 0.0 && s.is_finite()).ok_or_else(|| "must be a number of seconds, 0 or more".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_parsed_or_rejected() {
        let read = pose("0.1 -0.2, 1.7 0 0 0.70710678 0.70710678").unwrap();
        assert!((read.rotation.euler_angles().2 - std::f64::consts::FRAC_PI_2).abs() < 1e-6 && read.translation.z == 1.7);
        assert!(pose("0 0 0 0 0 0 2").unwrap_err().contains("is 2.000"));
        assert!(pose("1e7 0 0 0 0 0 1").unwrap_err().contains("metres"));
        for wrong in ["", "1 2 3", "0 0 0 0 0 0 1 1", "0 0 0 0 0 0 nan"] {
            assert!(pose(wrong).unwrap_err().contains("x y z qx qy qz qw"), "{wrong}");
        }
    }
}
