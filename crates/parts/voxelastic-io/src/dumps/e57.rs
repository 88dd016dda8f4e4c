//! Scans of a laser scanner in one file.
//!
//! ```text
//! site.e57    scans, each with the scanner's pose in the file's frame and its points in the scanner's frame
//! ```
//!
//! Layout from ASTM E2807 (`pose` and `cartesian` of a `Data3D`).

use super::dump::Dump;
use crate::clouds::CloudFormat;
use crate::survey::e57;
use crate::{Error, Result};
use std::path::Path;
use voxelastic::geometry::PoseExt;

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    if !path.is_file() || CloudFormat::of(path) != Some(CloudFormat::E57) {
        return Ok(None);
    }
    let poses = e57::poses(path)?;
    let in_one_frame = poses.len() > 1 && poses.iter().all(|pose| pose.translation_distance(&poses[0]) == 0.0);
    if in_one_frame {
        let problem = format!("{} scans that do not say where they were taken: all have the same position", poses.len());
        return Err(Error::dataset(path, problem, "export the scans with their poses, in the scanner's own frame"));
    }
    let mut dump = Dump::new("file of laser scans (E57)", "each scan's own");
    for (k, pose) in poses.into_iter().enumerate() {
        dump.add(path.to_owned(), k as u64, k as f64, pose);
    }
    Ok(Some(dump))
}
