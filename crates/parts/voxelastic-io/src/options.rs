//! How data are opened.

use crate::scan_list::Keyframing;
use std::path::PathBuf;
use std::str::FromStr;
use voxelastic::Pose;
use voxelastic::geometry::PoseChange;

/// Which of a SLAM system's poses to use, where a folder has both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum PoseKind {
    /// After optimisation of the pose graph.
    #[default]
    Optimised,
    /// Before: odometry, for those who optimise the graph themselves.
    Odometry,
}

/// What the times of points mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PointTimes {
    /// What they say; where that leaves two readings, whoever opens the data may decide.
    #[default]
    Undecided,
    /// What they say.
    Given,
    /// The part of a sweep, which takes as long as it takes until the next cloud; where neither clouds nor poses have times, clouds are taken to come ten a second.
    OverInterval,
    /// Nothing: clouds are undistorted already.
    Undistorted,
}

impl FromStr for PointTimes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "given" => Ok(Self::Given),
            "over-interval" => Ok(Self::OverInterval),
            "undistorted" => Ok(Self::Undistorted),
            _ => Err(format!("{text:?} is none of: given, over-interval, undistorted")),
        }
    }
}

/// A further sensor of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorTopic {
    /// The topic of its clouds.
    pub topic: String,
    /// Its pose in the base frame. If absent, fixed transforms of the recording have to say where it is beside the first sensor.
    pub t_base_lidar: Option<Pose>,
}

/// A folder of a further sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorFolder {
    /// The folder, with scans and poses.
    pub path: PathBuf,
    /// The sensor's pose in the base frame, if the poses in the folder are those of the base.
    pub t_base_lidar: Option<Pose>,
}

/// How to open a folder or a recording. The default fits most data.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// The pose file: a path, a file name in the folder, or a part of one that no other pose file has (`groundtruth`).
    pub poses: Option<PathBuf>,
    /// Which poses to use if `poses` is not given and the folder has a system's poses before and after optimisation (SC-A-LOAM, SC-LIO-SAM,
    /// FAST-LIO-SLAM: `odom_poses.txt` and `optimized_poses.txt`).
    pub pose_kind: PoseKind,
    /// The g2o graph to take edges from, named like `poses`. With a recording also a folder of corrected trajectories as they were known
    /// at times of the recording, seconds: `poses@1600000000.5.tum`.
    pub graph: Option<PathBuf>,
    /// Pose of the lidar frame in the base frame. If given, the poses and edges in the files are those of the base:
    /// `t_map_lidar = t_map_base * t_base_lidar` (paper Sec. IV).
    pub t_base_lidar: Option<Pose>,
    /// What to read otherwise of the poses in the files or topics, before `t_base_lidar`.
    pub pose_change: PoseChange,
    /// Whether a cloud without a pose, or a graph that does not match the clouds, is an error instead of a counted skip.
    pub strict: bool,
    /// Which scans to take; by default all of a folder, and of a recording one every 2 m.
    pub keyframing: Option<Keyframing>,
    /// The topic of a recording that holds the clouds, those of the first sensor if there are several.
    pub cloud_topic: Option<String>,
    /// Further sensors of a recording, which are mapped together with the one of `cloud_topic`.
    pub more_sensors: Vec<SensorTopic>,
    /// Folders of further sensors, which are mapped together with the one that is opened.
    pub more_folders: Vec<SensorFolder>,
    /// The topic of a recording that holds the poses.
    pub pose_topic: Option<String>,
    /// The topic of a recording whose paths are corrected poses of the scans so far, in the clock of the scans.
    pub correction_topic: Option<String>,
    /// The topic of a recording that holds the samples of the inertial measurement unit, where no poses are used.
    pub imu_topic: Option<String>,
    /// Whether samples of an inertial measurement unit are read, where no poses are used.
    pub use_imu: bool,
    /// The sensor's metadata of a capture, or the angles of its beams, where they are not found by their name.
    pub metadata: Option<PathBuf>,
    /// What the times of points mean. Clouds whose points have times get the lidar's motion, so that they are corrected for the motion during the sweep.
    pub point_times: PointTimes,
    /// The clouds of a robot that runs wait for the transform that says where their lidar is on it. After so many seconds without it the poses are taken for those of the lidar; none: never.
    pub mount_timeout_s: Option<f64>,
    /// How far in time the nearest pose may be from a cloud when they are matched by time, seconds.
    pub time_tolerance_s: f64,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            poses: None,
            pose_kind: PoseKind::default(),
            graph: None,
            t_base_lidar: None,
            pose_change: PoseChange::default(),
            strict: false,
            keyframing: None,
            cloud_topic: None,
            more_sensors: Vec::new(),
            more_folders: Vec::new(),
            pose_topic: None,
            correction_topic: None,
            imu_topic: None,
            use_imu: true,
            metadata: None,
            point_times: PointTimes::default(),
            mount_timeout_s: None,
            time_tolerance_s: 0.01,
        }
    }
}
