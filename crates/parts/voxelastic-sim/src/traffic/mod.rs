//! Cars and walkers that move through a world while it is scanned.

mod body;
mod label;
mod surroundings;

pub use body::{Body, Course, Traffic};
pub use label::Label;
pub(crate) use surroundings::BodyPose;
pub use surroundings::Surroundings;
