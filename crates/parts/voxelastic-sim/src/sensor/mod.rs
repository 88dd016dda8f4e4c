//! A simulated LiDAR: beams of any [`voxelastic::sensor::BeamModel`] or a [`Pattern`] that never repeats, noise, and motion during the sweep.

mod lidar;
mod noise;
mod pattern;
mod sample;
mod thin;

pub use lidar::{Lidar, LidarSettings};
pub use noise::Noise;
pub use pattern::Pattern;
pub use sample::Sample;
pub(crate) use thin::thin;
