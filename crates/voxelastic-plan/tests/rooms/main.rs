//! Planning in a map of a world that is known exactly.

mod world;

use std::time::Duration;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::query::{AtlasQuery, Sphere, UnknownAs};
use voxelastic_plan::{
    Air, End, Ground, Obstacle, Plan, PlanError, Point, Request, Robot, Snapshot, Space, Wheels, anchor, between, distance, length, place, plan,
    recheck, sharpest_turn,
};
use world::{EAST, VOXEL, WEST, mapper, rooms, scans};

const RADIUS: f64 = 0.3;

fn request(start: Point, goal: Point, robot: Robot) -> Request {
    // Enough time on a busy machine; the samples end it.
    Request { time: Duration::from_secs(60), samples: Some(800), ..Request::new(start, goal, robot) }
}

/// The shortest way for a ball of this radius through the doorway: from end to end around the corners of the wall.
fn shortest(radius: f64) -> f64 {
    let y = 1.0 + radius;
    let flat = (WEST[0] - 0.0).hypot(WEST[1] - y) + 0.15 + (EAST[0] - 0.15).hypot(EAST[1] - y);
    flat.hypot(EAST[2] - WEST[2])
}

fn check(plan: &Plan, radius: f64) {
    assert!((length(&plan.path) - plan.length).abs() < 1e-9);
    assert_eq!(plan.clearance.len(), plan.path.len());
    assert!(plan.least_clearance >= radius - 1e-6, "{}", plan.least_clearance);
    assert!(plan.first.length >= plan.length - 1e-9);
    for w in plan.path.windows(2) {
        for i in 0..=20 {
            let p = between(w[0], w[1], f64::from(i) / 20.0);
            let true_distance = rooms().world.distance(p);
            assert!(true_distance >= radius - f64::from(VOXEL), "{p:?} is {true_distance} from the world");
        }
    }
    assert_eq!(plan.tree[0].1, None);
    assert!(plan.tree.iter().skip(1).all(|(_, parent)| parent.is_some_and(|p| (p as usize) < plan.tree.len())));
}

#[test]
fn the_way_to_the_next_room_leads_through_the_doorway_and_is_short() {
    let map = rooms().query();
    let asked = request(WEST, EAST, Robot::flying(RADIUS));
    let found = plan(&map, &asked).unwrap();
    check(&found, RADIUS);
    assert_eq!((found.path[0], found.path[found.path.len() - 1]), (WEST, EAST));
    // The map's walls are up to a voxel thicker on either side.
    let (least, most) = (shortest(RADIUS - f64::from(VOXEL)), 1.03 * shortest(RADIUS + 2.0 * f64::from(VOXEL)));
    assert!(found.length > least && found.length < most, "{} is not within {least} to {most}", found.length);
    assert!(sharpest_turn(&found.path) < 60.0, "{}", sharpest_turn(&found.path));
    let again = plan(&map, &asked).unwrap();
    assert_eq!((&again.path, again.samples), (&found.path, found.samples), "a limit of samples makes results repeatable");
}

#[test]
fn wheels_stay_at_their_height_over_the_floor() {
    let map = rooms().query();
    let height = 1.0;
    let robot = Robot { ground: Some(Wheels { height: Some(height), step: None }), ..Robot::flying(RADIUS) };
    let (west, east) = ([-3.0, 0.5, 1.1], [3.0, 0.5, 1.6]);
    let asked = Request { samples: Some(4000), ..request(west, east, robot) };
    let found = plan(&map, &asked).unwrap();
    check(&found, RADIUS);
    assert_eq!(found.height, Some(height));
    assert!(found.path.iter().all(|p| (p[2] - height).abs() < 2.5 * f64::from(VOXEL)), "{:?}", found.path);
    // What was just planned holds, piece by piece, and in a map without a floor nothing does.
    let bounds = [[-20.0; 3], [20.0; 3]];
    let ground = Ground::new(&map, &robot, west, bounds).unwrap();
    assert_eq!(recheck(&ground, &map, &found.path), []);
    let nothing = Atlas::default();
    let nowhere = AtlasQuery::new(&nothing, VOXEL);
    let void = Ground::new(&nowhere, &robot, west, bounds).unwrap();
    assert_eq!(recheck(&void, &nowhere, &found.path).len(), found.path.len() - 1);
    let low = Robot { ground: Some(Wheels { height: Some(0.2), step: None }), ..robot };
    assert!(matches!(plan(&map, &request(west, east, low)), Err(PlanError::Setting { .. })));
    // Without a height of its own the robot keeps that of its start.
    let same = plan(&map, &request(west, east, Robot::wheeled(RADIUS))).unwrap();
    assert!((same.height.unwrap() - west[2]).abs() < 2.5 * f64::from(VOXEL));
}

