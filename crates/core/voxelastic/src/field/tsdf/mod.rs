//! The truncated signed distance field (paper Sec. III-A, MultiresTSDF).
//!
//! A [`TsdfField`] is an octree of [`Block`]s. A block has a current scale and, for each scale from its finest to its current one, an
//! array of [`Voxel`]s, stored in bricks of 4 x 4 x 4. [`propagate`] transfers voxels between the scales of a block; the field resolves a
//! block to a single scale for extraction and fusion. Bricks that no recent scan changed are compressed without loss. Colours are a
//! separate [`ColourLayer`].

mod block;
pub(crate) mod brick;
pub(crate) mod colour;
mod excerpt;
mod field;
mod observation_count;
pub mod propagate;
mod remove;
pub(crate) mod resolve;
pub(crate) mod storage;
mod voxel;
mod writer;

pub use block::Block;
pub(crate) use block::{Array, VoxelBuffer};
pub use colour::{ColourLayer, ColourVoxel};
pub use field::TsdfField;
pub(crate) use observation_count::ObservationCount;
pub(crate) use remove::RemoveFrom;
pub(crate) use storage::compaction::BrickPages;
pub use voxel::{DISTANCE_STEPS, Voxel, WEIGHT_ONE};
pub(crate) use writer::{BlockWriter, BrickRef};
