//! The occupancy field (paper Sec. III-A, MultiresOFusion).
//!
//! An [`OccupancyField`] is an octree whose octants have one value each where space is uniform, however large, and blocks of voxels where
//! it is not. A value is the log-odds of being occupied in one byte, with a value of its own for "never observed". Octants above store a
//! [`Summary`] of their subtree, and eight uniform siblings with the same value are merged into their parent, so that free space is
//! stored at the coarsest possible scale.

mod block_states;
mod change_log;
mod faces;
mod field;
mod overwrite;
pub(crate) mod propagate;
mod value;
mod volume;
mod window;
mod writer;

pub use block_states::{BlockBits, BlockStates};
pub use change_log::{Flip, FlipKind};
pub(crate) use faces::{Boundary, Face, faces};
pub use field::{Leaf, OccupancyBlock, OccupancyField};
pub use value::{LOG_ODDS_STEPS, State, Summary, UNKNOWN, log_odds, state_of, steps};
pub use volume::Volumes;
pub(crate) use window::{BlockBox, CellContent, OccupancyWindow};
pub(crate) use writer::{BlockWriter, SharedOctants};
