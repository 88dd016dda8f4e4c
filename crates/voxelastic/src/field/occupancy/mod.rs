//! The occupancy field (paper Sec. III-A, MultiresOFusion): log-odds in one byte, free space at the coarsest octant that is
//! wholly free, unknown as a state of its own.

mod blocks;
mod value;
mod volume;

pub use blocks::{Leaf, OccupancyBlock, OccupancyField};
pub use value::{LOG_ODDS_STEPS, State, Summary, UNKNOWN, log_odds, state_of, steps};
pub use volume::Volumes;
