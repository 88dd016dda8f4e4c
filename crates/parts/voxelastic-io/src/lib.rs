//! Files in and out of Voxelastic: LiDAR scans, poses and pose graphs in; meshes, clouds and saved maps in and out.
//!
//! # What it reads
//!
//! A map is built from a *registered cloud list* (paper Sec. IV): scans with poses, odometry and loop edges between them, and corrections of
//! the poses. This crate makes one, as [`Event`](voxelastic::event::Event)s, from what SLAM systems and data sets leave:
//!
//! - [`dataset::open`] recognises a folder of clouds and poses without flags, also the dumps of hdl_graph_slam, GLIM, SC-LIO-SAM, BALM and
//!   HBA, and KITTI, MulRan and Newer College as downloaded.
//! - [`bag::Recording`] plays recordings of ROS 1 and ROS 2 without ROS, and captures of Ouster sensors ([`ouster`]).
//! - [`source::open`] opens either. [`ros`] has the messages of recordings as bytes.
//! - [`raw::open`] reads scans without poses, for odometry.
//! - [`fixes::read`] reads where a receiver was on Earth, from its log, a table, a recording or KITTI's `oxts`.
//! - [`images::open`] reads images of cameras beside the scans.
//!
//! The formats below them can be used on their own: [`clouds::read`] reads one cloud ([`pcd`], [`ply`], [`bin`], and [`survey`] for LAS, LAZ
//! and E57), [`poses`] trajectories, [`g2o`] pose graphs.
//!
//! # What it writes
//!
//! [`store`] saves and reopens maps. [`mesh_io`] writes meshes as PLY and GLB, [`tiles`] maps too large to download as 3D Tiles, [`octomap`] occupancy for OctoMap,
//! [`raster`] 2-D maps for robots. [`pcd::write`],
//! [`poses::write_tum`], [`poses::write_kitti`], [`g2o::write`] and [`survey`] write what the readers accept.
//!
//! # How data flows
//!
//! ```text
//! files and names        folders, dumps, bag, ouster      what is there; nothing is decoded
//!        |
//! scans with poses       scan_list, motion                matching, keyframing, edges, corrections
//!        |
//! events                 dataset, playback, source        clouds decoded ahead, one after the other
//!        |
//! the mapper, and at the end: store, mesh_io, octomap
//! ```
//!
//! Opening is cheap: files are listed and matched, clouds are decoded when their turn comes, so memory does not grow with the data.
//! Decoding runs ahead on a thread of its own, or in the idle time of the mapper's threads ([`IdleStep`]).
//!
//! # Promises
//!
//! Readers are strict: [`Error`] names the file, the line and field or the byte, and the remedy. They do not panic on damaged input, and
//! memory follows the size of a file, not the claims of its header. A scan that cannot be read is an `Err` item; the iteration continues with
//! the next. Files are written completely or not at all.
//!
//! # Example
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
//! println!("{}", dataset.description());
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
pub mod bin;
mod capture;
pub mod clouds;
pub mod dataset;
mod dumps;
mod error;
mod file;
mod file_names;
mod fingerprint;
pub mod fixes;
mod folders;
pub mod g2o;
mod graph;
pub mod images;
pub mod imu_csv;
pub mod mesh_io;
mod motion;
pub mod octomap;
mod options;
mod origin;
pub mod ouster;
pub mod pcd;
mod playback;
pub mod ply;
mod points;
mod pose_check;
pub mod poses;
pub mod raster;
pub mod raw;
mod read_ahead;
mod read_position;
pub mod ros;
mod scan_list;
pub mod source;
mod stamped_cloud;
pub mod store;
pub mod survey;
mod text;
pub mod tiles;
mod unpacking;

pub use clouds::CloudFormat;
pub use dataset::Dataset;
pub use error::{Error, Position, Result};
pub use graph::PoseGraph;
pub use options::{OpenOptions, PointTimes, PoseKind, SensorFolder, SensorTopic};
pub use origin::Origin;
pub use poses::{PoseFormat, Trajectory};
pub use read_ahead::IdleStep;
pub use read_position::ReadPosition;
pub use scan_list::{KeyframeFilter, Keyframing};
pub use stamped_cloud::{StampedCloud, contradicts_interval};

/// Runs the examples of the book's page on the library as tests.
#[cfg(doctest)]
#[doc = include_str!("../../../../docs/src/rust/index.md")]
struct Book;
