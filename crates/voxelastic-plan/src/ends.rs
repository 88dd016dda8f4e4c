//! Does the robot fit where it is and where it is to go? If not: what is in the way, and where does it fit?

use crate::error::{End, Obstacle, PlanError};
use crate::points::{Point, distance};
use crate::space::{Space, is_within};
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, UnknownAs};

/// A place where the robot fits is looked for up to this far away, metres.
const FAR: f64 = 5.0;
/// Distance between the places that are tried, metres.
const APART: f64 = 0.15;
/// Most places tried at one distance.
const MOST: f64 = 400.0;

/// The state at an end of the way.
///
/// # Errors
/// [`PlanError::OutsideMap`] and [`PlanError::Blocked`], with the nearest place where the robot fits.
pub(crate) fn settle<S: Space>(
    space: &S,
    map: &AtlasQuery<'_>,
    known: [Point; 2],
    unknown: UnknownAs,
    end: End,
    place: Point,
) -> Result<Point, PlanError> {
    if let Some(&value) = place.iter().find(|c| !c.is_finite()) {
        let what = if end == End::Start { "a coordinate of the start" } else { "a coordinate of the goal" };
        return Err(PlanError::Setting { what, value, must: "must be a number" });
    }
    if let Some(state) = space.settle(place) {
        return Ok(state);
    }
    if !is_within(&known, place) && unknown == UnknownAs::Blocked {
        return Err(PlanError::OutsideMap { end, place, bounds: known });
    }
    let obstacle = if is_within(&space.bounds(), place) { obstacle(space, map, unknown, place) } else { Obstacle::OutOfBounds };
    Err(PlanError::Blocked { end, place, obstacle, nearest: nearest(space, place) })
}

fn obstacle<S: Space>(space: &S, map: &AtlasQuery<'_>, unknown: UnknownAs, place: Point) -> Obstacle {
    let Some(centre) = space.lay(place) else {
        let state = map.state(place);
        return if state == State::Free { Obstacle::NoFloor } else { Obstacle::of(state, 0.0) };
    };
    match map.state(centre) {
        State::Unknown if unknown == UnknownAs::Free => Obstacle::Near(map.clearance(centre, FAR, unknown)),
        state => Obstacle::of(state, map.clearance(centre, FAR, unknown)),
    }
}

/// The nearest state of those on spheres around `place`, from the smallest to the largest.
fn nearest<S: Space>(space: &S, place: Point) -> Option<Point> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    for shell in 1..=(FAR / APART) as usize {
        let radius = APART * shell as f64;
        let count = (4.0 * std::f64::consts::PI * (shell * shell) as f64).min(MOST).ceil();
        let on_shell = (0..count as usize).map(|i| {
            // A spiral of equal areas.
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let across = (1.0 - z * z).sqrt();
            [place[0] + radius * across * cos, place[1] + radius * across * sin, place[2] + radius * z]
        });
        let found = on_shell.filter_map(|p| space.settle(p)).min_by(|a, b| distance(*a, place).total_cmp(&distance(*b, place)));
        if found.is_some() {
            return found;
        }
    }
    None
}
