//! A simulated spinning LiDAR: beams of any [`voxelastic::sensor::BeamModel`], noise, and motion during the sweep.

mod lidar;
mod noise;
mod sample;

pub use lidar::{Lidar, LidarSettings};
pub use noise::Noise;
pub use sample::Sample;
