//! Meshes of an atlas: of all submaps in the map frame, or of single submaps in their own frames, cached.

mod atlas_mesh;
mod fused_surface;
mod live_surface;
mod mesh_cache;
mod surface_changes;
mod surface_tiles;
mod tile_maker;

pub use atlas_mesh::OneSurface;
pub use fused_surface::{FusedSurface, TileKey};
pub use live_surface::LiveSurface;
pub use mesh_cache::MeshCache;
pub use surface_changes::{SurfaceChanges, TileWork};
pub use surface_tiles::SurfaceTiles;
pub use tile_maker::{MadeTiles, TileMaker};
