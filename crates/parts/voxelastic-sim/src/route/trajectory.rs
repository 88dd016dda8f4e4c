//! The motion of a sensor along a route, with the sway of its carrier.

use super::closed_route::Route;
use nalgebra::{Translation3, UnitQuaternion};
use std::f64::consts::TAU;
use voxelastic::Pose;

/// Time in which a carrier that stood gets to its speed, seconds.
const START_S: f64 = 1.5;
/// Period of looking around, seconds.
const LOOK_PERIOD_S: f64 = 2.4;

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
    /// Amplitude of looking to the left and right, radians, with a period of 2.4 s.
    pub look: f64,
}

impl Carrier {
    /// A pedestrian who carries the sensor at 1.6 m and walks at 1.4 m/s.
    pub const PEDESTRIAN: Self = Self { speed: 1.4, height: 1.6, sway: 0.04, tilt: 0.05, stride: 1.5, look: 0.0 };
    /// A pedestrian who holds the sensor in the hand: it shakes by some 7 degrees at each step and is swung to the left and right at up to 90
    /// degrees per second.
    pub const HANDHELD: Self = Self { speed: 1.2, height: 1.5, sway: 0.08, tilt: 0.12, stride: 1.3, look: 0.6 };
    /// A tracked robot at 1 m/s.
    pub const ROBOT: Self = Self { speed: 1.0, height: 0.9, sway: 0.01, tilt: 0.02, stride: 2.3, look: 0.0 };
    /// A car at 8 m/s with the sensor on its roof.
    pub const CAR: Self = Self { speed: 8.0, height: 2.0, sway: 0.02, tilt: 0.012, stride: 17.0, look: 0.0 };

    /// All carriers by name.
    const NAMED: [(&'static str, Self); 4] =
        [("pedestrian", Self::PEDESTRIAN), ("handheld", Self::HANDHELD), ("robot", Self::ROBOT), ("car", Self::CAR)];

    /// Names of the carriers.
    pub fn names() -> impl Iterator<Item = &'static str> {
        Self::NAMED.iter().map(|(name, _)| *name)
    }

    /// The carrier called `name`.
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMED.iter().find(|(known, _)| *known == name).map(|(_, carrier)| *carrier)
    }
}

/// The motion of a sensor in continuous time.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// The route.
    pub route: Route,
    /// The carrier.
    pub carrier: Carrier,
    /// Seconds for which the carrier stands still at first; 0 if it moves at its speed from the beginning.
    pub rest: f64,
}

impl Trajectory {
    /// Pose of the lidar frame (x ahead, y left, z up) in the map frame, `time` seconds after the start.
    pub fn pose(&self, time: f64) -> Pose {
        let Carrier { speed, height, sway, tilt, stride, look } = self.carrier;
        let moving = self.moving(time);
        let travelled = speed * moving;
        let ([x, y], heading) = self.route.at(travelled);
        let phase = TAU * travelled / stride;
        // Each fast wave is combined with a slow one of an incommensurate period, so that no two laps are equal.
        let side = sway * (0.6 * phase.sin() + 0.4 * (phase / 7.39).sin());
        let up = 0.5 * sway * (0.7 * (2.0 * phase).sin() + 0.3 * (phase / 5.17).cos());
        let roll = tilt * (0.6 * (phase + 0.8).sin() + 0.4 * (phase / 9.7).sin());
        let pitch = tilt * (0.6 * (2.0 * phase + 0.3).sin() + 0.4 * (phase / 6.1).cos());
        let yaw = 0.5 * tilt * (0.5 * (phase + 1.9).sin() + 0.5 * (phase / 4.3).sin()) + look * (TAU * moving / LOOK_PERIOD_S).sin();
        let (sin, cos) = heading.sin_cos();
        let translation = Translation3::new(x - sin * side, y + cos * side, self.route.floor(travelled) + height + up);
        Pose::from_parts(translation, UnitQuaternion::from_euler_angles(roll, pitch, heading + yaw))
    }

    /// Seconds at full speed that lead as far as `time` seconds with rest and start: its second derivative is continuous.
    fn moving(&self, time: f64) -> f64 {
        if self.rest <= 0.0 {
            return time;
        }
        let since = time - self.rest;
        if since >= START_S {
            return since - 0.5 * START_S;
        }
        let share = (since / START_S).max(0.0);
        // The integral of a smooth step from 0 to 1.
        START_S * share.powi(3) * (1.0 - 0.5 * share)
    }
}
