//! Surfaces: triangle meshes of the zero crossings of a TSDF, free of cracks across blocks and scales.
//!
//! Marching cubes runs on the *dual* grid: a cell's corners are the centres of the eight voxels that meet at a point,
//! whatever their scales (Schaefer and Warren 2004; Wald 2020 for block-structured data). Where scales meet, cells are
//! pyramids and prisms instead of cubes, but neighbours still share whole faces, so no crack can open.

mod cases;
mod cells;
mod colour;
mod crossings;
mod detail;
mod extract;
mod gaps;
mod layout;
mod mesh;
pub mod occupied;
mod rows;
mod samples;
#[cfg(test)]
mod tests;
mod triangles;
mod vertices;
pub(crate) mod view;

pub use extract::{MeshOptions, extract, extract_onto};
pub use mesh::Mesh;
pub use occupied::{OccupancySurface, extract_occupancy};
