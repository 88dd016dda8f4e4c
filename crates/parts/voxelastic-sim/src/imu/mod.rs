//! A simulated inertial measurement unit: angular velocity and specific force of a moving frame, with noise and drifting biases.

mod settings;
mod unit;

pub use settings::ImuSettings;
pub use unit::{GRAVITY, Imu};
