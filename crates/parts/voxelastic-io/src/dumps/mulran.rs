//! A sequence of the MulRan data set as it is downloaded.
//!
//! ```text
//! KAIST01/
//!   global_pose.csv        stamp in nanoseconds, then the vehicle's pose: 3 x 4 row, UTM
//!   Ouster/<stamp>.bin     clouds, lidar frame: x y z intensity as 32-bit floats; also in sensor_data/Ouster
//! ```
//!
//! Layout as KISS-ICP's `datasets/mulran.py` reads it. The lidar's pose on the vehicle is that of the data set's `calib_base2ouster.txt`, as
//! quoted there and in LoGG3D-Net's `mulran_dataset.py`: x 1.7042 m, y -0.021 m, z 1.8047 m, roll 0.0001, pitch 0.0003, yaw 179.6654
//! degrees. It is taken as the lidar's pose in the vehicle's frame, as the latter does: the lidar is on the roof. The map's origin is the first
//! pose, since UTM coordinates are too large for meshes.

use super::dump::Dump;
use super::labelled_text::rigid;
use crate::motion::{LONGEST_GAP_S, PoseTrack};
use crate::text::{self, lines};
use crate::{Error, Position, Result};
use nalgebra::UnitQuaternion;
use std::path::{Path, PathBuf};
use voxelastic::Pose;

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    let file = path.join("global_pose.csv");
    let folder = ["Ouster", "sensor_data/Ouster"].map(|f| path.join(f)).into_iter().find(|f| f.is_dir());
    let (true, Some(folder)) = (file.is_file(), folder) else { return Ok(None) };
    let track = read_poses(&file)?;
    let entries = std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, "list", e))?;
    let stamped = |p: PathBuf| Some((p.file_stem()?.to_str()?.parse::<u64>().ok()?, p));
    let mut clouds: Vec<(u64, PathBuf)> =
        entries.flatten().map(|e| e.path()).filter(|p| p.extension().is_some_and(|x| x == "bin")).filter_map(stamped).collect();
    clouds.sort();
    let mut dump = Dump::new("MulRan sequence", "global_pose.csv (vehicle), with the data set's mounting of the lidar");
    for (node, (stamp, cloud)) in (0..).zip(clouds) {
        let time = stamp as f64 * 1e-9;
        match track.at(time, LONGEST_GAP_S, 0.02) {
            Some(t_map_base) => dump.add(cloud, node, time, t_map_base * mounting()),
            None => dump.without_pose.push(cloud),
        }
    }
    Ok(Some(dump))
}

/// Pose of the lidar on the vehicle.
fn mounting() -> Pose {
    let [roll, pitch, yaw] = [0.0001f64, 0.0003, 179.6654].map(f64::to_radians);
    Pose::from_parts([1.7042, -0.021, 1.8047].into(), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}

/// The vehicle's poses relative to the position of the first.
fn read_poses(path: &Path) -> Result<PoseTrack> {
    let read = text::read(path)?;
    let (mut track, mut first) = (PoseTrack::default(), None);
    for line in lines(path, &read) {
        let mut words = line.words();
        let stamp = line.integer(words.next(), "stamp")?;
        let names = ["r11", "r12", "r13", "x", "r21", "r22", "r23", "y", "r31", "r32", "r33", "z"];
        let mut numbers = line.numbers(words, &names)?;
        let origin = *first.get_or_insert([numbers[3], numbers[7], numbers[11]]);
        (0..3).for_each(|k| numbers[4 * k + 3] -= origin[k]);
        let damaged = || Error::content(path, Position::line(line.number), "the numbers are not a pose", "download the file again");
        track.add(stamp as f64 * 1e-9, rigid(&numbers).ok_or_else(damaged)?);
    }
    Ok(track)
}
