//! Queries on occupancy maps for planners: collision checks, distances, rays, frontiers, slices.
//!
//! [`FieldQuery`] queries one [`OccupancyField`](crate::field::occupancy::OccupancyField) in the submap frame. [`AtlasQuery`] queries a whole
//! [`Atlas`](crate::atlas::Atlas) in the map frame, with every submap at its *current* root pose: a point is occupied if it is occupied in
//! any submap, and free if it is free in some submap and occupied in none. Both borrow the map, so the map cannot change meanwhile. All
//! lengths are metres.
//!
//! | question | method |
//! | --- | --- |
//! | State of a point | `state`, `log_odds`; of many points, fast: [`AtlasQuery::states`] |
//! | State of the cube of 2^level finest voxels around it | `at_level` |
//! | Is all of a shape free? | `is_free` with a [`Sphere`], [`Capsule`] or [`OrientedBox`] |
//! | Distance to the nearest obstacle | `clearance` |
//! | Signed distance to surfaces (TSDF) and its gradient | [`DistanceQuery::sample`]; at many points, fast: [`DistanceQuery::sample_many`], without gradients [`DistanceQuery::sample_distances`] |
//! | Where does a ray end? | `ray_cast` |
//! | Boundary of free to unknown space | `frontier` |
//! | Cross-section as an image | `slice` |
//! | The map on another grid | [`AtlasQuery::resample`] |
//! | Many queries, fast | [`AtlasQuery::merge`] once, then its [`query`](MergedMap::query) |
//!
//! Collision checks are conservative and exact to the voxel: a shape is free if and only if all voxels that it touches, at the size at which
//! the map holds them, are free. Unknown space counts as not free unless [`UnknownAs::Free`] is given.
//!
//! ```
//! use voxelastic::atlas::Atlas;
//! use voxelastic::query::{Sphere, UnknownAs};
//! let atlas = Atlas::new(0.065);
//! let map = atlas.query()?;
//! let robot = Sphere { centre: [1.0, 2.0, 0.5], radius: 0.3 };
//! assert!(!map.is_free(&robot.into(), UnknownAs::Blocked), "an empty map is unknown everywhere");
//! assert!(map.is_free(&robot.into(), UnknownAs::Free));
//! # Ok::<(), voxelastic::query::MissingField>(())
//! ```

mod atlas;
mod block_window;
mod clearance;
mod collision;
mod coverage;
mod field;
mod fields;
mod frontier;
mod merge;
mod point_order;
mod ray_cast;
mod resample;
mod sample_many;
mod shape;
mod shape_sdf;
mod slice;
mod surface_distance;
#[cfg(test)]
mod tests;
mod unknown;

pub use atlas::AtlasQuery;
pub use collision::QueryStats;
pub use field::{CellSummary, FieldQuery};
pub use fields::MissingField;
pub use frontier::FrontierPoint;
pub use merge::{MergeOptions, MergedMap};
pub use ray_cast::{Ray, RayHit};
pub use resample::{Cube, Resampling};
pub use shape::{Capsule, OrientedBox, Shape, Sphere};
pub use slice::{Axis, DistanceQuery, DistanceSlice, Slice, SliceRequest};
pub use surface_distance::SurfaceDistance;
pub use unknown::UnknownAs;
