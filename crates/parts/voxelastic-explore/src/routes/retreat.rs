//! The way back along the robot's own track, for a robot that stands where the map has no way: it has come from there.

use crate::near_returns::NearReturns;
use std::collections::HashMap;
use voxelastic::query::{AtlasQuery, Capsule, UnknownAs};
use voxelastic_plan::{Point, between, distance, length};

/// Places of the track in one cell of this size are one place, metres.
const CELL: f64 = 0.5;
/// Share of the body's radius that must be free of obstacles in the map, whose voxels reach into where it fitted.
const SLIM: f64 = 0.8;
/// A robot that can follow its track this far gets on, metres.
const ENOUGH: f64 = 1.5;
/// Drift is looked for up to this distance ...
const MOST_SHIFT: f64 = 0.75;
/// ... in these steps, metres.
const SHIFT_STEP: f64 = 0.15;

/// The cell that a place of the track is in.
pub(crate) fn cell(p: Point) -> [i32; 3] {
    p.map(|c| (c / CELL).floor() as i32)
}

/// From the robot back to the first of the places where it was, in order, without the loops between.
pub(crate) fn track(places: &[Point], robot: Point) -> Vec<Point> {
    let mut earliest: HashMap<[i32; 3], usize> = HashMap::new();
    for (k, p) in places.iter().enumerate() {
        earliest.entry(cell(*p)).or_insert(k);
    }
    let mut path = vec![robot];
    let mut at = places.len();
    while at > 0 {
        at -= 1;
        // The earliest visit to where this is.
        at = earliest[&cell(places[at])];
        if path.last().is_some_and(|last| distance(*last, places[at]) > 1e-3) {
            path.push(places[at]);
        }
    }
    path
}

/// How many waypoints of its track the body of a robot reaches: it has been there, so only what the last scans see there now is in its way, and the floor and the ceiling
/// that they see around it. Without a scan, what the map says to be occupied.
pub(crate) fn free_part(map: &AtlasQuery<'_>, returns: &NearReturns, path: &[Point], body: f64) -> usize {
    let is_free = |segment: &[Point]| {
        if returns.is_empty() {
            let slim = Capsule { from: segment[0], to: segment[1], radius: SLIM * body };
            map.is_free(&slim.into(), UnknownAs::Free)
        } else {
            returns.keep_height(segment[0], segment[1], body) && returns.are_clear_of(segment[0], segment[1], body)
        }
    };
    path.windows(2).take_while(|segment| is_free(segment)).count() + 1
}

/// The track as far as a robot can follow it where it is: where drift has moved the map since it came, what the last scans see may stand in the way of the track, which
/// then lies beside it. The least shift is taken with which the robot gets on, with its margin (`clearances[0]`, metres) or else without.
pub(crate) fn passable(map: &AtlasQuery<'_>, returns: &NearReturns, track: &[Point], clearances: [f64; 2]) -> Vec<Point> {
    let follow = |shift: Point, clearance: f64| {
        let moved = |p: &Point| -> Point { std::array::from_fn(|k| p[k] + shift[k]) };
        let mut path: Vec<Point> = track[..1].iter().copied().chain(track[1..].iter().map(moved)).collect();
        path.truncate(free_part(map, returns, &path, clearance));
        path
    };
    let gets_on = |path: &Vec<Point>| length(path) >= ENOUGH || path.len() == track.len();
    // Without returns the map alone decides, which has the track where it is.
    let most = if returns.is_empty() { 1 } else { usize::MAX };
    let found = clearances.into_iter().find_map(|clearance| shifts().take(most).map(|shift| follow(shift, clearance)).find(&gets_on));
    found.unwrap_or_else(|| follow([0.0; 3], clearances[1]))
}

/// Displacements up to [`MOST_SHIFT`], the shortest first.
fn shifts() -> impl Iterator<Item = Point> {
    let reach = (MOST_SHIFT / SHIFT_STEP) as i32;
    let axis = move || -reach..=reach;
    let all = axis().flat_map(move |x| axis().flat_map(move |y| axis().map(move |z| [x, y, z])));
    let squared = |shift: &[i32; 3]| shift.iter().map(|c| c * c).sum::<i32>();
    let mut all: Vec<[i32; 3]> = all.filter(|shift| squared(shift) <= reach * reach).collect();
    all.sort_by_key(squared);
    all.into_iter().map(|shift| shift.map(|c| SHIFT_STEP * f64::from(c)))
}

