//! A bounding volume hierarchy over the analytic solids of a world.
//!
//! It shares no code with the triangle hierarchy of `voxelastic-eval`: this one is built once over a few thousand convex solids by the surface area
//! heuristic, casts packets of rays against closed-form intersections, and finds the least *signed* distance in double precision. Libraries
//! offer single-precision rays or their own shapes.

mod build;
mod cast;
mod nearest;
mod node;

pub(crate) use cast::{LANES, Packet};
pub(crate) use node::SolidBvh;
