//! The grid: how voxels are numbered within a block, and blocks within a submap.

use crate::geometry::morton;

/// Voxels along the edge of a block at scale 0.
pub const BLOCK_EDGE: usize = 8;
/// log2 of [`BLOCK_EDGE`].
pub const BLOCK_SHIFT: u32 = 3;
/// Number of scales inside a block: at scale s the edge of a voxel is 2^s finest voxels (1, 2, 4 or 8).
pub const SCALES: usize = 4;

/// The null link: an octant without children or block, a block without an array.
pub const NONE: u32 = u32::MAX;

/// Added to block coordinates before they become a key. The alternating bits keep the two sides of the origin under a
/// common ancestor a few levels up; a power of two would put them under the topmost octant.
const KEY_OFFSET: i32 = 0x0a_aaaa;

/// Largest absolute block coordinate that a key can hold.
pub const MAX_BLOCK_COORD: i32 = KEY_OFFSET - 1;

/// Edge of a block in voxels at `scale`.
#[inline(always)]
pub const fn edge_at(scale: usize) -> usize {
    BLOCK_EDGE >> scale
}

/// Number of voxels in a block at `scale`.
#[inline(always)]
pub const fn voxels_at(scale: usize) -> usize {
    let n = edge_at(scale);
    n * n * n
}

/// Index of voxel `c` within a block's array at `scale`: x fastest, then y, then z.
#[inline(always)]
pub const fn voxel_index(c: [usize; 3], scale: usize) -> usize {
    let shift = BLOCK_SHIFT as usize - scale;
    c[0] | c[1] << shift | c[2] << (2 * shift)
}

/// Inverse of [`voxel_index`]: the coordinates of voxel `index` within its block, in voxels of `scale`.
#[inline(always)]
pub const fn voxel_coords(index: usize, scale: usize) -> [usize; 3] {
    let shift = BLOCK_SHIFT as usize - scale;
    let mask = edge_at(scale) - 1;
    [index & mask, index >> shift & mask, index >> (2 * shift) & mask]
}

/// Morton key of the block at `c`, counted in blocks from the submap's origin; each coordinate within ±[`MAX_BLOCK_COORD`].
#[inline(always)]
pub const fn block_key(c: [i32; 3]) -> u64 {
    morton::encode([(c[0] + KEY_OFFSET) as u32, (c[1] + KEY_OFFSET) as u32, (c[2] + KEY_OFFSET) as u32])
}

/// Where the block at `c` is among cubes with edges of 2^`shift` blocks, counted from the lowest along each axis. Cubes are nodes of the octree, which begin two blocks away from
/// multiples of larger edges.
#[inline(always)]
pub(crate) fn cube_place(c: [i32; 3], shift: u32) -> [u32; 3] {
    c.map(|c| (c + KEY_OFFSET) as u32 >> shift)
}

/// Key of a cube at such a place: [`block_key`] of its blocks, `3 * shift` bits shorter.
#[inline(always)]
pub(crate) const fn cube_key(place: [u32; 3]) -> u64 {
    morton::encode(place)
}

/// Inverse of [`block_key`]: block coordinates, counted from the submap's origin.
#[inline(always)]
pub const fn block_coords(key: u64) -> [i32; 3] {
    let c = morton::decode(key);
    [c[0] as i32 - KEY_OFFSET, c[1] as i32 - KEY_OFFSET, c[2] as i32 - KEY_OFFSET]
}
