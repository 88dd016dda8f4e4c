//! A simulated spinning LiDAR: beams of any [`voxelastic::sensor::BeamModel`], noise, and motion during the sweep.

mod lidar;
mod noise;

pub use lidar::{Lidar, LidarSettings, Sample};
pub use noise::Noise;
