//! How a sensor sways on whoever carries it.

use super::Route;
use nalgebra::{Translation3, UnitQuaternion};
use std::f64::consts::TAU;
use voxelastic::Pose;

/// How a sensor moves along a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gait {
    /// Speed along the route, metres per second.
    pub speed: f64,
    /// Height of the sensor above the ground, metres.
    pub height: f64,
    /// Largest swing to either side and, half as much, up and down, metres.
    pub sway: f64,
    /// Largest roll and pitch, and half as much in yaw, radians.
    pub tilt: f64,
    /// Length of one swing along the route, metres (two steps of a walker).
    pub stride: f64,
}

impl Gait {
    /// A person who carries the sensor by hand at 1.6 m and walks at 1.4 m/s.
    pub const WALK: Self = Self { speed: 1.4, height: 1.6, sway: 0.04, tilt: 0.05, stride: 1.5 };
    /// A tracked robot at 1 m/s.
    pub const ROBOT: Self = Self { speed: 1.0, height: 0.9, sway: 0.01, tilt: 0.02, stride: 2.3 };
    /// A car at 8 m/s with the sensor on its roof.
    pub const CAR: Self = Self { speed: 8.0, height: 2.0, sway: 0.02, tilt: 0.012, stride: 17.0 };
}

/// A sensor's motion in continuous time.
#[derive(Clone, Debug)]
pub struct Ride {
    /// The route followed.
    pub route: Route,
    /// How.
    pub gait: Gait,
}

impl Ride {
    /// Pose of the lidar frame (x ahead, y left, z up) in the map frame, `time` seconds after the start.
    pub fn pose(&self, time: f64) -> Pose {
        let Gait { speed, height, sway, tilt, stride } = self.gait;
        let travelled = speed * time;
        let ([x, y], heading) = self.route.at(travelled);
        let phase = TAU * travelled / stride;
        // A slow wave beside each quick one, of lengths with no common multiple, so that no two laps are the same.
        let side = sway * (0.6 * phase.sin() + 0.4 * (phase / 7.39).sin());
        let up = 0.5 * sway * (0.7 * (2.0 * phase).sin() + 0.3 * (phase / 5.17).cos());
        let roll = tilt * (0.6 * (phase + 0.8).sin() + 0.4 * (phase / 9.7).sin());
        let pitch = tilt * (0.6 * (2.0 * phase + 0.3).sin() + 0.4 * (phase / 6.1).cos());
        let yaw = 0.5 * tilt * (0.5 * (phase + 1.9).sin() + 0.5 * (phase / 4.3).sin());
        let (sin, cos) = heading.sin_cos();
        let place = Translation3::new(x - sin * side, y + cos * side, height + up);
        Pose::from_parts(place, UnitQuaternion::from_euler_angles(roll, pitch, heading + yaw))
    }
}
