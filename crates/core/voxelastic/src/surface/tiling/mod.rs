//! The surface in tiles, each by itself, and tiles joined to one mesh.

pub(super) mod join;
pub(super) mod piece_sets;
pub(super) mod seams;
pub(super) mod tile_surface;
pub(super) mod tiles;
