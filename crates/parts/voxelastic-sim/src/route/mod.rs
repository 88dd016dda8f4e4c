//! Trajectories of a sensor: closed routes with rounded corners, and the motion of a pedestrian, robot or car along them.

mod closed_route;
mod trajectory;

pub use closed_route::Route;
pub use trajectory::{Carrier, Trajectory};
