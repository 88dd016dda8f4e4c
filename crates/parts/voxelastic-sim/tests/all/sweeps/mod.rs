//! Sweeps as a turning sensor records them, with an inertial unit, traffic and recordings.
#![allow(clippy::unwrap_used)]

mod carriers;
mod imu;
mod recording;
mod traffic;