#[test]
fn ends_where_the_robot_does_not_fit_are_told_with_the_nearest_place_where_it_does() {
    let map = rooms().query();
    let robot = Robot::flying(RADIUS);
    let blocked = |start: Point| match plan(&map, &request(start, EAST, robot)) {
        Err(PlanError::Blocked { end: End::Start, place, obstacle, nearest }) => {
            assert_eq!(place, start);
            (obstacle, nearest.unwrap())
        }
        other => panic!("{other:?}"),
    };
    let (obstacle, nearest) = blocked([-2.0, -2.98, 1.0]);
    assert!(matches!(obstacle, Obstacle::Occupied | Obstacle::Unknown | Obstacle::Near(_)), "{obstacle:?}");
    assert!(
        distance(nearest, [-2.0, -2.98, 1.0]) < RADIUS + 0.4 && map.is_free(&Sphere { centre: nearest, radius: RADIUS }.into(), UnknownAs::Blocked)
    );
    let (obstacle, nearest) = blocked([-2.0, -2.85, 1.0]);
    assert!(matches!(obstacle, Obstacle::Near(d) if d < RADIUS), "{obstacle:?}");
    check(&plan(&map, &request(nearest, EAST, robot)).unwrap(), RADIUS);
    let wide = PlanError::Blocked { end: End::Start, place: WEST, obstacle: Obstacle::Near(0.3), nearest: Some(EAST) };
    assert!(wide.to_string().contains("start (-4.50, -2.00, 1.00) is only 0.30 m from the nearest obstacle"), "{wide}");
    let outside = plan(&map, &request(WEST, [99.0, 0.0, 1.0], robot)).unwrap_err();
    assert!(matches!(outside, PlanError::OutsideMap { end: End::Goal, .. }), "{outside:?}");
    let inside_bounds = Request { bounds: Some([[-6.0, -3.0, 0.0], [0.0, 3.0, 3.0]]), ..request(WEST, EAST, robot) };
    let out = plan(&map, &inside_bounds).unwrap_err();
    assert!(matches!(out, PlanError::Blocked { end: End::Goal, obstacle: Obstacle::OutOfBounds, .. }), "{out:?}");
}

#[test]
fn robots_of_any_size_get_an_answer() {
    let map = rooms().query();
    check(&plan(&map, &request(WEST, EAST, Robot::flying(0.0))).unwrap(), 0.0);
    // Too wide for the doorway, not for the rooms.
    let wide = Request { samples: Some(300), ..request([-3.0, 0.0, 1.4], [3.0, 0.0, 1.4], Robot::flying(0.55)) };
    match plan(&map, &wide) {
        Err(PlanError::NotFound { samples, reach, .. }) => assert!(samples >= 300 && reach[0] > 1.0 && reach[1] > 1.0, "{reach:?}"),
        other => panic!("{other:?}"),
    }
    let begun = std::time::Instant::now();
    let brief = Request { time: Duration::from_millis(200), samples: None, ..wide };
    assert!(matches!(plan(&map, &brief), Err(PlanError::NotFound { .. })));
    assert!(begun.elapsed() < Duration::from_secs(5));
    // Bounds without end leave nothing to draw from and no lattice, and are no reason to panic.
    for bounds in [[[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]], [[-1e300; 3], [1e300; 3]]] {
        let endless = Request { bounds: Some(bounds), samples: Some(50), ..request(WEST, EAST, Robot::flying(RADIUS)) };
        assert!(matches!(plan(&map, &endless), Ok(_) | Err(PlanError::NotFound { .. })));
    }
    for radius in [f64::NAN, -1.0, f64::INFINITY] {
        assert!(matches!(plan(&map, &request(WEST, EAST, Robot::flying(radius))), Err(PlanError::Setting { .. })));
    }
    assert!(matches!(plan(&map, &request([f64::NAN; 3], EAST, Robot::flying(0.3))), Err(PlanError::Setting { .. })));
    let nothing = Atlas::default();
    assert_eq!(plan(&AtlasQuery::new(&nothing, VOXEL), &request(WEST, EAST, Robot::flying(0.3))), Err(PlanError::NoOccupancy));
}

