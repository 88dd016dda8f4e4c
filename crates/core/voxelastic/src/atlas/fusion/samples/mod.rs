//! The source of a fusion at the voxels of the target: where they lie in it, and what it has there.

pub(super) mod decoded_blocks;
pub(super) mod points;
#[cfg(test)]
pub(super) mod reference;
pub(super) mod sample_grid;
pub(super) mod sampled_block;
pub(super) mod select;
pub(super) mod trilinear;
pub(super) mod tsdf_sampling;
pub(super) mod window;
