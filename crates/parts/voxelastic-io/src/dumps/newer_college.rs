//! A sequence of the Newer College Dataset (2020) as it is downloaded.
//!
//! ```text
//! 01_short_experiment/
//!   raw_format/ouster_scan/cloud_<sec>_<nsec>.pcd   clouds, lidar frame; also in ouster_zip_files/ there, or in ouster_scan/
//!   ground_truth/registered_poses.csv               sec,nsec,x,y,z,qx,qy,qz,qw, or sec x y z qx qy qz qw: poses of the left camera
//! ```
//!
//! Layout, and the lidar's pose relative to the camera, as KISS-ICP's `datasets/ncd.py` reads it.

use super::dump::Dump;
use crate::file_names::stamp;
use crate::motion::{LONGEST_GAP_S, PoseTrack};
use crate::{Error, Position, Result, poses};
use nalgebra::{Quaternion, UnitQuaternion};
use std::path::{Path, PathBuf};
use voxelastic::Pose;

/// Largest difference in time between a cloud and its pose, seconds.
const SAME_TIME_S: f64 = 0.02;

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    let file = path.join("ground_truth/registered_poses.csv");
    let folder =
        ["raw_format/ouster_scan", "raw_format/ouster_zip_files/ouster_scan", "ouster_scan"].map(|f| path.join(f)).into_iter().find(|f| f.is_dir());
    let (true, Some(folder)) = (file.is_file(), folder) else { return Ok(None) };
    // Some sequences have seconds with decimals instead, between spaces.
    let trajectory = poses::read(&file)?;
    let Some(times) = trajectory.times else {
        return Err(Error::content(&file, Position::File, "poses without times", "take the ground truth of the data set"));
    };
    let mut track = PoseTrack::default();
    times.into_iter().zip(trajectory.poses).for_each(|(time, pose)| track.add(time, pose));
    let entries = std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, "list", e))?;
    let stamped = |p: PathBuf| Some((stamp(p.file_stem()?.to_str()?)?, p));
    let mut clouds: Vec<(f64, PathBuf)> =
        entries.flatten().map(|e| e.path()).filter(|p| p.extension().is_some_and(|x| x == "pcd")).filter_map(stamped).collect();
    clouds.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut dump = Dump::new("Newer College sequence", "registered_poses.csv (camera), with the data set's mounting of the lidar");
    for (node, (time, cloud)) in (0..).zip(clouds) {
        match track.at(time, LONGEST_GAP_S, SAME_TIME_S) {
            Some(t_map_camera) => dump.add(cloud, node, time, t_map_camera * mounting()),
            None => dump.without_pose.push(cloud),
        }
    }
    Ok(Some(dump))
}

/// Pose of the lidar in the camera's frame.
fn mounting() -> Pose {
    Pose::from_parts([-0.084, -0.025, 0.050].into(), UnitQuaternion::from_quaternion(Quaternion::new(0.383, 0.0, 0.0, 0.924)))
}
