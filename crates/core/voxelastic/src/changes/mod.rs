//! What appeared and what vanished between two maps of one place, such as two sessions or two surveys; and what somebody who edits a map takes out ([`erase`]).
//!
//! A surface counts as new where the older map knows that the space was free, and as gone where the newer map does: not only at the surface, but as far around
//! it as poses may be wrong. So a wall that one of the two maps merely did not see is no change, and neither is one that lies some centimetres beside the
//! other's. What stands on the ground is found from that height on.

mod compare;
mod erase;
mod fit;
mod newest;
mod pieces;
mod void;

pub use compare::{ChangeError, ChangeOptions, Changes, changes};
pub use erase::{Erase, ErasedVoxels, OccupancyThen, erase};
pub use newest::{RemovedVoxels, keep_newest};
pub use pieces::ChangedPiece;
