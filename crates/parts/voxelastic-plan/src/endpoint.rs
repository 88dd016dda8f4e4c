//! Checks that the robot fits at the start and at the goal, and finds the nearest position where it does.

use crate::error::{Endpoint, Obstacle, PlanError};
use crate::points::{Point, distance};
use crate::space::{Space, is_within};
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, UnknownAs};

/// Radius of the search for a free position, metres.
const SEARCH_RADIUS: f64 = 5.0;
/// Distance between tried positions, metres.
const SPACING: f64 = 0.15;
/// Most positions tried at one distance.
const MAX_PER_SHELL: f64 = 400.0;

/// The state at a start or goal.
///
/// # Errors
/// [`PlanError::OutsideMap`] and [`PlanError::Blocked`], with the nearest position where the robot fits.
pub(crate) fn validate<S: Space>(
    space: &S,
    map: &AtlasQuery<'_>,
    known: [Point; 2],
    unknown: UnknownAs,
    endpoint: Endpoint,
    position: Point,
) -> Result<Point, PlanError> {
    if let Some(&value) = position.iter().find(|c| !c.is_finite()) {
        let what = if endpoint == Endpoint::Start { "a coordinate of the start" } else { "a coordinate of the goal" };
        return Err(PlanError::Setting { what, value, must: "must be a number" });
    }
    if let Some(state) = space.state_at(position) {
        return Ok(state);
    }
    if !is_within(&known, position) && unknown == UnknownAs::Blocked {
        return Err(PlanError::OutsideMap { endpoint, position, bounds: known });
    }
    let obstacle = if is_within(&space.bounds(), position) { obstacle(space, map, unknown, position) } else { Obstacle::OutOfBounds };
    Err(PlanError::Blocked { endpoint, position, obstacle, nearest: nearest_state(space, position) })
}

fn obstacle<S: Space>(space: &S, map: &AtlasQuery<'_>, unknown: UnknownAs, position: Point) -> Obstacle {
    let Some(centre) = space.project(position) else {
        let state = map.state(position);
        return if state == State::Free { Obstacle::NoFloor } else { Obstacle::from_state(state, 0.0) };
    };
    match map.state(centre) {
        State::Unknown if unknown == UnknownAs::Free => Obstacle::Near(map.clearance(centre, SEARCH_RADIUS, unknown)),
        state => Obstacle::from_state(state, map.clearance(centre, SEARCH_RADIUS, unknown)),
    }
}

/// The nearest of the states on spheres around `centre`, from the smallest sphere to the largest.
fn nearest_state<S: Space>(space: &S, centre: Point) -> Option<Point> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    for shell in 1..=(SEARCH_RADIUS / SPACING) as usize {
        let radius = SPACING * shell as f64;
        let count = (4.0 * std::f64::consts::PI * (shell * shell) as f64).min(MAX_PER_SHELL).ceil();
        let on_shell = (0..count as usize).map(|i| {
            // A spiral of equal areas.
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let across = (1.0 - z * z).sqrt();
            [centre[0] + radius * across * cos, centre[1] + radius * across * sin, centre[2] + radius * z]
        });
        let found = on_shell.filter_map(|p| space.state_at(p)).min_by(|a, b| distance(*a, centre).total_cmp(&distance(*b, centre)));
        if found.is_some() {
            return found;
        }
    }
    None
}
