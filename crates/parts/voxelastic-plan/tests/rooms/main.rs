//! Planning in the map of a simulated world whose distances are exact.

mod world;

use std::time::Duration;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::query::{Sphere, UnknownAs};
use voxelastic_plan::{
    Endpoint, FlyingSpace, GroundSpace, Obstacle, Plan, PlanError, Point, Request, Robot, Snapshot, Space, Wheels, anchor_path, between, distance,
    length, plan, recheck, resolve_anchors, sharpest_turn,
};
use world::{EAST, VOXEL, WEST, mapper, rooms, scans};

const RADIUS: f64 = 0.3;

fn request(start: Point, goal: Point, robot: Robot) -> Request {
    // Enough time on a busy machine; the samples end it.
    Request { time: Duration::from_secs(60), samples: Some(800), ..Request::new(start, goal, robot) }
}

/// Length of the shortest path of a ball through the doorway, around the corners of the wall.
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
fn path_to_the_next_room_is_short_and_leads_through_the_doorway() {
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
fn wheeled_robot_keeps_its_height_above_the_floor() {
    let map = rooms().query();
    let height = 1.0;
    let robot = Robot { ground: Some(Wheels { height: Some(height), step: None }), ..Robot::flying(RADIUS) };
    let (west, east) = ([-3.0, 0.5, 1.1], [3.0, 0.5, 1.6]);
    let asked = Request { samples: Some(4000), ..request(west, east, robot) };
    let found = plan(&map, &asked).unwrap();
    check(&found, RADIUS);
    assert_eq!(found.height, Some(height));
    assert!(found.path.iter().all(|p| (p[2] - height).abs() < 2.5 * f64::from(VOXEL)), "{:?}", found.path);
    // The new path is free on recheck; in a map without a floor none of its segments is.
    let bounds = [[-20.0; 3], [20.0; 3]];
    let ground = GroundSpace::new(&map, &robot, west, bounds).unwrap();
    assert_eq!(recheck(&ground, &map, &found.path), []);
    let nothing = Atlas::new(VOXEL);
    let nowhere = nothing.query().unwrap();
    let void = GroundSpace::new(&nowhere, &robot, west, bounds).unwrap();
    assert_eq!(recheck(&void, &nowhere, &found.path).len(), found.path.len() - 1);
    let low = Robot { ground: Some(Wheels { height: Some(0.2), step: None }), ..robot };
    assert!(matches!(plan(&map, &request(west, east, low)), Err(PlanError::Setting { .. })));
    // Without a height in the request the robot keeps that of its start.
    let same = plan(&map, &request(west, east, Robot::wheeled(RADIUS))).unwrap();
    assert!((same.height.unwrap() - west[2]).abs() < 2.5 * f64::from(VOXEL));
}

#[test]
fn blocked_endpoints_are_reported_with_the_nearest_free_position() {
    let map = rooms().query();
    let robot = Robot::flying(RADIUS);
    let blocked = |start: Point| match plan(&map, &request(start, EAST, robot)) {
        Err(PlanError::Blocked { endpoint: Endpoint::Start, position, obstacle, nearest }) => {
            assert_eq!(position, start);
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
    let wide = PlanError::Blocked { endpoint: Endpoint::Start, position: WEST, obstacle: Obstacle::Near(0.3), nearest: Some(EAST) };
    assert!(wide.to_string().contains("start (-4.50, -2.00, 1.00) is only 0.30 m from the nearest obstacle"), "{wide}");
    let outside = plan(&map, &request(WEST, [99.0, 0.0, 1.0], robot)).unwrap_err();
    assert!(matches!(outside, PlanError::OutsideMap { endpoint: Endpoint::Goal, .. }), "{outside:?}");
    let inside_bounds = Request { bounds: Some([[-6.0, -3.0, 0.0], [0.0, 3.0, 3.0]]), ..request(WEST, EAST, robot) };
    let out = plan(&map, &inside_bounds).unwrap_err();
    assert!(matches!(out, PlanError::Blocked { endpoint: Endpoint::Goal, obstacle: Obstacle::OutOfBounds, .. }), "{out:?}");
}

#[test]
fn extreme_robots_and_requests_get_a_path_or_an_error() {
    let map = rooms().query();
    check(&plan(&map, &request(WEST, EAST, Robot::flying(0.0))).unwrap(), 0.0);
    // Too wide for the doorway, not for the rooms.
    let wide = Request { samples: Some(300), ..request([-3.0, 0.0, 1.4], [3.0, 0.0, 1.4], Robot::flying(0.55)) };
    match plan(&map, &wide) {
        Err(PlanError::NotFound { samples, reach, .. }) => assert!(samples >= 300 && reach[0] > 1.0 && reach[1] > 1.0, "{reach:?}"),
        other => panic!("{other:?}"),
    }
    // A limit of time alone ends the search, too; how precisely is what `examples/score` measures (`seconds`).
    let brief = Request { time: Duration::from_millis(200), samples: None, ..wide };
    assert!(matches!(plan(&map, &brief), Err(PlanError::NotFound { .. })));
    // Infinite bounds give no lattice and no useful samples, but no panic.
    for bounds in [[[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]], [[-1e300; 3], [1e300; 3]]] {
        let infinite = Request { bounds: Some(bounds), samples: Some(50), ..request(WEST, EAST, Robot::flying(RADIUS)) };
        assert!(matches!(plan(&map, &infinite), Ok(_) | Err(PlanError::NotFound { .. })));
    }
    for radius in [f64::NAN, -1.0, f64::INFINITY] {
        assert!(matches!(plan(&map, &request(WEST, EAST, Robot::flying(radius))), Err(PlanError::Setting { .. })));
    }
    assert!(matches!(plan(&map, &request([f64::NAN; 3], EAST, Robot::flying(0.3))), Err(PlanError::Setting { .. })));
    let nothing = Atlas::new(VOXEL);
    assert_eq!(plan(&nothing.query().unwrap(), &request(WEST, EAST, Robot::flying(0.3))), Err(PlanError::NoOccupancy));
}

#[test]
fn anchored_waypoints_follow_their_submaps_and_recheck_finds_blocked_segments() {
    let found = plan(&rooms().query(), &request(WEST, EAST, Robot::flying(RADIUS))).unwrap();
    let anchors = anchor_path(&rooms().atlas, &found.path);
    assert!(rooms().atlas.submaps().len() > 1, "one submap is no test");
    // All submaps move: the anchored path moves along and stays free.
    let mut moved = Snapshot::of(&rooms().atlas);
    let shift = Pose::from_parts([0.7, 0.4, 0.1].into(), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.2));
    let mut atlas = moved.atlas().clone();
    atlas.submaps_mut().iter_mut().for_each(|s| s.set_pose(shift * s.t_map_submap()));
    moved = Snapshot::of(&atlas);
    let query = moved.query();
    let air = |radius| FlyingSpace::new(&query, &Robot::flying(radius), [[-20.0; 3], [20.0; 3]]);
    let now: Vec<Point> = resolve_anchors(moved.atlas(), &anchors).into_iter().map(Option::unwrap).collect();
    for (before, after) in found.path.iter().zip(&now) {
        let expected: Point = (shift * nalgebra::Point3::from(*before)).coords.into();
        assert!(distance(expected, *after) < 1e-9);
    }
    // Overlapping submaps are compared on a grid of the map frame, which can cost a voxel of clearance.
    assert_eq!(recheck(&air(RADIUS - 2.0 * f64::from(VOXEL)), &query, &now), []);
    // The path at its old position runs into the wall next to the doorway.
    let blocked = recheck(&air(RADIUS), &query, &found.path);
    assert!(!blocked.is_empty());
    for part in &blocked {
        let (from, to) = (found.path[part.segment], found.path[part.segment + 1]);
        assert!((distance(from, part.at) - part.free).abs() < 1e-6 && part.free <= distance(from, to));
        let (ahead, all) = (part.free + 1.1 * f64::from(VOXEL), distance(from, to));
        assert!(air(RADIUS).steer(from, between(from, to, (ahead / all).min(1.0))).is_none());
    }
    // Without its scan a waypoint has no position.
    assert_eq!(resolve_anchors(&Atlas::new(VOXEL), &anchors), vec![None; anchors.len()]);
}

#[test]
fn snapshot_gives_the_same_path_as_the_map() {
    let snapshot = Snapshot::of(&rooms().atlas);
    let elsewhere = std::thread::spawn(move || plan(&snapshot.query(), &request(WEST, EAST, Robot::flying(RADIUS))).unwrap().path);
    let here = plan(&rooms().query(), &request(WEST, EAST, Robot::flying(RADIUS))).unwrap().path;
    assert_eq!(elsewhere.join().unwrap(), here);
}

#[test]
fn planning_in_a_snapshot_is_independent_of_ongoing_mapping() {
    let mut mapper = mapper();
    let mut events = scans(&rooms().world);
    // The sensor has passed the doorway but has not been in the rest of the east room.
    events.by_ref().take(18).for_each(|event| _ = mapper.handle(event).unwrap());
    let (west, east) = ([-4.5, -1.5, 1.0], [1.2, 0.5, 1.3]);
    let snapshot = Snapshot::of(mapper.atlas());
    let same = snapshot.clone();
    let planner = std::thread::spawn(move || {
        let found = plan(&snapshot.query(), &request(west, east, Robot::flying(RADIUS))).unwrap();
        (anchor_path(snapshot.atlas(), &found.path), found)
    });
    let before = mapper.atlas().scan_count();
    events.for_each(|event| _ = mapper.handle(event).unwrap());
    assert!(mapper.atlas().scan_count() > before);
    let (anchors, found) = planner.join().unwrap();
    check(&found, RADIUS);
    let again = plan(&same.query(), &request(west, east, Robot::flying(RADIUS))).unwrap();
    assert_eq!((found.path.as_slice(), found.samples), (again.path.as_slice(), again.samples), "the map changed under the planner");
    // Every anchor resolves in the larger map.
    let now: Vec<Point> = resolve_anchors(mapper.atlas(), &anchors).into_iter().map(Option::unwrap).collect();
    assert!(now.iter().zip(&found.path).all(|(a, b)| distance(*a, *b) < 1e-9));
}
