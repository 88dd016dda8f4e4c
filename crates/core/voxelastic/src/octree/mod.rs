//! A sparse octree over blocks of 8 x 8 x 8 voxels, and the memory that fields keep their voxels in.
//!
//! [`Octree`] is topology only: which cubes of space exist, with a small payload each. Its leaves at level 0 are blocks, named by a
//! Morton key ([`block_key`]); an octant of level n spans 2^n blocks along each axis. The eight children of an octant are stored
//! contiguously, and the root grows as scans reach out. The voxels of a block belong to a [`field`](crate::field), which links them
//! by block id.
//!
//! A block has four scales: at scale s its voxels have an edge of 2^s finest voxels.
//!
//! Internally, items of one type are stored in paged arenas: `Pool` for use by one thread, `Slab` for allocation by several threads;
//! `DisjointMut` gives several threads write access to different items.

mod cursor;
mod disjoint_mut;
mod layout;
mod pool;
mod prefetch;
mod slab;
mod tree;

pub(crate) use cursor::Cursor;
pub(crate) use disjoint_mut::{DisjointMut, SlotPtr, assert_distinct};
pub use layout::{BLOCK_EDGE, BLOCK_SHIFT, MAX_BLOCK_COORD, NONE, SCALES, block_coords, block_key, edge_at, voxel_coords, voxel_index, voxels_at};
pub(crate) use layout::{cube_key, cube_place};
pub(crate) use pool::Pool;
pub(crate) use prefetch::{prefetch, prefetch_item};
pub(crate) use slab::{Slab, SlabAllocator, SlotBatch};
pub use tree::{Octant, Octree};
