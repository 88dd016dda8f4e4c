//! Surfaces: triangle meshes of the zero crossings of a TSDF, without cracks between blocks and scales, and of occupied or free space.
//!
//! Marching cubes runs on the *dual* grid: a cell's corners are the centres of the eight voxels that meet at a point,
//! whatever their scales (Schaefer and Warren 2004; Wald 2020 for block-structured data). Where scales meet, cells are
//! pyramids and prisms instead of cubes, but neighbours still share whole faces, so there are no cracks.

mod blocks;
mod evidence;
mod extract;
mod marching_cubes;
mod mesh;
mod occupancy_faces;
mod pieces;
mod simplify;
#[cfg(test)]
mod tests;
mod tiling;

pub use evidence::SmallComponents;
pub use extract::{MeshOptions, extract, extract_onto};
pub use mesh::Mesh;
pub use occupancy_faces::{OccupancySurface, extract_occupancy};
pub use simplify::simplify;
pub(crate) use tiling::join::extract_joined;
pub(crate) use tiling::seams::{Seams, TileSeam};
pub(crate) use tiling::tile_surface::{TileIndex, TileSurface, tile_surfaces};
pub use tiling::tiles::{TILE_EDGE, Tile, extract_tiles};
