//! Layouts of SLAM systems and data sets that differ from [`crate::dataset`]'s own: one file for each, with the layout and its source.
//!
//! | layout of | file |
//! | --- | --- |
//! | hdl_graph_slam | `hdl_graph_slam.rs` |
//! | GLIM | `glim.rs` |
//! | BALM, HBA | `hba.rs` |
//! | KITTI odometry, as downloaded | `kitti_odometry.rs` |
//! | MulRan, as downloaded | `mulran.rs` |
//! | Newer College (2020), as downloaded | `newer_college.rs` |
//! | KITTI raw, as downloaded, with `oxts` | `kitti_raw.rs` |
//! | laser scanners: one E57 file instead of a folder | `e57.rs` |
//!
//! SC-A-LOAM and SC-LIO-SAM folders are what [`crate::dataset`] reads as it is: `Scans/000000.pcd`, `odom_poses.txt` and
//! `optimized_poses.txt` as KITTI rows, `times.txt`, `singlesession_posegraph.g2o` (SC-A-LOAM's `src/laserPosegraphOptimization.cpp`). LIO-SAM
//! saves no scans with its map: its `transformations.pcd` gives the poses of a recording (`--poses`), and its clouds are those of the map.

mod dump;
mod e57;
mod glim;
mod hba;
mod hdl_graph_slam;
mod kitti_odometry;
mod kitti_raw;
mod labelled_text;
mod mulran;
mod newer_college;

pub(crate) use dump::Dump;

use crate::Result;
use std::path::Path;

/// Recognises one layout; `None` if the folder has another.
type Adapter = fn(&Path) -> Result<Option<Dump>>;

/// Recognises a folder; `None` if it has none of the layouts.
///
/// # Errors
/// Those of the files of a folder that was recognised.
pub(crate) fn find(path: &Path) -> Result<Option<Dump>> {
    let adapters: [Adapter; 8] =
        [e57::find, hdl_graph_slam::find, glim::find, hba::find, kitti_odometry::find, kitti_raw::find, mulran::find, newer_college::find];
    for find in adapters {
        if let Some(dump) = find(path)? {
            return Ok(Some(dump));
        }
    }
    Ok(None)
}
/// Refuses a folder in a known layout whose poses cannot be used as they are.
///
/// # Errors
/// [`Error::Dataset`](crate::Error::Dataset), with what is missing.
pub(crate) fn refuse_incomplete(path: &Path) -> Result<()> {
    kitti_odometry::refuse_without_transform(path)
}
