//! Ground truth next to a dataset.

use super::choose_poses;
use super::folder::{self, Folder};
use super::matching::{Clouds, match_poses};
use crate::{OpenOptions, Result, poses};
use std::path::{Path, PathBuf};
use voxelastic::Pose;

/// The ground truth next to a dataset.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct GroundTruth {
    /// Its file.
    pub path: PathBuf,
    /// Pose of the lidar frame at each of the dataset's scans, where the file has one.
    pub t_map_lidar: Vec<Option<Pose>>,
}

/// The pose of every cloud by the ground truth, if exactly one file is named so. Otherwise, or if the file cannot be used, a note says why.
pub(super) fn read(folder: &Folder, clouds: Clouds<'_>, options: &OpenOptions) -> (Option<GroundTruth>, Option<String>) {
    let mut files = folder.poses.iter().filter(|p| p.is_ground_truth());
    let Some(file) = files.next() else { return (None, None) };
    if files.next().is_some() {
        return (None, Some("several files are named ground truth: none is used as such".into()));
    }
    let trajectory = poses::read(&file.path).map(|t| t.in_lidar_frame(options.t_base_lidar.as_ref()));
    match trajectory.and_then(|trajectory| match_poses(clouds, &trajectory, &file.path)) {
        Ok(matched) => (Some(GroundTruth { path: file.path.clone(), t_map_lidar: matched.poses }), None),
        Err(error) => (None, Some(format!("the ground truth is ignored: {error}"))),
    }
}

/// The file of a folder's true poses: `requested`, named as in [`OpenOptions::poses`], else the only one named ground truth.
pub(super) fn find(path: &Path, requested: Option<&Path>) -> Result<Option<PathBuf>> {
    Ok(choose_poses::truth(&folder::scan(path)?, requested)?.map(|file| file.path))
}
