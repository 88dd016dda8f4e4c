//! The truncated signed distance field (paper Sec. III-A, MultiresTSDF): voxels, blocks, and propagation between scales.

mod blocks;
pub mod propagate;
mod voxel;

pub use blocks::{Block, TsdfField};
pub use voxel::{DISTANCE_STEPS, Voxel, WEIGHT_ONE};
