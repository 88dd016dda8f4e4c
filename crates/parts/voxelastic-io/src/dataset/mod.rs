//! A folder of clouds with their poses as one registered cloud list: recognised without flags, read as a stream of events.
//!
//! ```text
//! drive/
//!   scans/ | velodyne/ | clouds/ | ..   clouds (.pcd, .ply, .bin, .pcd.bin), or in the folder itself, or some levels below it
//!   poses.tum                           a trajectory, recognised by its content: TUM, KITTI rows, Newer College CSV
//!   graph.g2o                           nodes, odometry edges and loop edges
//!   times.txt                           the time of each cloud (or of each pose)
//!   groundtruth.txt                     a trajectory named ground truth, used for comparison only
//!   poses@000123.txt                    corrected poses, known after the scan of node 123
//! ```
//!
//! The layouts of other SLAM systems and data sets (hdl_graph_slam, GLIM, BALM and HBA, KITTI odometry, MulRan, ..) are recognised as well.
//!
//! [`open`] lists and matches, which is cheap; [`Dataset::events`] decodes clouds as they are needed. Without poses, [`crate::raw`] reads the
//! clouds of a folder.

mod choose_poses;
mod cloud_times;
mod description;
mod events;
mod folder;
mod ground_truth;
mod matching;
mod open;
mod pose_file;
mod registered;
mod snapshot;
mod tie_graph;
mod together;

pub use crate::options::{OpenOptions, PoseKind};
pub use crate::scan_list::{Keyframing, ScanEntry};
pub use description::{Description, PosesDescription};
pub use events::Events;
pub(crate) use events::FolderPosition;
pub use ground_truth::GroundTruth;
pub use matching::MatchedBy;
pub use open::{open, open_truth};
pub use registered::Dataset;
