//! Poses alone.

pub mod localize;
pub mod odometry;
pub mod optimize;
