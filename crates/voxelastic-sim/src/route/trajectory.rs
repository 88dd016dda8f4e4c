//! The motion of a sensor along a route, with the sway of its carrier.

use super::closed_route::Route;
use nalgebra::{Translation3, UnitQuaternion};
use std::f64::consts::TAU;
use voxelastic::Pose;

/// The carrier of a sensor: speed, height and sway.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carrier {
    /// Speed along the route, metres per second.
    pub speed: f64,
    /// Height of the sensor above the ground, metres.
    pub height: f64,
    /// Amplitude of the lateral sway, metres; the vertical one is half of it.
    pub sway: f64,
    /// Amplitude of roll and pitch, radians; that of yaw is half of it.
    pub tilt: f64,
    /// Length of one period along the route, metres (two steps of a pedestrian).
    pub stride: f64,
}

impl Carrier {
    /// A pedestrian who carries the sensor at 1.6 m and walks at 1.4 m/s.
    pub const PEDESTRIAN: Self = Self { speed: 1.4, height: 1.6, sway: 0.04, tilt: 0.05, stride: 1.5 };
    /// A tracked robot at 1 m/s.
    pub const ROBOT: Self = Self { speed: 1.0, height: 0.9, sway: 0.01, tilt: 0.02, stride: 2.3 };
    /// A car at 8 m/s with the sensor on its roof.
    pub const CAR: Self = Self { speed: 8.0, height: 2.0, sway: 0.02, tilt: 0.012, stride: 17.0 };
}

/// The motion of a sensor in continuous time.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// The route.
    pub route: Route,
    /// The carrier.
    pub carrier: Carrier,
}

impl Trajectory {
    /// Pose of the lidar frame (x ahead, y left, z up) in the map frame, `time` seconds after the start.
    pub fn pose(&self, time: f64) -> Pose {
        let Carrier { speed, height, sway, tilt, stride } = self.carrier;
        let travelled = speed * time;
        let ([x, y], heading) = self.route.at(travelled);
        let phase = TAU * travelled / stride;
        // Each fast wave is combined with a slow one of an incommensurate period, so that no two laps are equal.
        let side = sway * (0.6 * phase.sin() + 0.4 * (phase / 7.39).sin());
        let up = 0.5 * sway * (0.7 * (2.0 * phase).sin() + 0.3 * (phase / 5.17).cos());
        let roll = tilt * (0.6 * (phase + 0.8).sin() + 0.4 * (phase / 9.7).sin());
        let pitch = tilt * (0.6 * (2.0 * phase + 0.3).sin() + 0.4 * (phase / 6.1).cos());
        let yaw = 0.5 * tilt * (0.5 * (phase + 1.9).sin() + 0.5 * (phase / 4.3).sin());
        let (sin, cos) = heading.sin_cos();
        let translation = Translation3::new(x - sin * side, y + cos * side, height + up);
        Pose::from_parts(translation, UnitQuaternion::from_euler_angles(roll, pitch, heading + yaw))
    }
}
