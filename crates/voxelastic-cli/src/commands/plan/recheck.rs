//! `voxelastic plan --recheck`: a path planned before, in the map as it is now.

use super::file::StoredPath;
use super::{PlanArgs, explain};
use crate::{failure, output};
use serde::Serialize;
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, UnknownAs};
use voxelastic_plan::{Air, Broken, Ground, PlanError, Point, Robot, distance, length, place, recheck};

/// What came of a recheck.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    recheck: &'a Path,
    holds: bool,
    broken: Vec<BrokenRecord>,
    /// Largest distance that a waypoint moved since the path was planned.
    moved_m: f64,
    /// Waypoints without an anchor in this map; they stay where they were.
    waypoints_lost: usize,
    length_m: f64,
    path: &'a [Point],
}

/// A piece of the path that is blocked.
#[derive(Debug, Serialize)]
struct BrokenRecord {
    /// From waypoint `piece` to the next.
    piece: usize,
    /// The robot gets so far along it.
    free_m: f64,
    /// And is then here.
    at: Point,
    /// What the map says of that place.
    state: &'static str,
}

impl From<&Broken> for BrokenRecord {
    fn from(broken: &Broken) -> Self {
        let state = match broken.state {
            State::Free => "free",
            State::Occupied => "occupied",
            State::Unknown => "unknown",
        };
        Self { piece: broken.piece, free_m: broken.free, at: broken.at, state }
    }
}

/// Looks at the path in `file` again; the exit code says whether it holds.
pub fn run(args: &PlanArgs, file: &Path, atlas: &Atlas, map: &AtlasQuery<'_>) -> anyhow::Result<u8> {
    let stored = StoredPath::read(file)?;
    let robot = stored.robot(args.robot());
    let now = match stored.anchors() {
        Some(anchors) => place(atlas, &anchors),
        None => vec![None; stored.path.len()],
    };
    let waypoints_lost = now.iter().filter(|p| p.is_none()).count();
    let path: Vec<Point> = now.iter().zip(&stored.path).map(|(now, before)| now.unwrap_or(*before)).collect();
    let moved_m = path.iter().zip(&stored.path).map(|(now, before)| distance(*now, *before)).fold(0.0, f64::max);
    let broken = look(map, &robot, &path).map_err(|error| explain(args, error))?;
    tell(&broken, &path);
    let summary = Summary {
        recheck: file,
        holds: broken.is_empty(),
        broken: broken.iter().map(BrokenRecord::from).collect(),
        moved_m,
        waypoints_lost,
        length_m: length(&path),
        path: &path,
    };
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(if broken.is_empty() { failure::DONE } else { failure::FAILED })
}

fn look(map: &AtlasQuery<'_>, robot: &Robot, path: &[Point]) -> Result<Vec<Broken>, PlanError> {
    if map.is_empty() {
        return Err(PlanError::NoOccupancy);
    }
    let known = map.bounds();
    let mut bounds = [known.min.map(f64::from), known.max.map(f64::from)];
    if robot.unknown == UnknownAs::Free {
        for k in 0..3 {
            bounds[0][k] = path.iter().fold(bounds[0][k], |low, p| low.min(p[k]));
            bounds[1][k] = path.iter().fold(bounds[1][k], |high, p| high.max(p[k]));
        }
    }
    robot.check()?;
    match robot.ground {
        Some(_) => Ok(recheck(&Ground::new(map, robot, path.first().copied().unwrap_or_default(), bounds)?, map, path)),
        None => Ok(recheck(&Air::new(map, robot, bounds), map, path)),
    }
}

fn tell(broken: &[Broken], path: &[Point]) {
    if broken.is_empty() {
        tracing::info!("the path holds: {} waypoints, {:.2} m", path.len(), length(path));
    }
    for part in broken {
        let [x, y, z] = part.at;
        let state = match part.state {
            State::Free => "something is nearer than its radius",
            State::Occupied => "occupied",
            State::Unknown => "unknown",
        };
        tracing::warn!("blocked between waypoints {} and {}, after {:.2} m, at {x:.2},{y:.2},{z:.2}: {state}", part.piece, part.piece + 1, part.free);
    }
}
