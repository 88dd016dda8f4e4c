//! `voxelastic plan --recheck`: checks a stored path in the present map.

use super::args::{PlanArgs, explain};
use crate::{failure, output};
use serde::Serialize;
use std::path::Path;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, UnknownAs};
use voxelastic_plan::{BlockedSegment, FlyingSpace, GroundSpace, PlanError, Point, Robot, distance, length, recheck, resolve_anchors};
use voxelastic_run::export::path::StoredPath;
use voxelastic_run::map_files::LoadedMap;

/// The keys of `--json` for a recheck.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    recheck: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    holds: bool,
    broken: Vec<BrokenRecord>,
    /// Largest distance between a waypoint now and when it was planned.
    moved_m: f64,
    /// Waypoints without an anchor in this map; they keep their positions.
    waypoints_lost: usize,
    length_m: f64,
    path: &'a [Point],
}

/// A blocked segment of the path.
#[derive(Debug, Serialize)]
struct BrokenRecord {
    /// Index of the waypoint at its start.
    piece: usize,
    /// Free length from its start.
    free_m: f64,
    /// Position of the robot at the end of the free length.
    at: Point,
    /// State of the map there.
    state: &'static str,
}

impl From<&BlockedSegment> for BrokenRecord {
    fn from(broken: &BlockedSegment) -> Self {
        let state = match broken.state {
            State::Free => "free",
            State::Occupied => "occupied",
            State::Unknown => "unknown",
        };
        Self { piece: broken.segment, free_m: broken.free, at: broken.at, state }
    }
}

/// Checks the path in `file`; the exit code is 0 if it is free.
pub fn run(args: &PlanArgs, file: &Path, loaded: &LoadedMap, map: &AtlasQuery<'_>) -> anyhow::Result<u8> {
    let stored = StoredPath::read(file, loaded.origin)?;
    let robot = stored.robot(args.robot());
    let now = match stored.anchors() {
        Some(anchors) => resolve_anchors(&loaded.atlas, &anchors),
        None => vec![None; stored.path.len()],
    };
    let waypoints_lost = now.iter().filter(|p| p.is_none()).count();
    let path: Vec<Point> = now.iter().zip(&stored.path).map(|(now, before)| now.unwrap_or(*before)).collect();
    let moved_m = path.iter().zip(&stored.path).map(|(now, before)| distance(*now, *before)).fold(0.0, f64::max);
    let mut broken = check(map, &robot, &path).map_err(|error| explain(args, error))?;
    broken.iter_mut().for_each(|part| part.at = loaded.origin.point_to_map(part.at));
    let path: Vec<Point> = path.into_iter().map(|p| loaded.origin.point_to_map(p)).collect();
    log_result(&broken, &path);
    let summary = Summary {
        recheck: file,
        submaps_damaged: loaded.damaged,
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

fn check(map: &AtlasQuery<'_>, robot: &Robot, path: &[Point]) -> Result<Vec<BlockedSegment>, PlanError> {
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
        Some(_) => Ok(recheck(&GroundSpace::new(map, robot, path.first().copied().unwrap_or_default(), bounds)?, map, path)),
        None => Ok(recheck(&FlyingSpace::new(map, robot, bounds), map, path)),
    }
}

fn log_result(broken: &[BlockedSegment], path: &[Point]) {
    if broken.is_empty() {
        tracing::info!("the path is free: {} waypoints, {:.2} m", path.len(), length(path));
    }
    for part in broken {
        let [x, y, z] = part.at;
        let state = match part.state {
            State::Free => "free, but an obstacle is nearer than the radius",
            State::Occupied => "occupied",
            State::Unknown => "unknown",
        };
        tracing::warn!(
            "blocked between waypoints {} and {}, after {:.2} m, at {x:.2},{y:.2},{z:.2}: {state}",
            part.segment,
            part.segment + 1,
            part.free
        );
    }
}
