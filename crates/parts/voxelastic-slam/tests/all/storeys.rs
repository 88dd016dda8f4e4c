//! Buildings whose storeys have the same walls: no closure may join two of them, and no session of the one be added to a map of the other.

use std::collections::HashMap;
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic::sensor::preset_with_columns;
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{World, WorldBuilder};
use voxelastic_slam::join::{Attempt, Start, join};
use voxelastic_slam::loops::{Closure, LoopFinder, LoopSettings, MapSurface, PlaceBook, Verdict};
use voxelastic_slam::odometry::OdometrySettings;
use voxelastic_slam::slam::{RawScan, Slam};

/// Height of a storey, metres.
const STOREY: f64 = 3.0;
/// A closure is false beyond this distance from the truth, metres.
const FALSE: f64 = 0.5;

/// Two storeys around a stairwell, corridors of 2 m around a core of 14 x 8 m; `differing` of the pieces of furniture of the upper one are others than below.
fn building(seed: u64, differing: f64) -> World {
    let mut world = WorldBuilder::new("storeys", seed);
    let mut put = |a: [f64; 3], b: [f64; 3]| world.cuboid(a, b, 0.5);
    for z in [0.0, STOREY] {
        let (top, h) = (z + STOREY - 0.3, z);
        for (x, y, to_x, to_y) in [(-9.2, -6.2, -9.0, 6.2), (9.0, -6.2, 9.2, 6.2), (-9.2, -6.2, 9.2, -6.0), (-9.2, 6.0, 9.2, 6.2)] {
            put([x, y, h], [to_x, to_y, top]);
        }
        for (x, y, to_x, to_y) in
            [(-7.0, -4.0, 7.0, -3.8), (-7.0, 3.8, 7.0, 4.0), (-7.0, -4.0, -6.8, 4.0), (6.8, -4.0, 7.0, -1.2), (6.8, 1.2, 7.0, 4.0)]
        {
            put([x, y, h], [to_x, to_y, top]);
        }
        let mut common = Stream::new(seed, &[1]);
        let mut own = Stream::new(seed, &[2, z as u64]);
        for _ in 0..28 {
            let is_own = common.uniform() < differing;
            let mut of_both: [f64; 4] = std::array::from_fn(|_| common.uniform());
            let of_one: [f64; 4] = std::array::from_fn(|_| own.uniform());
            if is_own {
                of_both = of_one;
            }
            let [side, along, width, height] = of_both;
            let (half, deep, tall) = (0.2 + 0.3 * width, 0.2 + 0.15 * height, h + 0.6 + 1.6 * height);
            match (4.0 * side) as usize {
                0 => put([16.0 * along - 8.0 - half, -6.0, h], [16.0 * along - 8.0 + half, -6.0 + deep, tall]),
                1 => put([16.0 * along - 8.0 - half, 6.0 - deep, h], [16.0 * along - 8.0 + half, 6.0, tall]),
                2 => put([-9.0, 10.0 * along - 5.0 - half, h], [-9.0 + deep, 10.0 * along - 5.0 + half, tall]),
                _ => put([9.0 - deep, 10.0 * along - 5.0 - half, h], [9.0, 10.0 * along - 5.0 + half, tall]),
            }
        }
    }
    put([-9.0, -6.0, -0.3], [9.0, 6.0, 0.0]);
    put([-9.0, -6.0, 2.0 * STOREY - 0.3], [9.0, 6.0, 2.0 * STOREY]);
    for (x, y, to_x, to_y) in [(-9.0, -6.0, 9.0, -1.2), (-9.0, 1.2, 9.0, 6.0), (-9.0, -1.2, -6.8, 1.2), (5.0, -1.2, 9.0, 1.2)] {
        put([x, y, STOREY - 0.3], [to_x, to_y, STOREY]);
    }
    // Two flights of stairs, a landing, and the walls of the stairwell.
    for k in 0..10 {
        let (x, rise) = (0.3 * f64::from(k), 0.15 * f64::from(k + 1));
        put([4.7 - x, -1.2, 0.0], [5.0 - x, -0.05, rise]);
        put([2.0 + x, 0.05, 1.5], [2.3 + x, 1.2, 1.5 + rise]);
    }
    put([0.5, -1.2, 0.0], [2.0, 1.2, 1.5]);
    put([0.3, -3.8, 0.0], [0.5, 3.8, 2.0 * STOREY]);
    put([0.5, -1.4, 0.0], [6.8, -1.2, 2.0 * STOREY]);
    put([0.5, 1.2, 0.0], [6.8, 1.4, 2.0 * STOREY]);
    world.build().unwrap()
}

