//! The truncated signed distance field (paper Sec. III-A, MultiresTSDF): voxels, blocks, and propagation between scales.

mod blocks;
pub(crate) mod colour;
pub mod propagate;
mod voxel;

pub use blocks::{Block, TsdfField};
pub use colour::{ColourLayer, Tint};
pub use voxel::{DISTANCE_STEPS, Voxel, WEIGHT_ONE};
