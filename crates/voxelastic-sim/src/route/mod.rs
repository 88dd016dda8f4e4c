//! Where a sensor is carried: closed routes with rounded corners, and the way a walker, robot or car moves along them.

mod gait;
mod path;

pub use gait::{Gait, Ride};
pub use path::Route;
