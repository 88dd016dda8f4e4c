//! The octree: octants in arenas, eight siblings contiguous, blocks of 8 x 8 x 8 voxels below, and a root that grows.
//!
//! [`Octree`] is topology only: which cubes of space exist, and a small payload each. What a block holds belongs to a
//! [`field`](crate::field), which keeps its voxels in [`Pool`]s and links them by block id.

mod cells;
mod cursor;
mod pool;
mod slab;
mod tree;

pub use cells::{Cells, Place, ask_for_all, prefetch};
pub use cursor::Cursor;
pub use pool::Pool;
pub use slab::{Batch, Slab, Taking};
pub use tree::{Octant, Octree};

use crate::geometry::morton;

/// Voxels along the edge of a block at scale 0.
pub const BLOCK_EDGE: usize = 8;
/// log2 of [`BLOCK_EDGE`].
pub const BLOCK_SHIFT: u32 = 3;
/// Scales inside a block: voxel edges of 1, 2, 4 and 8 finest voxels.
pub const SCALES: usize = 4;

/// "No link": an octant without children or block, a block without an array.
pub const NONE: u32 = u32::MAX;

/// Added to block coordinates before they become a key. The alternating bits keep the two sides of the origin under a
/// common ancestor a few levels up; a power of two would put them under the topmost octant.
const KEY_OFFSET: i32 = 0x0a_aaaa;

/// Edge of a block in voxels at `scale`.
#[inline(always)]
pub const fn edge_at(scale: usize) -> usize {
    BLOCK_EDGE >> scale
}

/// Voxels of a block at `scale`.
#[inline(always)]
pub const fn voxels_at(scale: usize) -> usize {
    let n = edge_at(scale);
    n * n * n
}

/// Index of voxel `c` within a block's array at `scale`: x fastest.
#[inline(always)]
pub const fn voxel_index(c: [usize; 3], scale: usize) -> usize {
    let shift = BLOCK_SHIFT as usize - scale;
    c[0] | c[1] << shift | c[2] << (2 * shift)
}

/// Coordinates of the voxel that [`voxel_index`] numbers.
#[inline(always)]
pub const fn voxel_coords(index: usize, scale: usize) -> [usize; 3] {
    let shift = BLOCK_SHIFT as usize - scale;
    let mask = edge_at(scale) - 1;
    [index & mask, index >> shift & mask, index >> (2 * shift) & mask]
}

/// Morton key of a block; `c` counts blocks from the submap's origin.
#[inline(always)]
pub const fn block_key(c: [i32; 3]) -> u64 {
    morton::encode([(c[0] + KEY_OFFSET) as u32, (c[1] + KEY_OFFSET) as u32, (c[2] + KEY_OFFSET) as u32])
}

/// Block coordinates of a key.
#[inline(always)]
pub const fn block_coords(key: u64) -> [i32; 3] {
    let c = morton::decode(key);
    [c[0] as i32 - KEY_OFFSET, c[1] as i32 - KEY_OFFSET, c[2] as i32 - KEY_OFFSET]
}

/// Largest block coordinate that a key can hold, either sign.
pub const MAX_BLOCK_COORD: i32 = KEY_OFFSET - 1;
