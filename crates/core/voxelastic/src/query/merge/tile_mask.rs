//! A bit per cell of a tile.

use crate::octree::BLOCK_EDGE;

/// Octree level of a tile.
pub(super) const TILE_LEVEL: u32 = 2;
/// Edge of a tile in cells.
pub(super) const TILE_EDGE: usize = BLOCK_EDGE << TILE_LEVEL;

/// A bit per cell, rows along x: row y + [`TILE_EDGE`] z.
#[derive(Clone)]
pub(super) struct TileMask(pub [u32; TILE_EDGE * TILE_EDGE]);
