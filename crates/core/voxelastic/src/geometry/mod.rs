//! Geometry shared by all rooms: rigid transforms, axis-aligned boxes, Morton keys and a sort by them.
//!
//! Poses are [`Pose`]s in double precision and named after their frames, as in `t_map_lidar`; hot loops move points with the same
//! transform as a single-precision matrix, [`Rigid`]. Lengths are in metres, angles in radians.

pub mod aabb;
mod eigen;
pub mod morton;
pub mod pose;
mod pose_change;
mod radix_sort;
pub mod stored;

pub use aabb::{Aabb, box_around};
pub use eigen::smallest_eigenvector;
pub(crate) use eigen::smallest_eigenvectors;
pub use pose::{Pose, PoseExt, Rigid};
pub use pose_change::PoseChange;
pub(crate) use radix_sort::sort_by_bits;
