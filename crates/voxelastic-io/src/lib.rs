//! Files in and out of Voxelastic: registered LiDAR clouds, poses, pose graphs, meshes, saved maps.
//!
//! - [`dataset`] opens a folder of clouds and poses without flags and streams it as [`Event`](voxelastic::event::Event)s, the
//!   registered cloud list of paper Sec. IV.
//! - [`bag`] plays recordings of ROS 1 and ROS 2 as the same events; [`source`] opens either.
//! - [`ouster`] reads captures of Ouster sensors.
//! - [`clouds`] reads a single cloud: [`pcd`], [`ply`], [`kitti_bin`]. [`poses`] reads trajectories, [`g2o`] pose graphs.
//! - [`pcd::write`], [`poses::write_tum`], [`poses::write_kitti`] and [`g2o::write`] write what the readers take back.
//! - [`survey`] reads and writes LAS, LAZ and E57.
//! - [`mesh_io`] writes meshes as PLY and GLB.
//! - [`store`] saves and reopens maps.
//!
//! Readers are strict: [`Error`] names the file, the line and field or the byte, and the remedy. They never panic, and memory
//! follows the size of a file, not the claims of its header. Files are written completely or not at all.
//!
//! ```
//! use voxelastic::{Cloud, Pose, event::Event};
//! use voxelastic_io::{OpenOptions, dataset, pcd, poses};
//!
//! // A drive of two scans, as a SLAM system might save it.
//! let drive = tempfile::tempdir().unwrap();
//! for k in 0..2 {
//!     let cloud = Cloud::from_points(vec![[10.0, 0.0, 0.5], [0.0, 8.0, 0.5]]);
//!     pcd::write(drive.path().join(format!("scans/{k:06}.pcd")), &cloud)?;
//! }
//! poses::write_tum(drive.path().join("poses.tum"), &[(0.0, Pose::identity()), (0.1, Pose::translation(0.2, 0.0, 0.0))])?;
//!
//! let dataset = dataset::open(drive.path(), &OpenOptions::default())?;
//! for event in dataset.events() {
//!     match event {
//!         Ok(Event::Scan(scan)) => println!("node {}: {} points", scan.node, scan.cloud.len()),
//!         Ok(other) => println!("{other:?}"),
//!         Err(error) => eprintln!("skipped: {error}"),
//!     }
//! }
//! # Ok::<(), voxelastic_io::Error>(())
//! ```

pub mod bag;
mod channels;
pub mod clouds;
mod colours;
pub mod dataset;
mod dumps;
mod error;
mod file;
pub mod g2o;
mod graph;
pub mod kitti_bin;
pub mod mesh_io;
pub mod octomap;
pub mod ouster;
pub mod pcd;
mod playback;
pub mod ply;
pub mod poses;
mod read_ahead;
mod record;
pub mod source;
pub mod store;
pub mod survey;
mod text;
mod text_table;

pub use clouds::{CloudFormat, StampedCloud};
pub use dataset::{Dataset, OpenOptions};
pub use error::{Error, Position, Result};
pub use graph::PoseGraph;
pub use poses::{PoseFormat, Trajectory};