#[test]
fn waypoints_move_with_their_submaps_and_rechecks_say_what_broke() {
    let found = plan(&rooms().query(), &request(WEST, EAST, Robot::flying(RADIUS))).unwrap();
    let anchors = anchor(&rooms().atlas, &found.path);
    assert!(rooms().atlas.submaps().len() > 1, "one submap is no test");
    // Everything moves: the path goes along and holds.
    let mut moved = Snapshot::of(&rooms().atlas, VOXEL);
    let shift = Pose::from_parts([0.7, 0.4, 0.1].into(), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.2));
    let mut atlas = moved.atlas().clone();
    atlas.submaps_mut().iter_mut().for_each(|s| s.t_map_submap = shift * s.t_map_submap);
    moved = Snapshot::of(&atlas, VOXEL);
    let query = moved.query();
    let air = |radius| Air::new(&query, &Robot::flying(radius), [[-20.0; 3], [20.0; 3]]);
    let now: Vec<Point> = place(moved.atlas(), &anchors).into_iter().map(Option::unwrap).collect();
    for (before, after) in found.path.iter().zip(&now) {
        let expected: Point = (shift * nalgebra::Point3::from(*before)).coords.into();
        assert!(distance(expected, *after) < 1e-9);
    }
    // Cubes of shared space are those of the map frame, so a voxel's worth of room can be lost.
    assert_eq!(recheck(&air(RADIUS - 2.0 * f64::from(VOXEL)), &query, &now), []);
    // The path as it was does not: it runs into the wall beside the doorway, where it says.
    let broken = recheck(&air(RADIUS), &query, &found.path);
    assert!(!broken.is_empty());
    for part in &broken {
        let (from, to) = (found.path[part.piece], found.path[part.piece + 1]);
        assert!((distance(from, part.at) - part.free).abs() < 1e-6 && part.free <= distance(from, to));
        let (ahead, all) = (part.free + 1.1 * f64::from(VOXEL), distance(from, to));
        assert!(air(RADIUS).reach(from, between(from, to, (ahead / all).min(1.0))).is_none());
    }
    // A scan that is gone takes its waypoints with it.
    assert_eq!(place(&Atlas::default(), &anchors), vec![None; anchors.len()]);
}

#[test]
fn a_snapshot_answers_as_the_map_did() {
    let snapshot = Snapshot::of(&rooms().atlas, VOXEL);
    let elsewhere = std::thread::spawn(move || plan(&snapshot.query(), &request(WEST, EAST, Robot::flying(RADIUS))).unwrap().path);
    let here = plan(&rooms().query(), &request(WEST, EAST, Robot::flying(RADIUS))).unwrap().path;
    assert_eq!(elsewhere.join().unwrap(), here);
}

#[test]
fn planning_goes_on_in_what_was_known_while_mapping_goes_on() {
    let mut mapper = mapper();
    let mut events = scans(&rooms().world);
    // The doorway has been passed, the rest of the east room has not been seen from within.
    events.by_ref().take(18).for_each(|event| _ = mapper.handle(event).unwrap());
    let (west, east) = ([-4.5, -1.5, 1.0], [1.2, 0.5, 1.3]);
    let snapshot = Snapshot::of(mapper.atlas(), VOXEL);
    let same = snapshot.clone();
    let planner = std::thread::spawn(move || {
        let found = plan(&snapshot.query(), &request(west, east, Robot::flying(RADIUS))).unwrap();
        (anchor(snapshot.atlas(), &found.path), found)
    });
    let before = mapper.atlas().scan_count();
    events.for_each(|event| _ = mapper.handle(event).unwrap());
    assert!(mapper.atlas().scan_count() > before);
    let (anchors, found) = planner.join().unwrap();
    check(&found, RADIUS);
    let again = plan(&same.query(), &request(west, east, Robot::flying(RADIUS))).unwrap();
    assert_eq!((found.path.as_slice(), found.samples), (again.path.as_slice(), again.samples), "the map changed under the planner");
    // Every waypoint is found again in the map that has grown meanwhile.
    let now: Vec<Point> = place(mapper.atlas(), &anchors).into_iter().map(Option::unwrap).collect();
    assert!(now.iter().zip(&found.path).all(|(a, b)| distance(*a, *b) < 1e-9));
}
