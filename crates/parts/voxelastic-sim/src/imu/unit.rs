//! The samples of the unit.

use super::settings::ImuSettings;
use crate::random::Stream;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;
use voxelastic::motion::ImuSample;

/// Gravity, metres per square second, along -z of the world.
pub const GRAVITY: f64 = 9.81;

/// A simulated unit. A sample is the mean over the time between two samples, as sensors filter before they sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    settings: ImuSettings,
    t_lidar_imu: Pose,
}

impl Imu {
    /// A unit with these settings.
    pub fn new(settings: ImuSettings) -> Self {
        let [roll, pitch, yaw] = settings.rotation_deg.map(f64::to_radians);
        let t_lidar_imu = Pose::from_parts(Translation3::from(Vector3::from(settings.position)), UnitQuaternion::from_euler_angles(roll, pitch, yaw));
        Self { settings, t_lidar_imu }
    }

    /// Pose of the unit in the lidar frame.
    pub fn t_lidar_imu(&self) -> &Pose {
        &self.t_lidar_imu
    }

    /// The samples from 0 to `duration` seconds, in the frame of the unit. `pose_at` is the pose of the lidar in a world with z up at a time in
    /// seconds; noise and biases depend on `random` only.
    pub fn samples(&self, duration: f64, pose_at: impl Fn(f64) -> Pose, random: &Stream) -> Vec<ImuSample> {
        let s = &self.settings;
        let step = 1.0 / s.rate;
        let mut constant = random.fork(0);
        let mut draw = |sigma: f64| Vector3::from_fn(|_, _| sigma * constant.normal());
        let (mut gyro_bias, mut accelerometer_bias) = (draw(s.gyro_bias), draw(s.accelerometer_bias));
        let count = (duration * s.rate + 1e-9).floor() as u64 + 1;
        (0..count)
            .map(|k| {
                let time = k as f64 * step;
                let mut random = random.fork(k + 1);
                let mut draw = |sigma: f64| Vector3::from_fn(|_, _| sigma * random.normal());
                gyro_bias += draw(s.gyro_walk * step.sqrt());
                accelerometer_bias += draw(s.accelerometer_walk * step.sqrt());
                let (rate, force) = self.exact(time, 0.5 * step, &pose_at);
                ImuSample {
                    time,
                    angular_velocity: (rate + gyro_bias + draw(s.gyro_noise * s.rate.sqrt())).into(),
                    acceleration: (force + accelerometer_bias + draw(s.accelerometer_noise * s.rate.sqrt())).into(),
                }
            })
            .collect()
    }

    /// Mean angular velocity and specific force over `half` seconds before and after a time, frame of the unit.
    fn exact(&self, time: f64, half: f64, pose_at: impl Fn(f64) -> Pose) -> (Vector3<f64>, Vector3<f64>) {
        let at = |t: f64| pose_at(t) * self.t_lidar_imu;
        let (before, now, after) = (at(time - half), at(time), at(time + half));
        let rate = (before.rotation.inverse() * after.rotation).scaled_axis() / (2.0 * half);
        let acceleration = (before.translation.vector + after.translation.vector - now.translation.vector * 2.0) / (half * half);
        (rate, now.rotation.inverse() * (acceleration + Vector3::z() * GRAVITY))
    }
}
