//! BALM's and HBA's input and output.
//!
//! ```text
//! data/
//!   pose.json     no JSON: x y z qw qx qy qz on each line
//!   pcd/0.pcd     the k-th cloud, lidar frame; names may have leading zeros
//! ```
//!
//! Layout from HBA's `include/mypcl.hpp` (`read_pose`, `write_pose`, `loadPCD`) and its README.

use super::dump::{Dump, files_with_extension};
use crate::text::{self, lines};
use crate::{Error, Result};
use std::path::Path;

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    let (file, folder) = (path.join("pose.json"), path.join("pcd"));
    if !file.is_file() || !folder.is_dir() {
        return Ok(None);
    }
    let clouds = files_with_extension(&folder, "pcd")?;
    let read = text::read(&file)?;
    let poses = lines(&file, &read).map(|line| {
        let [x, y, z, qw, qx, qy, qz] = line.numbers(line.words(), &["x", "y", "z", "qw", "qx", "qy", "qz"])?;
        line.pose([x, y, z, qx, qy, qz, qw])
    });
    let poses = poses.collect::<Result<Vec<_>>>()?;
    if poses.len() != clouds.len() {
        let problem = format!("{} poses for {} clouds in pcd/", poses.len(), clouds.len());
        return Err(Error::dataset(&file, problem, "write one pose per cloud, in the order of the clouds"));
    }
    let mut dump = Dump::new("BALM / HBA folder", "pose.json");
    for (k, (cloud, pose)) in clouds.into_iter().zip(poses).enumerate() {
        dump.add(cloud, k as u64, k as f64, pose);
    }
    Ok(Some(dump))
}
