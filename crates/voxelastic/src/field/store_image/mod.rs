//! Fields as a map store sees them: everything that they are, in an order that does not depend on how they came about.
//!
//! Ids, slots and group indices only say where things lie in memory, so an image has none. A field rebuilt from its image
//! behaves like the original, bit for bit, in whatever is integrated next.

mod occupancy;
mod tsdf;

pub use occupancy::{OccupancyBuilder, OctantRecord};
pub use tsdf::{BlockHead, TsdfBuilder};

/// Why an image is not that of a field.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// A key that no block can have.
    #[error("block key {key:#x} is outside of the octree's range")]
    Key {
        /// The key.
        key: u64,
    },
    /// Blocks that are not in Morton order, or one that comes twice.
    #[error("block key {key:#x} follows {last:#x}, but keys must ascend")]
    Order {
        /// The key.
        key: u64,
        /// The key before it.
        last: u64,
    },
    /// Scales that contradict each other.
    #[error("block {key:#x} has scale {scale} and finest scale {finest}; the first must be 0 to 3, the second no larger")]
    Scale {
        /// The block's key.
        key: u64,
        /// Its scale.
        scale: u8,
        /// Its finest scale.
        finest: u8,
    },
    /// A root cube that no octree can have.
    #[error("a root of level {level} at key {key:#x} is outside of the octree's range")]
    Root {
        /// Key of its smallest block.
        key: u64,
        /// Its level.
        level: u32,
    },
    /// More or fewer octants or blocks than the octants above them say.
    #[error("{got} {of} were given where the octants say {expected}")]
    Count {
        /// `octants` or `blocks`.
        of: &'static str,
        /// How many were given; one too many when there are more.
        got: usize,
        /// How many there should be, as far as it is known.
        expected: usize,
    },
    /// Colours of a block that is not there.
    #[error("block {key:#x} has colours but no distances")]
    NoBlock {
        /// The block's key.
        key: u64,
    },
    /// Arrays that are longer or shorter than the block's scales demand.
    #[error("block {key:#x} has {got} {of}, but its scales demand {expected}")]
    Length {
        /// The block's key.
        key: u64,
        /// `voxels` or `intensities`.
        of: &'static str,
        /// How many there are.
        got: usize,
        /// How many there should be.
        expected: usize,
    },
}
