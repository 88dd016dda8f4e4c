//! Rigid transforms, Morton keys and boxes.

pub mod aabb;
pub mod morton;
pub mod pose;

pub use aabb::Aabb;
pub use pose::{Pose, PoseExt, Rigid};
