//! What is read of blocks: voxels at one scale, their masks and neighbours.

pub(super) mod block_grid;
pub(super) mod block_masks;
pub(super) mod fill_holes;
pub(super) mod padding;
pub(super) mod resolved_blocks;
