//! A sequence of the KITTI odometry benchmark as it is downloaded.
//!
//! ```text
//! dataset/
//!   poses/00.txt                      poses of the left camera: 3 x 4 rows
//!   sequences/00/velodyne/000000.bin  clouds, lidar frame
//!   sequences/00/calib.txt            Tr: the lidar's pose in the camera frame, 3 x 4
//!   sequences/00/times.txt            the time of each cloud, seconds
//! ```
//!
//! What is opened is a sequence, or the folder above `sequences` if that has one sequence only. SemanticKITTI has the same layout.
//!
//! Layout from the benchmark's development kit (readme). The camera's poses become the lidar's: `Tr^-1 * pose * Tr`, so that the map
//! begins in the first lidar frame.

use super::dump::{Dump, files_with_extension};
use super::labelled_text::rigid;
use crate::text::{self, lines};
use crate::{Error, PoseFormat, Position, Result, poses};
use std::path::{Path, PathBuf};
use voxelastic::Pose;

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    let only = only_sequence(path);
    let path = only.as_deref().unwrap_or(path);
    let (calibration, velodyne) = (path.join("calib.txt"), path.join("velodyne"));
    if !calibration.is_file() || !velodyne.is_dir() {
        return Ok(None);
    }
    let Some(t_camera_lidar) = lidar_in_camera(&calibration)? else { return Ok(None) };
    let Some(file) = pose_file(path) else { return Ok(None) };
    let camera = poses::parse(&text::read(&file)?, &file, PoseFormat::KITTI)?.poses;
    let clouds = files_with_extension(&velodyne, "bin")?;
    let times = path.join("times.txt");
    let times = if times.is_file() { Some(poses::read_times(&times)?) } else { None };
    let mut dump = Dump::new("KITTI odometry sequence", format!("{} (camera), with calib.txt", file.display()));
    for cloud in clouds {
        let number = cloud.file_stem().and_then(|s| s.to_str()).and_then(|s| s.parse::<usize>().ok());
        let pose = number.and_then(|k| Some((k, camera.get(k)?)));
        match pose {
            Some((k, t_map_camera)) => {
                let time = times.as_ref().and_then(|t| t.get(k)).copied().unwrap_or(k as f64);
                dump.add(cloud, k as u64, time, t_camera_lidar.inverse() * t_map_camera * t_camera_lidar);
            }
            None => dump.without_pose.push(cloud),
        }
    }
    Ok(Some(dump.in_order()))
}

/// Refuses a sequence whose poses are the camera's, and nothing says where the lidar is in its frame.
pub(super) fn refuse_without_transform(path: &Path) -> Result<()> {
    let only = only_sequence(path);
    let path = only.as_deref().unwrap_or(path);
    let calibration = path.join("calib.txt");
    if !calibration.is_file() || !path.join("velodyne").is_dir() || lidar_in_camera(&calibration)?.is_some() {
        return Ok(());
    }
    let read = text::read(&calibration)?;
    let has_cameras = lines(&calibration, &read).any(|line| line.text.starts_with("P0"));
    match pose_file(path).filter(|_| has_cameras) {
        Some(poses) => {
            let problem = format!("no line Tr, the lidar's pose in the frame of the camera, whose poses are in {}", poses.display());
            let remedy = format!(
                "take the calib.txt of the benchmark's velodyne calibration; if the poses are the lidar's already, name them: --poses {}; or let --slam estimate them",
                poses.display()
            );
            Err(Error::dataset(&calibration, problem, remedy))
        }
        None => Ok(()),
    }
}

/// The sequence of a folder with one sequence.
fn only_sequence(path: &Path) -> Option<PathBuf> {
    let sequences = std::fs::read_dir(path.join("sequences")).ok()?.flatten().map(|e| e.path());
    let sequences: Vec<PathBuf> = sequences.filter(|p| p.join("velodyne").is_dir()).collect();
    if let [only] = sequences.as_slice() { Some(only.clone()) } else { None }
}

/// A pose file in the sequence's folder, or the benchmark's.
fn pose_file(path: &Path) -> Option<PathBuf> {
    let absolute = path.canonicalize().ok()?;
    let name = absolute.file_name()?.to_str()?.to_owned();
    let of_benchmark = absolute.parent()?.parent()?.join("poses").join(format!("{name}.txt"));
    [path.join("poses.txt"), path.join(format!("{name}.txt")), of_benchmark].into_iter().find(|p| p.is_file())
}

/// The `Tr` line of `calib.txt`, if it has one.
fn lidar_in_camera(path: &Path) -> Result<Option<Pose>> {
    let read = text::read(path)?;
    let Some(line) = lines(path, &read).find(|l| l.text.starts_with("Tr:") || l.text.starts_with("Tr ")) else { return Ok(None) };
    let names = ["r11", "r12", "r13", "x", "r21", "r22", "r23", "y", "r31", "r32", "r33", "z"];
    let numbers = line.numbers(line.words().skip(1), &names)?;
    let damaged = || Error::content(path, Position::line(line.number), "Tr is not a pose", "take the calibration of the benchmark");
    rigid(&numbers).map(Some).ok_or_else(damaged)
}
