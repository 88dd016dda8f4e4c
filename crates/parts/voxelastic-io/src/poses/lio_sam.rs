//! `transformations.pcd`, the key poses that LIO-SAM saves with its map: x y z, roll pitch yaw, time.
//!
//! Layout from the project's `src/mapOptmization.cpp`: the point type `PointXYZIRPYT`, written by the service that saves the map.

use super::trajectory::Trajectory;
use crate::{Error, Position, Result, pcd};
use nalgebra::{Translation3, UnitQuaternion};
use std::path::Path;
use voxelastic::Pose;

pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Trajectory> {
    let columns = pcd::columns(bytes, path, &["x", "y", "z", "roll", "pitch", "yaw", "time"])?;
    let [x, y, z, roll, pitch, yaw, times] = columns.as_slice() else { return Ok(Trajectory::default()) };
    let mut poses = Vec::new();
    for k in 0..times.len() {
        let numbers = [x[k], y[k], z[k], roll[k], pitch[k], yaw[k], times[k]];
        if numbers.iter().any(|v| !v.is_finite()) || (k > 0 && times[k] <= times[k - 1]) {
            let problem = format!("pose {k} is not finite, or not after the one before it");
            return Err(Error::content(path, Position::File, problem, "save the map again"));
        }
        poses.push(Pose::from_parts(Translation3::new(x[k], y[k], z[k]), UnitQuaternion::from_euler_angles(roll[k], pitch[k], yaw[k])));
    }
    if poses.is_empty() {
        return Err(Error::content(path, Position::File, "no pose in it", "choose another file or write it again"));
    }
    Ok(Trajectory { poses, times: Some(times.clone()), nodes: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_poses_have_angles_and_times() {
        let header = "VERSION 0.7\nFIELDS x y z intensity roll pitch yaw time\nSIZE 4 4 4 4 4 4 4 8\nTYPE F F F F F F F F\nCOUNT 1 1 1 1 1 1 1 1\n\
                      WIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA binary\n";
        let mut bytes = header.as_bytes().to_vec();
        for k in 0..2u8 {
            let k = f32::from(k);
            [1.0 + k, 2.0, 3.0, k, 0.0, 0.0, 0.5].iter().for_each(|v: &f32| bytes.extend(v.to_le_bytes()));
            bytes.extend((1.6e9 + f64::from(k)).to_le_bytes());
        }
        let read = parse(&bytes, Path::new("transformations.pcd")).unwrap();
        assert_eq!((read.times.unwrap(), read.poses[1].translation.x), (vec![1.6e9, 1.6e9 + 1.0], 2.0));
        assert!((read.poses[0].rotation.euler_angles().2 - 0.5).abs() < 1e-6);
        assert!(parse(&bytes[..bytes.len() - 3], Path::new("a")).is_err());
        let other = [header.replace("yaw", "jaw").as_bytes(), &bytes[header.len()..]].concat();
        assert!(parse(&other, Path::new("a")).unwrap_err().to_string().contains("yaw"));
    }
}
