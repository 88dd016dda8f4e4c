//! A drive of KITTI's raw data as it is downloaded, with the poses of its GPS/IMU (`oxts`).
//!
//! ```text
//! 2011_09_26/calib_imu_to_velo.txt                                  R, T: pose of the IMU in the lidar frame
//! 2011_09_26/2011_09_26_drive_0001_sync/                            what is opened
//!   velodyne_points/data/0000000000.bin, ../timestamps.txt          clouds, and the time of each
//!   oxts/data/0000000000.txt, ../timestamps.txt                     latitude, longitude, altitude, roll, pitch, yaw, ..; time of each
//! ```
//!
//! Layout from the development kit's `readme.txt` and `dataformat.txt`. Positions are in its Mercator projection, scaled at the first latitude
//! (`convertOxtsToPose.m`); the map's origin is the first lidar frame.

use super::dump::{Dump, files_with_extension};
use super::labelled_text::{LabelledText, rigid};
use crate::folders::{ScanTimes, cloud_files_of, read_dates, read_scan_times};
use crate::motion::{LONGEST_GAP_S, PoseTrack};
use crate::text::{self, lines};
use crate::{Error, Position, Result};
use nalgebra::UnitQuaternion;
use std::path::{Path, PathBuf};
use voxelastic::Pose;

/// Earth radius of the projection, metres.
const EARTH_RADIUS_M: f64 = 6_378_137.0;
/// Largest difference in time between a cloud and its pose, seconds.
const SAME_TIME_S: f64 = 0.06;
/// Pose of the IMU in the lidar frame on 2011_09_26, 3 x 4, where a download has no calibration. Other days differ by millimetres.
const USUAL_MOUNTING: [f64; 12] = [
    9.999976e-01,
    7.553071e-04,
    -2.035826e-03,
    -8.086759e-01,
    -7.854027e-04,
    9.998898e-01,
    -1.482298e-02,
    3.195559e-01,
    2.024406e-03,
    1.482454e-02,
    9.998881e-01,
    -7.997231e-01,
];

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    let (clouds, oxts) = (path.join("velodyne_points/data"), path.join("oxts/data"));
    if !clouds.is_dir() || !oxts.is_dir() {
        return Ok(None);
    }
    let mut dump = Dump::new("KITTI raw drive", "oxts (GPS and IMU)");
    let files = cloud_files_of(&clouds)?;
    let (t_imu_lidar, note) = t_imu_lidar(path)?;
    dump.notes.extend(note);
    let poses = read_oxts(&files_with_extension(&oxts, "txt")?)?;
    let Some((_, first)) = poses.first() else {
        return Err(Error::dataset(&oxts, "no .txt files in it", "download the drive again, or remove the folder oxts"));
    };
    let t_map_world = (first * t_imu_lidar).inverse();
    let times = read_scan_times(&clouds, &files)?.map(|ScanTimes { times, .. }| times);
    let oxts_times = path.join("oxts/timestamps.txt");
    let track = match (&times, oxts_times.is_file()) {
        (Some(_), true) => Some(track(&read_dates(&oxts_times)?, &poses, &oxts_times)?),
        _ => None,
    };
    for (index, cloud) in files.into_iter().enumerate() {
        let node = cloud.number.unwrap_or(index as u64);
        let time = times.as_ref().map_or(index as f64, |times| times[index]);
        // Without times, clouds and poses of the same number belong together.
        let t_world_imu = match &track {
            Some(track) => track.at(time, LONGEST_GAP_S, SAME_TIME_S),
            None => poses.iter().find(|(number, _)| Some(*number) == cloud.number).map(|(_, pose)| *pose),
        };
        match t_world_imu {
            Some(t_world_imu) => dump.add(cloud.path, node, time, t_map_world * t_world_imu * t_imu_lidar),
            None => dump.without_pose.push(cloud.path),
        }
    }
    Ok(Some(dump.in_order()))
}

/// Poses of the IMU by time.
fn track(times: &[f64], poses: &[(u64, Pose)], file: &Path) -> Result<PoseTrack> {
    let mut track = PoseTrack::default();
    for (number, pose) in poses {
        let time = usize::try_from(*number).ok().and_then(|k| times.get(k)).ok_or_else(|| {
            let problem = format!("{} times, but a file of number {number} in data/", times.len());
            Error::dataset(file, problem, "download the drive again")
        })?;
        track.add(*time, *pose);
    }
    Ok(track)
}

/// The IMU's poses by the numbers of their files, world frame: east, north, up in metres.
fn read_oxts(files: &[PathBuf]) -> Result<Vec<(u64, Pose)>> {
    let mut scale = None;
    let mut poses = Vec::with_capacity(files.len());
    for file in files {
        let read = text::read(file)?;
        let wrong = |problem: &str| Error::content(file, Position::line(1), problem, "download the drive again");
        let line = lines(file, &read).next().ok_or_else(|| wrong("the file is empty"))?;
        let names = ["latitude", "longitude", "altitude", "roll", "pitch", "yaw"];
        let [latitude, longitude, altitude, roll, pitch, yaw] = line.numbers(line.words().take(names.len()), &names)?;
        if latitude.abs() > 89.0 {
            return Err(wrong("a latitude beyond 89 degrees"));
        }
        let scale = *scale.get_or_insert_with(|| latitude.to_radians().cos());
        let east = scale * EARTH_RADIUS_M * longitude.to_radians();
        let north = scale * EARTH_RADIUS_M * ((90.0 + latitude).to_radians() / 2.0).tan().ln();
        let number = file.file_stem().and_then(|s| s.to_str()?.parse().ok()).ok_or_else(|| wrong("the file's name is not a number"))?;
        poses.push((number, Pose::from_parts([east, north, altitude].into(), UnitQuaternion::from_euler_angles(roll, pitch, yaw))));
    }
    Ok(poses)
}

/// Pose of the lidar in the IMU frame by the calibration in the drive's folder or the one above, else the usual one, with a note.
fn t_imu_lidar(path: &Path) -> Result<(Pose, Option<String>)> {
    let absolute = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let folders = [path.to_owned(), absolute.parent().map(Path::to_owned).unwrap_or_default()];
    let Some(file) = folders.iter().map(|f| f.join("calib_imu_to_velo.txt")).find(|f| f.is_file()) else {
        let pose = rigid(&USUAL_MOUNTING).unwrap_or_default();
        return Ok((pose.inverse(), Some("no calib_imu_to_velo.txt: the lidar's pose relative to the IMU is that of 2011_09_26".into())));
    };
    let text = LabelledText::read(&file)?;
    let damaged = || Error::content(&file, Position::File, "no pose of R and T", "download the calibration again");
    let label = |label: &str| text.labels(label).next().ok_or_else(damaged);
    let r: [f64; 9] = text.numbers(label("R")?)?;
    let t: [f64; 3] = text.numbers(label("T")?)?;
    let t_lidar_imu = rigid(&[r[0], r[1], r[2], t[0], r[3], r[4], r[5], t[1], r[6], r[7], r[8], t[2]]).ok_or_else(damaged)?;
    Ok((t_lidar_imu.inverse(), None))
}
