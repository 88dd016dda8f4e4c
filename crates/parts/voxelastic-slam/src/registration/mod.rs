//! Registration: the pose at which the surfaces of one cloud lie on those of another.
//!
//! Points are summed into voxels; each voxel gives a mean and, where its points are flat, a normal. A local map has voxels of several sizes.
//! Gauss-Newton moves the pose under a robust kernel that narrows; distances count to planes along their normals and to other surfaces in
//! all directions. Directions in which the surfaces hold nothing keep the guess.

mod block_index;
mod degeneracy;
mod downsample;
mod information;
mod larger_planes;
mod local_map;
mod normal_equations;
mod register;
mod voxel_index;
mod voxel_size;

pub(crate) use downsample::Downsampler;
pub(crate) use local_map::{LocalMap, Surfel};
pub(crate) use register::{Registration, RegistrationSettings, mean_radius, ranked, register, search};
pub(crate) use voxel_index::{VoxelIndex, key};
pub(crate) use voxel_size::automatic_voxel_size;