/// Around the lower storey, up the stairs, and around the upper one.
fn walk() -> Vec<Pose> {
    let ring = |z: f64| [[8.0, 0.0, z], [8.0, 5.0, z], [-8.0, 5.0, z], [-8.0, -5.0, z], [8.0, -5.0, z], [8.0, -0.6, z]];
    let h = 1.4;
    let stairs = [[5.2, -0.6, h], [2.0, -0.6, h + 1.5], [1.2, -0.6, h + 1.5], [1.2, 0.6, h + 1.5], [2.0, 0.6, h + 1.5], [5.0, 0.6, h + STOREY]];
    let points: Vec<[f64; 3]> = ring(h).into_iter().chain(stairs).chain(ring(h + STOREY)).collect();
    let mut poses = Vec::new();
    let mut heading: f64 = points[0][1];
    for pair in points.windows(2) {
        let way: [f64; 3] = std::array::from_fn(|k| pair[1][k] - pair[0][k]);
        let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
        let next = way[1].atan2(way[0]);
        let turn = (next - heading + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
        let turns = (turn.abs() / 0.17) as usize;
        let pose = |at: f64, yaw: f64| {
            let [x, y, z]: [f64; 3] = std::array::from_fn(|k| pair[0][k] + at * way[k]);
            Pose::translation(x, y, z) * Pose::rotation(nalgebra::Vector3::new(0.0, 0.0, yaw))
        };
        poses.extend((1..=turns).map(|k| pose(0.0, heading + turn * k as f64 / (turns + 1) as f64)));
        let steps = (length / 0.25).ceil().max(1.0);
        poses.extend((0..steps as usize).map(|k| pose(k as f64 / steps, next)));
        heading = next;
    }
    poses
}

/// The events of a walk: by true poses, or by the odometry.
fn events(world: &World, poses: &[Pose], seed: u64, by_odometry: bool) -> Vec<Event> {
    let lidar = Lidar::new(preset_with_columns("os0-64", 256).unwrap(), LidarSettings::default()).unwrap();
    let mut slam = Slam::new(OdometrySettings::default());
    let mut out = Vec::new();
    for (node, pose) in (0..).zip(poses) {
        let cloud = lidar.scan(world, |_| *pose, &Stream::new(seed, &[node]));
        let time = 0.2 * node as f64;
        if by_odometry {
            out.extend(slam.register(RawScan { node, time, cloud, imu: Vec::new() }, |_| true).events);
            continue;
        }
        out.push(Event::Scan(Scan { node, time, t_map_lidar: *pose, cloud }));
        if let Some(before) = (node as usize).checked_sub(1) {
            let t_from_to = poses[before].inv_mul(pose);
            out.push(Event::OdometryEdge(Edge { from: node - 1, to: node, t_from_to, information: None }));
        }
    }
    out
}

/// Closures that were accepted: right ones, and false ones.
fn accepted(events: &[Event], truth: &[Pose]) -> (Vec<Closure>, Vec<Closure>) {
    let mut finder = LoopFinder::new(LoopSettings::default());
    events.iter().for_each(|event| drop(finder.take(event)));
    finder.finish();
    let poses: HashMap<NodeId, &Pose> = (0..).zip(truth).collect();
    let is_right = |c: &Closure| {
        let right = poses[&c.from].inv_mul(poses[&c.to]);
        c.fit.is_some_and(|fit| fit.t_first_second.translation_distance(&right) < FALSE)
    };
    finder.closures().iter().filter(|c| c.verdict == Verdict::Accepted).partition(|c| is_right(c))
}

/// Walks through buildings: accepted closures that are right and false.
fn walked(seed: u64, differing: f64, by_odometry: bool) -> (usize, Vec<Closure>) {
    let (world, truth) = (building(seed, differing), walk());
    let (right, wrong) = accepted(&events(&world, &truth, seed, by_odometry), &truth);
    println!(
        "building {seed}, {:3.0} % of the furniture differs, odometry {by_odometry}: {} right, {} false",
        100.0 * differing,
        right.len(),
        wrong.len()
    );
    (right.len(), wrong)
}

#[test]
fn storeys_that_look_alike_are_not_folded_into_one() {
    for by_odometry in [false, true] {
        let (right, wrong) = walked(1, 1.0, by_odometry);
        assert!(right > 0 && wrong.is_empty(), "{wrong:?}");
    }
}

/// What becomes of a map of the upper storey that is added to one of the lower, in a frame that tells nothing.
fn joined(differing: f64) -> Attempt {
    let world = building(1, differing);
    let surface = world.sample_surface(600.0, 1);
    let single = |v: [f64; 3]| v.map(|c| c as f32);
    let (positions, normals): (Vec<_>, Vec<_>) = surface.iter().map(|s| (single(s.point), single(s.normal))).unzip();
    let surface = MapSurface { positions: &positions, normals: &normals, voxel: 0.065 };
    let walk = walk();
    let storey = |is_there: &dyn Fn(f64) -> bool, first: NodeId| -> Vec<(NodeId, Pose)> {
        (first..).zip(walk.iter().filter(|pose| is_there(pose.translation.z)).copied()).collect()
    };
    let (lower, upper) = (storey(&|z| z < 1.5, 0), storey(&|z| z > STOREY + 1.3, 10_000));
    let settings = LoopSettings::default();
    let voxel = PlaceBook::voxel_for_map(&surface, &lower);
    let [first, second] = [&lower, &upper].map(|path| PlaceBook::of_map(&surface, path, voxel, &settings));
    join(&first, &second, &upper, Start::Unknown, &settings).unwrap()
}

#[test]
fn a_session_of_another_storey_is_said_to_look_alike() {
    let other = joined(1.0);
    let (places, share) = other.alike.expect("the same walls");
    assert!(other.joined.is_none() && places > 1 && share > 0.01, "{places} places, {share}");
    // Of storeys that are the same in all, nothing can tell.
    let same = joined(0.0);
    assert!(same.alike.is_none() && same.joined.is_some_and(|joined| joined.edges.len() > 1), "{:?}", same.alike);
}

/// Forty buildings; some minutes. `cargo test --release -p voxelastic-slam --test all -- --ignored --nocapture forty`.
#[test]
#[ignore = "takes minutes"]
fn forty_buildings_whose_storeys_look_alike() {
    let all: Vec<(usize, Vec<Closure>)> = (0..40).map(|k| walked(k, 0.1 + 0.1 * (k % 10) as f64, k % 4 != 0)).collect();
    let wrong: Vec<&Closure> = all.iter().flat_map(|(_, wrong)| wrong).collect();
    println!("{} right, {} false", all.iter().map(|(right, _)| right).sum::<usize>(), wrong.len());
    assert!(wrong.is_empty(), "{wrong:?}");
}
