//! Meshes of an atlas: of all submaps in the map frame, as one or in tiles.

mod atlas_mesh;
mod surface_changes;
mod surface_tiles;
mod tile_maker;

pub use atlas_mesh::FusedMesh;
pub use surface_changes::{SurfaceChanges, TileWork};
pub use surface_tiles::SurfaceTiles;
pub use tile_maker::{MadeTiles, TileMaker};

/// A tile of a surface: a name, in an order in which near tiles are near each other.
pub type TileKey = u64;
