//! Scans without poses: the clouds of a folder or a recording with their times, in order, for odometry.
//!
//! [`open`] recognises where the clouds are:
//!
//! - `velodyne_points/data` of KITTI raw and KITTI-360 with its `timestamps.txt`, `timestamps_start.txt` and `timestamps_end.txt`
//! - KITTI odometry and SemanticKITTI: `velodyne`, or `sequences/00/velodyne`, with `times.txt`
//! - nuScenes: `samples/LIDAR_TOP` and `sweeps/LIDAR_TOP`, or one folder of `.pcd.bin` files
//! - `scans/`, `clouds/`, `lidar/`, `pcd/`, `points/` and the like, the folder itself, or the only folder of clouds a few levels down
//! - the folders of SLAM systems that [`crate::dataset`] knows; their poses are not used
//! - bags and captures
//!
//! A unit's samples come from the recording, or from [`imu_csv`](crate::imu_csv) in the folder, and are given with the scans.
//!
//! Times come from files, from the names of the clouds, or from the clouds themselves.
//!
//! ```
//! use voxelastic::Cloud;
//! use voxelastic_io::{OpenOptions, pcd, raw};
//!
//! let folder = tempfile::tempdir().unwrap();
//! for k in 0..3 {
//!     let cloud = Cloud::from_points(vec![[10.0, 0.0, 0.5], [0.0, 8.0, 0.5]]);
//!     pcd::write(folder.path().join(format!("lidar/{}.pcd", 1_600_000_000_000_000_000u64 + k * 100_000_000)), &cloud)?;
//! }
//! let scans = raw::open(folder.path(), &OpenOptions::default())?;
//! println!("{}", scans.description());
//! for scan in scans.iter() {
//!     let scan = scan?;
//!     println!("{} at {:.1} s: {} points", scan.name, scan.time, scan.cloud.len());
//! }
//! # Ok::<(), voxelastic_io::Error>(())
//! ```

mod folder;
mod imu_feed;
mod open;
mod timed_scan;

pub use open::{RawScans, TimedScans, open};
pub use timed_scan::TimedScan;