/// Ends a path after `metres`.
pub(crate) fn cut(path: &mut Vec<Point>, metres: f64) {
    let mut left = metres;
    for k in 1..path.len() {
        let step = distance(path[k - 1], path[k]);
        if step >= left {
            path[k] = between(path[k - 1], path[k], left / step);
            path.truncate(k + 1);
            return;
        }
        left -= step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::event::{Event, Scan};
    use voxelastic::mapper::Mapper;
    use voxelastic::settings::{FieldKind, Settings};
    use voxelastic::{Cloud, Pose};

    #[test]
    fn the_track_leads_back_without_its_loops() {
        let mut mapper = Mapper::new(Settings { voxel_size: 0.2, field: FieldKind::Occupancy, ..Settings::default() }).unwrap();
        let wall = Cloud::from_points((0..400).map(|k| [10.0, f64::from(k % 20) as f32 - 10.0, (k / 20) as f32 * 0.2]).collect());
        // A loop of 12 m, and on.
        let places = [[0.2, 0.2], [3.2, 0.2], [3.2, 3.2], [0.2, 3.2], [0.3, 0.3], [0.3, -3.2]];
        for (node, [x, y]) in (0..).zip(places) {
            mapper.handle(Event::Scan(Scan { node, time: node as f64, t_map_lidar: Pose::translation(x, y, 1.0), cloud: wall.clone() })).unwrap();
        }
        let places = places.map(|[x, y]| [x, y, 1.0]);
        let back = track(&places, [0.3, -4.0, 1.0]);
        assert_eq!(back, [[0.3, -4.0, 1.0], [0.3, -3.2, 1.0], [0.2, 0.2, 1.0]]);
        assert_eq!(track(&places[5..], [0.3, -4.0, 1.0]), [[0.3, -4.0, 1.0], [0.3, -3.2, 1.0]]);
        let mut short = back.clone();
        cut(&mut short, 2.0);
        assert!(short.len() == 3 && (distance(short[1], short[2]) - 1.2).abs() < 1e-9);
        let map = mapper.atlas().query().unwrap();
        assert_eq!(free_part(&map, &NearReturns::default(), &back, 0.25), 3);
        // A post stands on the track as it is seen now, and the robot passes beside it.
        let post = Cloud::from_points((0..40).map(|k| [0.0, 0.5, k as f32 * 0.05 - 1.0]).collect());
        let post = NearReturns::new(&Pose::translation(0.3, -4.0, 1.0), &post);
        let straight = [[0.3, -4.0, 1.0], [0.3, -3.2, 1.0], [0.3, -1.0, 1.0]];
        assert_eq!(free_part(&map, &post, &straight, 0.25), 1);
        let beside = passable(&map, &post, &straight, [0.35, 0.25]);
        assert!(beside.len() == 3 && beside[0] == straight[0] && free_part(&map, &post, &beside, 0.35) == 3, "{beside:?}");
        let shifts = [1, 2].map(|k| distance(beside[k], straight[k]));
        assert!((shifts[0] - shifts[1]).abs() < 1e-9 && shifts[0] > 0.3 && shifts[0] <= MOST_SHIFT, "{shifts:?}");
        assert_eq!(passable(&map, &NearReturns::default(), &straight, [0.35, 0.25]), straight);
        // A floor that it does not see below itself: it may not sink to where drift has its track now.
        let floor = Cloud::from_points((0..40).map(|k| [3.0, k as f32 * 0.1 - 2.0, -0.6]).collect());
        let floor = NearReturns::new(&Pose::translation(0.3, -4.0, 1.0), &floor);
        let lower = straight.map(|[x, y, z]| [x, y, z - 0.5]);
        let sinking = [straight[0], lower[1], lower[2]];
        assert_eq!([free_part(&map, &floor, &straight, 0.25), free_part(&map, &floor, &sinking, 0.25)], [3, 1]);
        // A wall across the whole way is none that it could pass.
        let wall = Cloud::from_points((0..1600).map(|k| [(k % 40) as f32 * 0.1 - 2.0, 0.5, (k / 40) as f32 * 0.1 - 2.0]).collect());
        let wall = NearReturns::new(&Pose::translation(0.3, -4.0, 1.0), &wall);
        assert_eq!(passable(&map, &wall, &straight, [0.35, 0.25]).len(), 1);
        let into_wall = [[9.0, -5.0, 1.0], [9.5, -5.0, 1.0], [11.0, -5.0, 1.0]];
        assert_eq!(free_part(&map, &NearReturns::default(), &into_wall, 0.25), 2);
        let pebble = NearReturns::new(&Pose::translation(0.3, -3.7, 1.0), &Cloud::from_points(vec![[0.0, 0.2, 0.24]]));
        assert_eq!(
            [free_part(&map, &pebble, &back, 0.25), free_part(&map, &pebble, &back, 0.2), free_part(&map, &pebble, &into_wall, 0.25)],
            [1, 3, 3]
        );
    }
}
