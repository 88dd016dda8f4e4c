//! What moves: bodies along a route, beside the sensor's lane.

use crate::random::Stream;
use crate::route::{Carrier, Route, Trajectory};
use crate::{Scene, SimError, World, WorldBuilder};
use std::sync::Arc;

/// Speeds of walkers and cars, metres per second.
const WALKING: [f64; 2] = [0.8, 1.8];
const DRIVING: [f64; 2] = [5.0, 10.0];
/// How far to the side of the sensor's lane walkers on a pavement, walkers around a pedestrian, and cars move, metres.
const PAVEMENT: [f64; 2] = [5.6, 6.4];
const AROUND: [f64; 2] = [0.9, 2.5];
const NEXT_LANE: [f64; 2] = [2.2, 2.6];

/// A rigid body that moves along a route at constant speed.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its surface, in its own frame: x ahead, z up, on the ground below the origin.
    pub shape: Arc<World>,
    /// The route.
    pub route: Route,
    /// How far to the left of the route it moves, metres.
    pub left: f64,
    /// Where on the route it is at time 0, metres.
    pub start: f64,
    /// Its speed along the route, metres per second; negative against the route's direction.
    pub speed: f64,
}

impl Body {
    /// Position (metres) and heading (radians) in the world at a time in seconds.
    pub fn at(&self, time: f64) -> ([f64; 2], f64) {
        let ([x, y], heading) = self.route.at(self.start + self.speed * time);
        let (sin, cos) = heading.sin_cos();
        let towards = if self.speed < 0.0 { heading + std::f64::consts::PI } else { heading };
        ([x - sin * self.left, y + cos * self.left], towards)
    }
}

/// All bodies that move through a world.
#[derive(Clone, Debug, Default)]
pub struct Traffic {
    /// The bodies.
    pub bodies: Vec<Body>,
}

impl Traffic {
    /// `count` bodies along the route of a scene. On a car's route every second one is a car, either oncoming or ahead, and the others walk on the
    /// pavements; elsewhere all are walkers beside the sensor's way. They depend on `seed` only.
    ///
    /// # Errors
    /// None in practice: their solids are finite.
    pub fn along(scene: &Scene, count: usize, seed: u64) -> Result<Self, SimError> {
        let Trajectory { route, carrier, .. } = &scene.trajectory;
        let is_road = carrier.speed >= Carrier::CAR.speed;
        let body = |k: usize| {
            let mut random = Stream::new(seed, &[0x7a, k as u64]);
            let is_car = is_road && k.is_multiple_of(2);
            let range = |random: &mut Stream, [low, high]: [f64; 2]| random.range(low, high);
            let (speeds, beside) = match (is_car, is_road) {
                (true, _) => (DRIVING, NEXT_LANE),
                (false, true) => (WALKING, PAVEMENT),
                (false, false) => (WALKING, AROUND),
            };
            let speed = range(&mut random, speeds);
            let oncoming = random.index(2) == 0;
            let left = range(&mut random, beside);
            // Cars keep to the right of their own direction; walkers to either side.
            let is_left = if is_car { oncoming } else { random.index(2) == 0 };
            Ok(Body {
                shape: Arc::new(shape(is_car, seed.wrapping_add(k as u64))?),
                route: route.clone(),
                left: if is_left { left } else { -left },
                // Near the sensor's beginning first, and all around later.
                start: 12.0 + 9.0 * k as f64 + random.range(0.0, 6.0),
                speed: if oncoming { -speed } else { speed },
            })
        };
        Ok(Self { bodies: (0..count).map(body).collect::<Result<_, SimError>>()? })
    }
}

/// A car, or a walker: a body with a head and two legs.
fn shape(is_car: bool, seed: u64) -> Result<World, SimError> {
    let mut b = WorldBuilder::new(if is_car { "car" } else { "walker" }, seed);
    if is_car {
        b.car([0.0, 0.0], 0.0);
    } else {
        let tall = b.random.range(1.55, 1.9);
        let cloth = b.random.range(0.1, 0.7) as f32;
        b.capsule([0.0, 0.0, 0.5 * tall], [0.0, 0.0, 0.78 * tall], 0.21, cloth);
        b.sphere([0.0, 0.0, 0.93 * tall], 0.12, 0.5);
        for side in [-0.1, 0.1] {
            b.capsule([1.5 * side, side, 0.08], [0.0, side, 0.5 * tall], 0.08, cloth);
        }
    }
    b.build()
}
