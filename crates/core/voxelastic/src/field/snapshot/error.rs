//! What can be wrong with a snapshot.

/// Why a snapshot is not one of a field.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// The Morton key of a block is too large.
    #[error("block key {key:#x} is outside of the octree's range")]
    Key {
        /// The key.
        key: u64,
    },
    /// Blocks are not in Morton order, or a block is repeated.
    #[error("block key {key:#x} follows {last:#x}, but keys must ascend")]
    Order {
        /// The key.
        key: u64,
        /// The key before it.
        last: u64,
    },
    /// The scales of a block are out of range or contradict each other.
    #[error("block {key:#x} has scale {scale} and finest scale {finest}; the first must be 0 to 3, the second no larger")]
    Scale {
        /// The block's key.
        key: u64,
        /// Its scale.
        scale: u8,
        /// Its finest scale.
        finest: u8,
    },
    /// A mask has bits beyond the voxels of its brick.
    #[error("a mask of block {key:#x} is longer than its brick")]
    Mask {
        /// The block's key.
        key: u64,
    },
    /// The root cube is out of range.
    #[error("a root of level {level} at key {key:#x} is outside of the octree's range")]
    Root {
        /// Key of its first block.
        key: u64,
        /// Its level.
        level: u32,
    },
    /// There are more or fewer octants or blocks than the octants above them link to.
    #[error("{got} {of} were given, but the octants above them link to {expected}")]
    Count {
        /// `octants` or `blocks`.
        of: &'static str,
        /// How many were given, up to the first excess one.
        got: usize,
        /// How many were expected, as far as known.
        expected: usize,
    },
    /// Colours were given for a block that does not exist.
    #[error("block {key:#x} has colours but no distances")]
    NoBlock {
        /// The block's key.
        key: u64,
    },
    /// The arrays of a block do not have the length that its scales require.
    #[error("block {key:#x} has {got} {of}, but its scales require {expected}")]
    Length {
        /// The block's key.
        key: u64,
        /// `voxels`, `intensities` or `colours`.
        of: &'static str,
        /// How many were given.
        got: usize,
        /// How many the scales require.
        expected: usize,
    },
}
