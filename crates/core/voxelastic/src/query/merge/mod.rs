//! The whole map merged into one field of the map frame, for many queries: a merged map answers as fast as a single submap.
//!
//! An [`AtlasQuery`](super::AtlasQuery) has to query every submap and to combine their free spaces. Merging does that once for each cell of a
//! grid. From the root down, cubes whose state is the same in every submap are complete (`states`); the others are rasterised tile by tile
//! (`tile`), with the voxels of each submap as rotated boxes (`box_raster`).

mod box_raster;
mod grid;
mod merged_map;
mod states;
mod tile;
mod tile_mask;

pub use merged_map::{MergeOptions, MergedMap};
