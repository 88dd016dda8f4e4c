//! What moves: bodies along a route, beside the sensor's lane.

use super::label::Label;
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
/// How far to the right a car is parked that leaves, and to the left the hinge of a gate, metres.
const PARKED: f64 = 2.3;
const BESIDE: f64 = 2.0;
/// Length, thickness and height of a gate, metres.
const GATE: [f64; 3] = [1.2, 0.05, 1.9];

/// How a body moves.
#[derive(Clone, Debug)]
pub enum Course {
    /// Along a route at constant speed.
    Along {
        /// The route.
        route: Route,
        /// How far to the left of the route it moves, metres.
        left: f64,
        /// Where on the route it is at first, metres.
        start: f64,
        /// Its speed along the route, metres per second; negative against the route's direction.
        speed: f64,
        /// Until when it stands, seconds.
        departs: f64,
    },
    /// It turns about an upright hinge, as a door does.
    Turning {
        /// The hinge, metres.
        hinge: [f64; 2],
        /// Heading before and after, radians.
        headings: [f64; 2],
        /// When it begins and ends to turn, seconds.
        times: [f64; 2],
    },
}

/// A rigid body that moves.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its surface, in its own frame: x ahead, z up, on the ground below the origin.
    pub shape: Arc<World>,
    /// How it moves.
    pub course: Course,
}

impl Body {
    /// Position (metres) and heading (radians) in the world at a time in seconds.
    pub fn at(&self, time: f64) -> ([f64; 2], f64) {
        match &self.course {
            Course::Along { route, left, start, speed, departs } => {
                let ([x, y], heading) = route.at(start + speed * (time - departs).max(0.0));
                let (sin, cos) = heading.sin_cos();
                let towards = if *speed < 0.0 { heading + std::f64::consts::PI } else { heading };
                ([x - sin * left, y + cos * left], towards)
            }
            Course::Turning { hinge, headings: [from, to], times: [begin, end] } => {
                (*hinge, from + (to - from) * ((time - begin) / (end - begin).max(1e-9)).clamp(0.0, 1.0))
            }
        }
    }

    /// What points on it are labelled at a time in seconds.
    pub fn label(&self, time: f64) -> Label {
        match &self.course {
            Course::Along { departs, .. } if time < *departs => Label::Resting,
            Course::Turning { times: [begin, _], .. } if time < *begin => Label::Resting,
            Course::Turning { times: [_, end], .. } if time >= *end => Label::Settled,
            _ => Label::Moving,
        }
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
    /// pavements; elsewhere all are walkers beside the sensor's way. Of every six, the fifth is a parked car that leaves when the sensor has seen it, and the sixth
    /// a gate beside the way that opens then. They depend on `seed` only.
    ///
    /// # Errors
    /// None in practice: their solids are finite.
    pub fn along(scene: &Scene, count: usize, seed: u64) -> Result<Self, SimError> {
        let body = |k: usize| {
            let mut random = Stream::new(seed, &[0x7a, k as u64]);
            let seed = seed.wrapping_add(k as u64);
            match k % 6 {
                4 => Self::parked(scene, k, seed, &mut random),
                5 => Self::gate(scene, k, seed, &mut random),
                _ => Self::moving(scene, k, seed, &mut random),
            }
        };
        Ok(Self { bodies: (0..count).map(body).collect::<Result<_, SimError>>()? })
    }

    /// A car or a walker that moves all the time.
    fn moving(scene: &Scene, k: usize, seed: u64, random: &mut Stream) -> Result<Body, SimError> {
        let Trajectory { route, carrier, .. } = &scene.trajectory;
        let is_road = carrier.speed >= Carrier::CAR.speed;
        let is_car = is_road && k.is_multiple_of(2);
        let range = |random: &mut Stream, [low, high]: [f64; 2]| random.range(low, high);
        let (speeds, beside) = match (is_car, is_road) {
            (true, _) => (DRIVING, NEXT_LANE),
            (false, true) => (WALKING, PAVEMENT),
            (false, false) => (WALKING, AROUND),
        };
        let speed = range(random, speeds);
        let oncoming = random.index(2) == 0;
        let left = range(random, beside);
        // Cars keep to the right of their own direction; walkers to either side.
        let is_left = if is_car { oncoming } else { random.index(2) == 0 };
        let course = Course::Along {
            route: route.clone(),
            left: if is_left { left } else { -left },
            start: Self::place(k, random),
            speed: if oncoming { -speed } else { speed },
            departs: 0.0,
        };
        Ok(Body { shape: Arc::new(shape(is_car, seed)?), course })
    }

    /// Where body `k` is on the route at first, metres: near the sensor's beginning first, and all around later.
    fn place(k: usize, random: &mut Stream) -> f64 {
        12.0 + 9.0 * k as f64 + random.range(0.0, 6.0)
    }

    /// A car that stands beside the sensor's lane and leaves while the sensor comes near.
    fn parked(scene: &Scene, k: usize, seed: u64, random: &mut Stream) -> Result<Body, SimError> {
        let Trajectory { route, carrier, .. } = &scene.trajectory;
        let start = Self::place(k, random);
        let departs = 0.6 * start / carrier.speed;
        let course = Course::Along { route: route.clone(), left: -PARKED, start, speed: random.range(DRIVING[0], DRIVING[1]), departs };
        Ok(Body { shape: Arc::new(shape(true, seed)?), course })
    }

    /// A gate beside the sensor's way that swings open, in two seconds, while the sensor comes near.
    fn gate(scene: &Scene, k: usize, seed: u64, random: &mut Stream) -> Result<Body, SimError> {
        let Trajectory { route, carrier, .. } = &scene.trajectory;
        let start = Self::place(k, random);
        let ([x, y], heading) = route.at(start);
        let (sin, cos) = heading.sin_cos();
        let begin = 0.6 * start / carrier.speed;
        let mut b = WorldBuilder::new("gate", seed);
        b.turned([0.5 * GATE[0], 0.0, 0.1 + 0.5 * GATE[2]], GATE, 0.0, 0.5);
        let hinge = [x - sin * BESIDE, y + cos * BESIDE];
        let course = Course::Turning { hinge, headings: [heading, heading + 0.5 * std::f64::consts::PI], times: [begin, begin + 2.0] };
        Ok(Body { shape: Arc::new(b.build()?), course })
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
