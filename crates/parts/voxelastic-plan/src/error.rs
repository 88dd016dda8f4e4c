//! Errors of planning.

use crate::Point;
use std::fmt;
use voxelastic::field::occupancy::State;

/// An endpoint of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// Where the robot is.
    Start,
    /// Where it should go.
    Goal,
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "start",
            Self::Goal => "goal",
        })
    }
}

/// Why the robot does not fit at a position.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Obstacle {
    /// The position itself is occupied.
    Occupied,
    /// The position is unknown.
    Unknown,
    /// The position is free, but the nearest obstacle, at this distance in metres, is nearer than the robot's radius.
    Near(f64),
    /// No floor is known below the position of a wheeled robot.
    NoFloor,
    /// The position is outside of the requested bounds.
    OutOfBounds,
}

impl Obstacle {
    /// From the state of a point and, if it is free, its clearance in metres.
    pub(crate) fn from_state(state: State, clearance: f64) -> Self {
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

/// Errors of this crate.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The map has no occupancy. Map with `field = "occupancy"` or `"both"`.
    #[error("the map has no occupancy, only surfaces: map with the field occupancy or both")]
    NoOccupancy,
    /// A number of the request is out of range.
    #[error("{what} is {value}, but {must}")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range, in words.
        must: &'static str,
    },
    /// The robot does not fit at the start or goal.
    #[error("the {endpoint} ({}) {obstacle}{}", triple(.position), suggestion(.nearest))]
    Blocked {
        /// Which of the two.
        endpoint: Endpoint,
        /// The requested position, map frame, metres.
        position: Point,
        /// Why it does not fit.
        obstacle: Obstacle,
        /// The nearest position found where the robot fits, if there is one within 5 m.
        nearest: Option<Point>,
    },
    /// The start or goal is outside of the box around everything observed.
    #[error("the {endpoint} ({}) is outside of the map, which reaches from {} to {}", triple(.position), triple(&.bounds[0]), triple(&.bounds[1]))]
    OutsideMap {
        /// Which of the two.
        endpoint: Endpoint,
        /// The requested position, map frame, metres.
        position: Point,
        /// Corners of the known part of the map.
        bounds: [Point; 2],
    },
    /// No path was found within the limits of time and samples.
    #[error(
        "no path was found in {samples} samples and {seconds:.1} s: the search got {:.1} m away from the start and {:.1} m from the goal",
        .reach[0], .reach[1]
    )]
    NotFound {
        /// Samples drawn.
        samples: usize,
        /// Time spent, seconds.
        seconds: f64,
        /// Largest straight distance that the search reached from the start and from the goal, metres: small where the endpoint is enclosed.
        reach: [f64; 2],
    },
}

fn triple(p: &Point) -> String {
    format!("{:.2}, {:.2}, {:.2}", p[0], p[1], p[2])
}

fn suggestion(nearest: &Option<Point>) -> String {
    nearest.map_or_else(String::new, |p| format!("; the robot fits at {}", triple(&p)))
}
