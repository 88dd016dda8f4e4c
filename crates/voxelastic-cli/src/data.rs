//! The input: a folder of scans and poses, or a recording, and which of its scans to take.

use clap::Args;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use voxelastic::Pose;
use voxelastic_io::dataset::{Every, OpenOptions};
use voxelastic_io::source::{self, Source};

/// How to read the input.
#[derive(Debug, Args)]
#[command(next_help_heading = "Input")]
pub struct DataArgs {
    /// Folder with scans and poses, or a recording: .bag, .mcap, .db3, the folder of a ROS 2 bag, an Ouster .pcap
    #[arg(value_name = "DATA", help_heading = None)]
    data: PathBuf,
    /// The pose file, where several could be meant: a path, or a part of a name in DATA that no other has
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// The g2o pose graph to take loop and odometry edges from, named like --poses; beside a recording also a folder of corrected
    /// trajectories (poses@SECONDS.tum) as they were known at that time
    #[arg(long, value_name = "FILE.g2o")]
    graph: Option<PathBuf>,
    /// Pose of the lidar on the vehicle: the poses in the files are then those of the vehicle
    #[arg(long, value_name = "\"X Y Z QX QY QZ QW\"", value_parser = pose, allow_hyphen_values = true)]
    t_base_lidar: Option<Pose>,
    /// Scans to take: scan (all), a number (every 5th), a distance (2m) or a time (0.5s) [default: scan; 2m of a recording]
    #[arg(long, value_name = "scan|N|METRESm|SECONDSs")]
    every: Option<Every>,
    /// The topic of a recording that holds the clouds, where several could be meant
    #[arg(long, value_name = "TOPIC")]
    cloud_topic: Option<String>,
    /// The topic of a recording that holds the poses (odometry, path, stamped poses, /tf), where several could be meant
    #[arg(long, value_name = "TOPIC")]
    pose_topic: Option<String>,
    /// The sensor's .json of an Ouster capture, where it is not found by its name
    #[arg(long, value_name = "FILE.json", hide_short_help = true)]
    metadata: Option<PathBuf>,
    /// Take clouds as they are, for those that were set right for the sensor's motion before and have still times of points
    #[arg(long)]
    no_deskew: bool,
    /// How far in time a pose may be from its scan, seconds
    #[arg(long, value_name = "S", default_value_t = 0.01, value_parser = seconds, hide_short_help = true)]
    time_tolerance: f64,
}

impl DataArgs {
    /// The folder or file.
    pub fn path(&self) -> &Path {
        &self.data
    }

    /// How the user wants it read; `strict` refuses scans without a pose.
    pub fn options(&self, strict: bool) -> OpenOptions {
        OpenOptions {
            poses: self.poses.clone(),
            graph: self.graph.clone(),
            t_base_lidar: self.t_base_lidar,
            strict,
            every: self.every,
            cloud_topic: self.cloud_topic.clone(),
            pose_topic: self.pose_topic.clone(),
            metadata: self.metadata.clone(),
            deskew: !self.no_deskew,
            time_tolerance_s: self.time_tolerance,
        }
    }

    /// Opens the folder or recording; `strict` refuses scans without a pose.
    pub fn open(&self, strict: bool) -> voxelastic_io::Result<Source> {
        source::open(&self.data, &self.options(strict))
    }
}

/// Every how many scans one is held out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HoldOut(usize);

impl HoldOut {
    /// Reads the number of a flag.
    pub fn parse(text: &str) -> Result<Self, String> {
        text.parse().ok().filter(|n| *n >= 2).map(Self).ok_or_else(|| "must be a whole number, 2 or more".to_owned())
    }

    /// Whether the `i`-th scan of those taken is held out: the last of each N.
    fn holds_out(self, i: usize) -> bool {
        i % self.0 == self.0 - 1
    }

    /// Keeps the held-out scans only.
    pub fn keep_held(self, source: &mut Source) {
        source.retain(move |i| self.holds_out(i));
    }

    /// Keeps the other scans only. The number that comes back grows with each scan that is held out.
    pub fn drop_held(self, source: &mut Source) -> Arc<AtomicUsize> {
        let count = Arc::new(AtomicUsize::new(0));
        let held = Arc::clone(&count);
        source.retain(move |i| {
            held.fetch_add(usize::from(self.holds_out(i)), Ordering::Relaxed);
            !self.holds_out(i)
        });
        count
    }
}

fn pose(text: &str) -> Result<Pose, String> {
    let wrong = || "must be seven numbers: x y z qx qy qz qw (metres, unit quaternion)".to_owned();
    let numbers: Option<Vec<f64>> =
        text.split([' ', ',']).filter(|word| !word.is_empty()).map(|n| n.parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let [x, y, z, qx, qy, qz, qw]: [f64; 7] = numbers.ok_or_else(wrong)?.try_into().map_err(|_| wrong())?;
    let rotation = Quaternion::new(qw, qx, qy, qz);
    if (rotation.norm() - 1.0).abs() > 1e-2 {
        return Err(format!("the quaternion has the length {:.3}, but must have 1; the order is qx qy qz qw", rotation.norm()));
    }
    Ok(Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(rotation)))
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s: &f64| *s >= 0.0 && s.is_finite()).ok_or_else(|| "must be a number of seconds, 0 or more".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_of_the_lidar_are_read_or_refused() {
        let read = pose("0.1 -0.2, 1.7 0 0 0.70710678 0.70710678").unwrap();
        assert!((read.rotation.euler_angles().2 - std::f64::consts::FRAC_PI_2).abs() < 1e-6 && read.translation.z == 1.7);
        assert!(pose("0 0 0 0 0 0 2").unwrap_err().contains("length 2"));
        for wrong in ["", "1 2 3", "0 0 0 0 0 0 1 1", "0 0 0 0 0 0 nan"] {
            assert!(pose(wrong).unwrap_err().contains("x y z qx qy qz qw"), "{wrong}");
        }
    }

    #[test]
    fn the_last_of_each_n_is_held_out() {
        let tenth = HoldOut::parse("10").unwrap();
        assert_eq!((0..30).filter(|i| tenth.holds_out(*i)).collect::<Vec<_>>(), [9, 19, 29]);
        assert!(["0", "1", "-3", "x"].iter().all(|t| HoldOut::parse(t).is_err()));
    }
}
