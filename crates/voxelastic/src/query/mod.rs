//! What planners ask an occupancy map: is this shape free, where does this ray end, where does the known world end?
//!
//! [`FieldQuery`] asks one [`OccupancyField`](crate::field::occupancy::OccupancyField) in its submap's frame.
//! [`AtlasQuery`] asks a whole [`Atlas`](crate::atlas::Atlas) in the map frame, with every submap where its root pose puts
//! it *now*: a place is occupied if any submap says so, and free if some submap says so and none says occupied.
//! Both borrow the map, so a query can never see half of an update. All lengths are metres.
//!
//! | question | ask |
//! | --- | --- |
//! | What is known of this point? | `state`, `log_odds` |
//! | ... of the cube of 2^level finest voxels around it? | `at_level` |
//! | Is all of this shape free? | `is_free` with a [`Sphere`], [`Capsule`] or [`OrientedBox`] |
//! | How far is it to the nearest obstacle? | `clearance` |
//! | Where does this ray end? | `cast` |
//! | Where does free space meet the unknown? | `frontier` |
//! | What does a cut through the map look like? | `slice` |
//! | The map on another grid? | [`AtlasQuery::resample`] |
//! | Many of these, fast? | [`AtlasQuery::merge`], once, then its [`query`](MergedMap::query) |
//!
//! Answers about shapes are conservative and exact to the voxel: a shape is free if and only if no voxel that it touches,
//! at the size at which the map holds it, says otherwise. Unknown space counts as not free unless
//! [`UnknownAs::Free`] is asked for.
//!
//! ```
//! use voxelastic::atlas::Atlas;
//! use voxelastic::query::{AtlasQuery, Sphere, UnknownAs};
//! let atlas = Atlas::default();
//! let map = AtlasQuery::new(&atlas, 0.065);
//! let robot = Sphere { centre: [1.0, 2.0, 0.5], radius: 0.3 };
//! assert!(!map.is_free(&robot.into(), UnknownAs::Blocked), "nothing is known of an empty map");
//! assert!(map.is_free(&robot.into(), UnknownAs::Free));
//! ```

mod atlas;
mod clearance;
mod coverage;
mod faces;
mod field;
mod free;
mod frontier;
mod merge;
mod ray;
mod resample;
mod shape;
mod slice;
mod solid;
#[cfg(test)]
mod tests;

pub use atlas::AtlasQuery;
pub(crate) use faces::{Boundary, Face, faces};
pub use field::{FieldQuery, Region};
pub use free::Work;
pub use frontier::FrontierPoint;
pub use merge::{MergedMap, Merging};
pub use ray::{Ray, RayHit};
pub use resample::{Cube, Resampling};
pub use shape::{Capsule, OrientedBox, Shape, Sphere};
pub use slice::{Axis, DistanceQuery, DistanceSlice, Slice, SliceRequest};

/// What unknown space counts as.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownAs {
    /// As something to stay out of.
    #[default]
    Blocked,
    /// As free, for optimists and for exploring.
    Free,
}
