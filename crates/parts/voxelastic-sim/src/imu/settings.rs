//! Settings of the unit.

use crate::SimError;
use serde::{Deserialize, Serialize};

/// Settings of an inertial measurement unit. The default is a small MEMS unit like those in lidars (data sheets of the InvenSense ICM-20948 and Bosch
/// BMI088), which sits a few centimetres beside the lidar's origin and is turned against it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImuSettings {
    /// Samples per second.
    pub rate: f64,
    /// Noise density of the angular velocity, radians per second and square root of hertz.
    pub gyro_noise: f64,
    /// Noise density of the acceleration, metres per square second and square root of hertz.
    pub accelerometer_noise: f64,
    /// Standard deviation of the constant bias of each angular velocity, radians per second.
    pub gyro_bias: f64,
    /// Standard deviation of the constant bias of each acceleration, metres per square second.
    pub accelerometer_bias: f64,
    /// By how much the bias of the angular velocity wanders, radians per second in the square root of a second.
    pub gyro_walk: f64,
    /// By how much the bias of the acceleration wanders, metres per square second in the square root of a second.
    pub accelerometer_walk: f64,
    /// Position of the unit in the lidar frame, metres.
    pub position: [f64; 3],
    /// Rotation of its axes in the lidar frame: roll, pitch and yaw, degrees.
    pub rotation_deg: [f64; 3],
}

impl Default for ImuSettings {
    fn default() -> Self {
        Self {
            rate: 100.0,
            gyro_noise: 2.6e-4,
            accelerometer_noise: 2.3e-3,
            gyro_bias: 0.01,
            accelerometer_bias: 0.05,
            gyro_walk: 2e-5,
            accelerometer_walk: 5e-4,
            position: [0.05, -0.03, -0.08],
            rotation_deg: [0.0, 0.0, 180.0],
        }
    }
}

impl ImuSettings {
    /// A unit without noise and bias at the lidar's origin, with its axes.
    pub fn exact(rate: f64) -> Self {
        Self {
            rate,
            gyro_noise: 0.0,
            accelerometer_noise: 0.0,
            gyro_bias: 0.0,
            accelerometer_bias: 0.0,
            gyro_walk: 0.0,
            accelerometer_walk: 0.0,
            position: [0.0; 3],
            rotation_deg: [0.0; 3],
        }
    }

    pub(crate) fn check(&self) -> Result<(), SimError> {
        let bad = |setting, value, allowed| Err(SimError::Setting { setting, value, allowed });
        if !(1.0..=1e4).contains(&self.rate) {
            return bad("imu.rate", self.rate, "from 1 to 10000 samples per second");
        }
        let amounts = [
            ("imu.gyro_noise", self.gyro_noise),
            ("imu.accelerometer_noise", self.accelerometer_noise),
            ("imu.gyro_bias", self.gyro_bias),
            ("imu.accelerometer_bias", self.accelerometer_bias),
            ("imu.gyro_walk", self.gyro_walk),
            ("imu.accelerometer_walk", self.accelerometer_walk),
        ];
        if let Some((setting, value)) = amounts.into_iter().find(|(_, value)| !(0.0..=100.0).contains(value)) {
            return bad(setting, value, "from 0 to 100");
        }
        match self.position.iter().chain(&self.rotation_deg).find(|v| !(-1e3..=1e3).contains(*v)) {
            Some(value) => bad("imu.position or imu.rotation_deg", *value, "from -1000 to 1000"),
            None => Ok(()),
        }
    }
}
