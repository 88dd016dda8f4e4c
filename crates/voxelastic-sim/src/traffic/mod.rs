//! Cars and walkers that move through a world while it is scanned.

mod body;
mod surroundings;

pub use body::{Body, Traffic};
pub(crate) use surroundings::BodyPose;
pub use surroundings::Surroundings;
