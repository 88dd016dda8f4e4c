//! Folders that SLAM systems and data sets leave, where they are laid out differently from [`crate::dataset`]'s own. One file each, with
//! the layout and where it was read.
//!
//! | left by | file |
//! | --- | --- |
//! | hdl_graph_slam | `hdl_graph_slam.rs` |
//! | GLIM | `glim.rs` |
//! | BALM, HBA | `hba.rs` |
//! | KITTI odometry, as downloaded | `kitti_odometry.rs` |
//! | MulRan, as downloaded | `mulran.rs` |
//! | Newer College (2020), as downloaded | `newer_college.rs` |
//! | laser scanners: one E57 file instead of a folder | `e57.rs` |
//!
//! SC-A-LOAM and SC-LIO-SAM folders are what [`crate::dataset`] reads as it is: `Scans/000000.pcd`, `odom_poses.txt` and
//! `optimized_poses.txt` as KITTI rows, `times.txt`, `singlesession_posegraph.g2o` (SC-A-LOAM's `src/laserPosegraphOptimization.cpp`). LIO-SAM
//! saves no scans with its map: its `transformations.pcd` gives the poses of a recording (`--poses`).

mod e57;
mod glim;
mod hba;
mod hdl_graph_slam;
mod kitti_odometry;
mod matrices;
mod mulran;
mod newer_college;

use crate::dataset::ScanEntry;
use crate::{PoseGraph, Result};
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// A folder that was recognised.
#[derive(Clone, Debug)]
pub(crate) struct Dump {
    /// What left it.
    pub(crate) system: &'static str,
    /// Where its poses are from, for people.
    pub(crate) poses: String,
    /// In the order of time.
    pub(crate) scans: Vec<ScanEntry>,
    /// Clouds without a pose.
    pub(crate) without_pose: Vec<PathBuf>,
    /// Nodes and edges, if it has them.
    pub(crate) graph: Option<(PathBuf, PoseGraph)>,
    /// Anything else to know.
    pub(crate) notes: Vec<String>,
}

impl Dump {
    fn new(system: &'static str, poses: impl Into<String>) -> Self {
        Self { system, poses: poses.into(), scans: Vec::new(), without_pose: Vec::new(), graph: None, notes: Vec::new() }
    }

    /// Adds a scan.
    fn add(&mut self, path: PathBuf, node: NodeId, time: f64, t_map_lidar: Pose) {
        self.scans.push(ScanEntry { path, index: self.scans.len(), node, time, t_map_lidar });
    }

    /// Puts the scans into the order of time.
    fn in_order(mut self) -> Self {
        self.scans.sort_by(|a, b| a.time.total_cmp(&b.time).then(a.node.cmp(&b.node)));
        (0..).zip(&mut self.scans).for_each(|(index, scan)| scan.index = index);
        self
    }
}

/// Looks for one kind of folder; none when it is another.
type Adapter = fn(&Path) -> Result<Option<Dump>>;

/// Recognises a folder; nothing if it is none of these.
///
/// # Errors
/// Those of the files of a folder that was recognised.
pub(crate) fn find(path: &Path) -> Result<Option<Dump>> {
    let adapters: [Adapter; 7] = [e57::find, hdl_graph_slam::find, glim::find, hba::find, kitti_odometry::find, mulran::find, newer_college::find];
    for find in adapters {
        if let Some(dump) = find(path)? {
            return Ok(Some(dump));
        }
    }
    Ok(None)
}

/// The subfolders whose names are numbers and that hold a file, in the order of the numbers.
fn numbered(path: &Path, holding: &str) -> Vec<(u64, PathBuf)> {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let number = |p: PathBuf| Some((p.file_name()?.to_str()?.parse().ok()?, p));
    let mut found: Vec<(u64, PathBuf)> = entries.filter_map(|e| number(e.path())).filter(|(_, p)| p.join(holding).is_file()).collect();
    found.sort();
    found
}
