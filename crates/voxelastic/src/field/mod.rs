//! Fields: what a voxel stores, and how a block of voxels changes scale. How scans update a field is
//! [`integrate`](crate::integrate)'s concern.

pub mod occupancy;
mod store;
mod store_image;
pub mod tsdf;

pub use store::{BlockStore, StoreCells};
pub use store_image::{BlockHead, ImageError, OccupancyBuilder, OctantRecord, TsdfBuilder};
