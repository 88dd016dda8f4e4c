//! Files in and out: registered LiDAR clouds, poses and pose graphs.

mod channels;
pub mod clouds;
pub mod dataset;
mod error;
mod file;
pub mod g2o;
mod graph;
pub mod kitti_bin;
pub mod mesh_io;
pub mod pcd;
pub mod ply;
pub mod poses;
mod record;
pub mod store;
mod text;
mod text_table;

pub use clouds::{CloudFormat, StampedCloud};
pub use dataset::{Dataset, OpenOptions};
pub use error::{Error, Position, Result};
pub use graph::PoseGraph;
pub use poses::{PoseFormat, Trajectory};
