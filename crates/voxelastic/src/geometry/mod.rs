//! Rigid transforms, Morton keys and boxes.

pub mod aabb;
pub(crate) mod bits;
pub mod morton;
pub mod pose;
mod whole;

pub use aabb::Aabb;
pub use pose::{Pose, PoseExt, Rigid};
pub(crate) use whole::whole;
