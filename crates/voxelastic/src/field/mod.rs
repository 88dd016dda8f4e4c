//! Fields: what a voxel stores, and how a block of voxels changes scale. How scans update a field is
//! [`integrate`](crate::integrate)'s concern.

mod store;
pub mod tsdf;

pub use store::{BlockStore, StoreCells};
