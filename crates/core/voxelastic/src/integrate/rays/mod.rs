//! Rays: the returns of a scan in the submap frame, bundled where they are closer together than voxels, and the traversal of voxels along them.
//!
//! A *return* is a measured point of the scan ([`ReturnsView`](returns::ReturnsView)). A *ray* ([`ray::Ray`]) is what is walked through voxels: one return, or a
//! bundle of neighbouring ones, with the interval around its point that is of interest.

pub(crate) mod dda;
pub(crate) mod ray;
mod ray_bundling;
pub(crate) mod returns;
pub(crate) mod scale;
pub(crate) mod select;
pub(crate) mod transform;
