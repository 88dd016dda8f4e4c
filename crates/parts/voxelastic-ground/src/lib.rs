//! The ground of Voxelastic's maps: where a robot can stand and drive, and what it meets there.
//!
//! [`Columns`] are what an atlas knows above and below each cell of a grid. [`Levels`] are the surfaces in them on which something could stand. [`Ground`] follows the floor
//! from below the sensor's way over ramps, kerbs and stairs, and divides it into [`Storey`]s, each with one height at a place. [`Grid`] is the 2-D map of a storey for a
//! robot ([`Body`]); [`band`] is the rule by which a column becomes a cell of it, [`Inflation`] by which it costs to be near an obstacle. Of a map that changes, [`GroundTiles`] keep columns and levels up.
//!
//! All lengths are in metres, all points in the map frame, whose z axis points up.

mod cells;
mod changes;
mod column;
mod columns;
mod connections;
mod costs;
mod error;
mod floor;
mod floor_cell;
mod follow;
mod grid;
mod ground;
mod levels;
mod robot;
mod slope;
mod storey;
mod storeys;
mod tiles;
mod truth;

pub use cells::Cells;
pub use column::{Span, band};
pub use columns::Columns;
pub use connections::Connection;
pub use costs::Inflation;
pub use error::GroundError;
pub use floor_cell::{FloorCell, Known};
pub use grid::Grid;
pub use ground::Ground;
pub use levels::{Level, Levels};
pub use robot::Body;
pub use slope::Plane;
pub use storey::Storey;
pub use tiles::{GroundTiles, TilesCopy};
pub use truth::{FloorScores, TrueWorld, compare as compare_floor};
