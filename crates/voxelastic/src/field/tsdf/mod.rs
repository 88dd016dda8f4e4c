//! The truncated signed distance field (paper Sec. III-A, MultiresTSDF): voxels, blocks, propagation between scales, and rest.

mod blocks;
pub(crate) mod colour;
pub(crate) mod packed;
pub mod propagate;
mod rest;
mod voxel;

pub(crate) use blocks::VoxelBuffer;
pub use blocks::{Block, TsdfField};
pub use colour::{ColourLayer, Tint};
pub use voxel::{DISTANCE_STEPS, Voxel, WEIGHT_ONE};
