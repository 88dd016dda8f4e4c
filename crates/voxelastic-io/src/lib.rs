//! Files in and out: registered LiDAR clouds, poses and pose graphs.

mod error;
mod file;
pub mod g2o;
mod graph;
pub mod pcd;
pub mod poses;
pub mod store;

pub use error::{Error, Position, Result};
pub use graph::PoseGraph;
