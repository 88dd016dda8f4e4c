//! Convex solids with closed forms of signed distance, ray interval, normal and bounds.
//!
//! A world is a union of solids ([`crate::World`]). Openings (doors, windows, rooms) are gaps between solids, never subtractions: outside, the distance to
//! a union is exact, that to a difference is not.

mod capsule;
mod cuboid;
mod cylinder;
mod faces;
mod half_space;
mod maths;
mod shape;
mod sphere;

pub use capsule::Capsule;
pub use cuboid::Cuboid;
pub use cylinder::Cylinder;
pub use half_space::HalfSpace;
pub use maths::Vec3;
pub use shape::Solid;
pub use sphere::Sphere;

pub(crate) use faces::Face;
pub(crate) use maths::reciprocal;
pub(crate) use shape::on_shape;

#[cfg(test)]
mod tests;
