//! The truncated signed distance field (paper Sec. III-A, MultiresTSDF): voxels, bricks, blocks, propagation between scales, and rest.

mod bitstream;
mod blocks;
pub(crate) mod brick;
pub(crate) mod colour;
mod open;
pub(crate) mod packed;
mod pieces;
pub mod propagate;
mod read;
mod rest;
mod told;
mod voxel;

pub(crate) use blocks::{Array, VoxelBuffer};
pub use blocks::{Block, TsdfField};
pub use colour::{ColourLayer, Tint};
pub(crate) use open::{OpenField, Touched};
pub(crate) use rest::BrickPages;
pub(crate) use told::Told;
pub use voxel::{DISTANCE_STEPS, Voxel, WEIGHT_ONE};
