//! Why there is no path.

use crate::Point;
use std::fmt;
use voxelastic::field::occupancy::State;

/// One end of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Where the robot is.
    Start,
    /// Where it is to go.
    Goal,
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "start",
            Self::Goal => "goal",
        })
    }
}

/// What keeps the robot from standing at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Obstacle {
    /// The place itself is occupied.
    Occupied,
    /// Nothing is known of the place.
    Unknown,
    /// The place is free, but something that stops the robot is nearer than its radius: so near, in metres.
    Near(f64),
    /// A wheeled robot finds no floor below, or none that is known.
    NoFloor,
    /// The place is outside of the bounds that were asked for.
    OutOfBounds,
}

impl Obstacle {
    /// What a point's state says of it; `clearance` is for a free one.
    pub(crate) fn of(state: State, clearance: f64) -> Self {
        match state {
            State::Occupied => Self::Occupied,
            State::Unknown => Self::Unknown,
            State::Free => Self::Near(clearance),
        }
    }
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Occupied => f.write_str("is in occupied space"),
            Self::Unknown => f.write_str("is in unknown space"),
            Self::Near(distance) => write!(f, "is only {distance:.2} m from the nearest obstacle or unknown space"),
            Self::NoFloor => f.write_str("has no known floor below it"),
            Self::OutOfBounds => f.write_str("is outside of the bounds to plan in"),
        }
    }
}

/// What can go wrong with planning.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The map has no occupancy. Map with `field = "occupancy"` or `"both"`.
    #[error("the map has no occupancy, only surfaces: map with the field occupancy or both")]
    NoOccupancy,
    /// A number of the request makes no sense.
    #[error("{what} is {value}, but {must}")]
    Setting {
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// The robot does not fit at one end.
    #[error("the {end} ({}) {obstacle}{}", triple(.place), suggestion(.nearest))]
    Blocked {
        /// Which end.
        end: End,
        /// The place asked for, map frame, metres.
        place: Point,
        /// What is in the way.
        obstacle: Obstacle,
        /// The nearest place found where the robot fits, if one is within some metres.
        nearest: Option<Point>,
    },
    /// One end is outside of everything that was ever observed.
    #[error("the {end} ({}) is outside of the map, which reaches from {} to {}", triple(.place), triple(&.bounds[0]), triple(&.bounds[1]))]
    OutsideMap {
        /// Which end.
        end: End,
        /// The place asked for, map frame, metres.
        place: Point,
        /// Corners of the known part of the map.
        bounds: [Point; 2],
    },
    /// No path was found in the time or the number of samples allowed.
    #[error(
        "no path was found in {samples} samples and {seconds:.1} s: from the start the robot gets {:.1} m far, from the goal {:.1} m",
        .reach[0], .reach[1]
    )]
    NotFound {
        /// Samples drawn.
        samples: usize,
        /// Time spent, seconds.
        seconds: f64,
        /// How far from the start and from the goal the robot was found to get, metres: small where it is walled in.
        reach: [f64; 2],
    },
}

fn triple(p: &Point) -> String {
    format!("{:.2}, {:.2}, {:.2}", p[0], p[1], p[2])
}

fn suggestion(nearest: &Option<Point>) -> String {
    nearest.map_or_else(String::new, |p| format!("; the robot fits at {}", triple(&p)))
}
