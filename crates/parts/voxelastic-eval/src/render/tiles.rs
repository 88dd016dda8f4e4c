//! The division of a picture into tiles of samples.

/// Samples per pixel, in each direction.
pub(super) const SUPERSAMPLING: usize = 2;
/// Edge of a tile in samples.
pub(super) const TILE: usize = 64;
/// Edge of a tile in pixels.
pub(super) const TILE_PX: usize = TILE / SUPERSAMPLING;

/// The picture in samples and in tiles.
#[derive(Clone, Copy)]
pub(super) struct TileGrid {
    /// Samples across.
    pub width: usize,
    /// Samples down.
    pub height: usize,
    /// Tiles across.
    pub across: usize,
    /// Tiles down.
    pub down: usize,
}

impl TileGrid {
    /// The grid of a picture of `width` x `height` samples.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, across: width.div_ceil(TILE), down: height.div_ceil(TILE) }
    }
}
