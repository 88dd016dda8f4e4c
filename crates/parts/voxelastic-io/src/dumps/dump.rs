//! A folder whose layout was recognised.

use crate::scan_list::ScanEntry;
use crate::{Error, PoseGraph, Result, file_names};
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// A folder whose layout was recognised.
#[derive(Clone, Debug)]
pub(crate) struct Dump {
    /// The system or data set that the layout is of.
    pub(crate) system: &'static str,
    /// Where its poses come from, for people.
    pub(crate) poses: String,
    /// In the order of time.
    pub(crate) scans: Vec<ScanEntry>,
    /// Clouds without a pose.
    pub(crate) without_pose: Vec<PathBuf>,
    /// The pose graph and its file, if there is one.
    pub(crate) graph: Option<(PathBuf, PoseGraph)>,
    /// Further remarks for the user.
    pub(crate) notes: Vec<String>,
}

impl Dump {
    pub(super) fn new(system: &'static str, poses: impl Into<String>) -> Self {
        Self { system, poses: poses.into(), scans: Vec::new(), without_pose: Vec::new(), graph: None, notes: Vec::new() }
    }

    /// Adds a scan.
    pub(super) fn add(&mut self, path: PathBuf, node: NodeId, time: f64, t_map_lidar: Pose) {
        self.scans.push(ScanEntry { path, index: self.scans.len(), node, time, t_map_lidar, sensor: 0 });
    }

    /// Sorts the scans by time.
    pub(super) fn in_order(mut self) -> Self {
        self.scans.sort_by(|a, b| a.time.total_cmp(&b.time).then(a.node.cmp(&b.node)));
        (0..).zip(&mut self.scans).for_each(|(index, scan)| scan.index = index);
        self
    }
}

/// The subfolders whose names are numbers and that contain the file `containing`, in the order of the numbers.
pub(super) fn numbered_folders(path: &Path, containing: &str) -> Vec<(u64, PathBuf)> {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let number = |p: PathBuf| Some((p.file_name()?.to_str()?.parse().ok()?, p));
    let mut found: Vec<(u64, PathBuf)> = entries.filter_map(|e| number(e.path())).filter(|(_, p)| p.join(containing).is_file()).collect();
    found.sort();
    found
}

/// The files of a folder with an extension, in the natural order of their names.
pub(super) fn files_with_extension(folder: &Path, extension: &str) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
    let has_extension = |p: &PathBuf| p.extension().is_some_and(|x| x.eq_ignore_ascii_case(extension));
    let mut files: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(has_extension).collect();
    files.sort_by(|a, b| file_names::natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}
