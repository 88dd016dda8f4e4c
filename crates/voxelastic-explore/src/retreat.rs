//! The way back along the robot's own track, for a robot that stands where the map has no way: it has come from there.

use crate::near_returns::NearReturns;
use std::collections::HashMap;
use voxelastic::atlas::Atlas;
use voxelastic::event::NodeId;
use voxelastic::query::{AtlasQuery, Capsule, UnknownAs};
use voxelastic_plan::{Point, between, distance};

/// Places of the track in one cell of this size are one place, metres.
const CELL: f64 = 0.5;
/// Share of the body's radius that must be free of obstacles in the map, whose voxels reach into where it fitted.
const SLIM: f64 = 0.8;

/// The newest scan of a map.
pub(crate) fn newest(atlas: &Atlas) -> Option<NodeId> {
    atlas.submaps().iter().flat_map(|submap| submap.scans()).map(|scan| scan.node).max()
}

/// From the robot back to where it was when scan `first` came, without the loops between.
pub(crate) fn track(atlas: &Atlas, robot: Point, first: NodeId) -> Vec<Point> {
    let place = |t: voxelastic::Pose| Point::from(t.translation.vector);
    let scans =
        atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(|scan| (scan.node, place(submap.t_map_submap() * scan.t_submap_lidar))));
    let mut places: Vec<(NodeId, Point)> = scans.filter(|(node, _)| *node >= first).collect();
    places.sort_by_key(|(node, _)| *node);
    let cell = |p: &Point| p.map(|c| (c / CELL).floor() as i64);
    let mut earliest: HashMap<[i64; 3], usize> = HashMap::new();
    for (k, (_, p)) in places.iter().enumerate() {
        earliest.entry(cell(p)).or_insert(k);
    }
    let mut path = vec![robot];
    let mut at = places.len();
    while at > 0 {
        at -= 1;
        // The earliest visit to where this is.
        at = earliest[&cell(&places[at].1)];
        if path.last().is_some_and(|last| distance(*last, places[at].1) > 1e-3) {
            path.push(places[at].1);
        }
    }
    path
}

/// How many waypoints of its track the body of a robot reaches: it has been there, so only what the last scan sees there now is in its way. Without a scan, what the map
/// says to be occupied.
pub(crate) fn free_part(map: &AtlasQuery<'_>, returns: &NearReturns, path: &[Point], body: f64) -> usize {
    let is_free = |segment: &[Point]| {
        if returns.is_empty() {
            let slim = Capsule { from: segment[0], to: segment[1], radius: SLIM * body };
            map.is_free(&slim.into(), UnknownAs::Free)
        } else {
            returns.are_clear_of(segment[0], segment[1], body)
        }
    };
    path.windows(2).take_while(|segment| is_free(segment)).count() + 1
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
    use voxelastic::Cloud;
    use voxelastic::event::{Event, Scan};
    use voxelastic::mapper::Mapper;
    use voxelastic::settings::{FieldKind, Settings};

    #[test]
    fn the_track_leads_back_without_its_loops() {
        let mut mapper = Mapper::new(Settings { voxel_size: 0.2, field: FieldKind::Occupancy, ..Settings::default() }).unwrap();
        let wall = Cloud::from_points((0..400).map(|k| [10.0, f64::from(k % 20) as f32 - 10.0, (k / 20) as f32 * 0.2]).collect());
        // A loop of 12 m, and on.
        let places = [[0.2, 0.2], [3.2, 0.2], [3.2, 3.2], [0.2, 3.2], [0.3, 0.3], [0.3, -3.2]];
        for (node, [x, y]) in (0..).zip(places) {
            mapper
                .handle(Event::Scan(Scan { node, time: node as f64, t_map_lidar: voxelastic::Pose::translation(x, y, 1.0), cloud: wall.clone() }))
                .unwrap();
        }
        let back = track(mapper.atlas(), [0.3, -4.0, 1.0], 0);
        assert_eq!(back, [[0.3, -4.0, 1.0], [0.3, -3.2, 1.0], [0.2, 0.2, 1.0]]);
        assert_eq!(track(mapper.atlas(), [0.3, -4.0, 1.0], 5), [[0.3, -4.0, 1.0], [0.3, -3.2, 1.0]]);
        let mut short = back.clone();
        cut(&mut short, 2.0);
        assert!(short.len() == 3 && (distance(short[1], short[2]) - 1.2).abs() < 1e-9);
        let map = mapper.atlas().query();
        assert_eq!(free_part(&map, &NearReturns::default(), &back, 0.25), 3);
        let into_wall = [[9.0, -5.0, 1.0], [9.5, -5.0, 1.0], [11.0, -5.0, 1.0]];
        assert_eq!(free_part(&map, &NearReturns::default(), &into_wall, 0.25), 2);
        let seen = NearReturns::new(&voxelastic::Pose::translation(0.3, -3.7, 1.0), &Cloud::from_points(vec![[0.0, 0.2, 0.24]]));
        assert_eq!([free_part(&map, &seen, &back, 0.25), free_part(&map, &seen, &back, 0.2), free_part(&map, &seen, &into_wall, 0.25)], [1, 3, 3]);
    }
}
