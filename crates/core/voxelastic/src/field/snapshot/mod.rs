//! Snapshots: the complete content of a field in an order that does not depend on its history, for saving and loading.
//!
//! Block ids, slots and group indices are addresses in memory, so a snapshot has none. A field rebuilt from its snapshot gives the same
//! bits as the original in every later integration.

mod error;
mod occupancy;
mod packed;
mod tsdf;

pub use error::SnapshotError;
pub use occupancy::{OccupancyBuilder, OctantRecord};
pub use packed::{PackedBlocks, full_mask};
pub use tsdf::{BlockHead, TsdfBuilder};
