//! Worlds to test LiDAR mapping in.

mod bvh;
mod error;
pub mod picture;
pub mod random;
pub mod route;
pub mod scenes;
pub mod solid;
pub mod world;

pub use error::SimError;
pub use scenes::Scene;
pub use world::{Hit, Ray, SurfacePoint, World, WorldBuilder};
