//! Geometry shared by all rooms: rigid transforms, axis-aligned boxes and Morton keys.
//!
//! Poses are [`Pose`]s in double precision and named after their frames, as in `t_map_lidar`; hot loops move points with the same
//! transform as a single-precision matrix, [`Rigid`]. Lengths are in metres, angles in radians.

pub mod aabb;
mod eigen;
pub mod morton;
pub mod pose;
mod pose_change;
pub mod stored;

pub use aabb::{Aabb, box_around};
pub use eigen::smallest_eigenvector;
pub(crate) use eigen::smallest_eigenvectors;
pub use pose::{Pose, PoseExt, Rigid};
pub use pose_change::PoseChange;
