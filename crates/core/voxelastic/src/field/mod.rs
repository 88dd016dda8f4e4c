//! The two fields of a submap: what is stored per voxel, how blocks of voxels are stored, and how values propagate between scales.
//!
//! [`tsdf`] is a truncated signed distance field, from which surfaces are extracted; [`occupancy`] distinguishes free, occupied and
//! unknown space. Both are octrees over blocks of voxels ([`octree`](crate::octree)) in the frame of the submap, both are adaptive in
//! resolution, and neither knows of sensors: [`integrate`](crate::integrate) updates them from scans.
//!
//! A field is saved as a snapshot and rebuilt by [`TsdfBuilder`] or [`OccupancyBuilder`].

mod block_store;
pub mod occupancy;
mod snapshot;
pub mod tsdf;

pub(crate) use block_store::BlockStore;
pub use snapshot::{BlockHead, OccupancyBuilder, OctantRecord, PackedBlocks, SnapshotError, TsdfBuilder, full_mask};
