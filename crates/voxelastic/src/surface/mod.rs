//! Surfaces: triangle meshes of the zero crossings of a TSDF, without cracks between blocks and scales, and of occupied or free space.
//!
//! Marching cubes runs on the *dual* grid: a cell's corners are the centres of the eight voxels that meet at a point,
//! whatever their scales (Schaefer and Warren 2004; Wald 2020 for block-structured data). Where scales meet, cells are
//! pyramids and prisms instead of cubes, but neighbours still share whole faces, so there are no cracks.

mod block_grid;
mod block_masks;
mod cells;
mod colour;
mod crossings;
mod edge_table;
mod evidence;
mod extract;
mod fill_holes;
mod join;
mod mc_table;
mod mesh;
mod mesh_part;
mod occupancy_faces;
mod padding;
mod piece_sets;
mod pieces;
mod resolved_blocks;
mod seams;
mod simplify;
#[cfg(test)]
mod tests;
mod tile_surface;
mod tiles;
mod triangles;
mod vertices;

pub use evidence::Crumbs;
pub use extract::{MeshOptions, extract, extract_onto};
pub(crate) use join::extract_joined;
pub use mesh::Mesh;
pub use occupancy_faces::{OccupancySurface, extract_occupancy};
pub(crate) use seams::{Seams, TileSeam};
pub use simplify::simplify;
pub(crate) use tile_surface::{TileIndex, TileSurface, tile_surfaces};
pub use tiles::{TILE_EDGE, Tile, extract_tiles};
