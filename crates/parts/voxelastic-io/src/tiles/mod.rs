//! Maps that are too large to download: the surface as 3D Tiles 1.1 (OGC 22-025r4), in tiles of several levels of detail that viewers load as they need them.
//!
//! A tile of level 0 is a cube with edges of [`LEAF_EDGE`] voxels at full detail. A tile of the next level is the eight tiles below it as one mesh, with
//! vertices twice as far apart, and so on up to one tile for all: an octree, of which only cells with a surface exist, and each of which has about the
//! same size. Viewers show a tile until its error on the screen is too large, then the tiles below it (`refine: REPLACE`).
//!
//! **Cracks.** Vertices where a triangle of one tile meets one of another are never joined with others, on any level. So two neighbouring tiles have the same
//! vertices on their border, whatever their levels. All vertices lie on one lattice of a 64th of a voxel, so that rounding does not part them either.
//!
//! **Files.** The name of a file holds a hash of its content: what did not change is not written again, and viewers never mix two versions. `tileset.json` is
//! replaced last; then files that it no longer needs are removed. Below level 4 the tree is in files of its own, so that viewers load what they look at.
//!
//! [`TilesetWriter`] takes the leaves in the order of their [`Cell`]s and holds one path of the tree in memory. [`leaves`] makes them of a map one by one, so that its
//! whole surface is never in memory.

mod cell;
mod earth;
mod leaves;
mod part;
mod pyramid;
mod split;
#[cfg(test)]
mod tests;
mod tileset;
mod writer;

pub use cell::Cell;
pub use earth::{EARTH, remove_from_earth, write_on_earth};
pub use leaves::leaves;
pub use part::Part;
pub use split::split;
pub use writer::{TilesetReport, TilesetWriter};

/// Edge of a tile of level 0, finest voxels.
pub const LEAF_EDGE: u32 = 128;
/// Steps of the lattice of vertices in the edge of a finest voxel.
const STEPS_PER_VOXEL: f64 = 64.0;
