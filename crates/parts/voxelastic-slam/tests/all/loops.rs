//! Loop closures in simulated drives with drift: found, right, and none where places only look alike.
#![allow(clippy::print_stdout)]

use std::collections::HashMap;
use voxelastic::event::{Event, NodeId, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic::{Cloud, Pose};
use voxelastic_sim::{SimOptions, Simulation};
use voxelastic_slam::graph::{LiveOptimiser, Options};
use voxelastic_slam::loops::{Closure, LoopFinder, LoopSettings, PlaceBook, PlaceDescriptors, Verdict};

/// Scans of one lap of the street, 5 m apart.
const LAP: usize = 71;

fn street(seed: u64) -> Simulation {
    Simulation::new(SimOptions { scans: Some(LAP * 13 / 10), spacing: 5.0, columns: Some(128), seed, ..SimOptions::of("street") }).unwrap()
}

/// Scans at the poses of the odometry, and odometry edges.
fn events(simulation: &Simulation) -> Vec<Event> {
    simulation.events().filter(|event| matches!(event, Event::Scan(_) | Event::OdometryEdge(_))).collect()
}

/// Closures of events, and the poses after optimisation.
fn closed(events: Vec<Event>) -> (Vec<Closure>, Vec<(NodeId, Pose)>) {
    let mut finder = LoopFinder::new(LoopSettings::default());
    let mut optimiser = LiveOptimiser::new(Options::default());
    for event in events {
        for edge in finder.take(&event) {
            optimiser.handle(Event::LoopEdge(edge)).unwrap();
        }
        optimiser.handle(event).unwrap();
    }
    for edge in finder.finish() {
        optimiser.handle(Event::LoopEdge(edge)).unwrap();
    }
    optimiser.finish().unwrap();
    (finder.closures().to_vec(), optimiser.poses().to_vec())
}

fn largest_error(poses: impl Iterator<Item = (NodeId, Pose)>, truth: &HashMap<NodeId, Pose>) -> f64 {
    poses.map(|(node, pose)| pose.translation_distance(&truth[&node])).fold(0.0, f64::max)
}

#[test]
fn a_drive_with_drift_is_closed_and_every_closure_is_right() {
    for seed in [1, 2] {
        let simulation = street(seed);
        let truth: HashMap<NodeId, Pose> = (0..).zip(simulation.ground_truth().iter().copied()).collect();
        let (closures, poses) = closed(events(&simulation));
        let accepted: Vec<&Closure> = closures.iter().filter(|c| c.verdict == Verdict::Accepted).collect();
        for closure in &accepted {
            let right = truth[&closure.from].inv_mul(&truth[&closure.to]);
            let found = closure.fit.unwrap().t_first_second;
            let (metres, radians) = (found.translation_distance(&right), found.rotation_distance(&right));
            assert!(metres < 0.5 && radians < 0.03, "{metres} m, {radians} rad: {closure:?}");
        }
        let before = largest_error((0..).zip(simulation.odometry().iter().copied()), &truth);
        let after = largest_error(poses.into_iter(), &truth);
        println!("seed {seed}: {} of {} closures accepted, largest error {before:.2} to {after:.2} m", accepted.len(), closures.len());
        assert!(accepted.len() >= 3 && closures.iter().any(|c| c.verdict == Verdict::FreeSpace), "{closures:?}");
        assert!(after < 0.4 * before, "{before} m, {after} m");
    }
}

#[test]
fn a_finder_that_knows_the_outcomes_of_its_searches_need_not_search() {
    let events = events(&street(1));
    let take = |finder: &mut LoopFinder, events: &[Event]| events.iter().flat_map(|event| finder.take(event)).collect::<Vec<_>>();
    let mut whole = LoopFinder::new(LoopSettings::default());
    let (first, second) = events.split_at(events.len() * 9 / 10);
    let found = [take(&mut whole, first), take(&mut whole, second)];
    let known = {
        let mut finder = LoopFinder::new(LoopSettings::default());
        take(&mut finder, first);
        postcard::to_stdvec(&finder.searches()).unwrap()
    };
    // Of settings by which nothing is found, so that what is found in the first part was not searched for.
    let mut blind = LoopSettings::default();
    blind.most_registered = 0;
    let mut resumed = LoopFinder::new(blind).with_searches(postcard::from_bytes(&known).unwrap());
    assert_eq!(take(&mut resumed, first), found[0]);
    assert!(found[0].len() > 1 && take(&mut resumed, second).is_empty());
    let mut resumed = LoopFinder::new(LoopSettings::default()).with_searches(postcard::from_bytes(&known).unwrap());
    assert_eq!([take(&mut resumed, first), take(&mut resumed, second)], found);
    assert!(!found[1].is_empty() && resumed.closures() == whole.closures());
}

#[test]
fn places_that_only_look_alike_are_refused() {
    let simulation = street(3);
    // After one lap the street comes again, mirrored left to right: the same lengths, heights and distances everywhere.
    let scans: Vec<Scan> = simulation.events().filter_map(|event| if let Event::Scan(scan) = event { Some(scan) } else { None }).collect();
    let mirror = |pose: &Pose| {
        let mut mirrored = *pose;
        mirrored.translation.vector.y *= -1.0;
        let q = pose.rotation.quaternion();
        mirrored.rotation = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, -q.i, q.j, -q.k));
        mirrored
    };
    let mirrored = scans[..LAP].iter().map(|scan| Scan {
        node: scan.node + 10_000,
        time: scan.time + 1e4,
        t_map_lidar: mirror(&scan.t_map_lidar),
        cloud: Cloud::from_points(scan.cloud.points.iter().map(|[x, y, z]| [*x, -y, *z]).collect()),
    });
    let mut all = Vec::new();
    for scan in scans[..LAP].iter().cloned().chain(mirrored) {
        let before = all.iter().rev().find_map(|event| if let Event::Scan(s) = event { Some((s.node, s.t_map_lidar)) } else { None });
        let (node, t_map_lidar) = (scan.node, scan.t_map_lidar);
        all.push(Event::Scan(scan));
        if let Some((from, t_map_from)) = before {
            let t_from_to = t_map_from.inv_mul(&t_map_lidar);
            all.push(Event::OdometryEdge(voxelastic::event::Edge { from, to: node, t_from_to, information: None }));
        }
    }
    let (closures, _) = closed(all);
    let across: Vec<&Closure> = closures.iter().filter(|c| c.from < 10_000 && c.to >= 10_000).collect();
    let vetoed = across.iter().filter(|c| c.verdict == Verdict::FreeSpace).count();
    println!("{} candidates across the mirror, {vetoed} of them refused by free space", across.len());
    assert!(vetoed > 0 && across.iter().all(|c| c.verdict != Verdict::Accepted), "{across:?}");
}

#[test]
fn a_closure_that_the_odometry_cannot_be_wrong_by_is_refused() {
    // The second lap comes 80 m higher, after less than 500 m of path.
    let lifted = events(&street(1)).into_iter().map(|event| match event {
        Event::Scan(scan) if scan.node >= LAP as NodeId => {
            Event::Scan(Scan { t_map_lidar: Pose::translation(0.0, 0.0, 80.0) * scan.t_map_lidar, ..scan })
        }
        other => other,
    });
    let (closures, _) = closed(lifted.collect());
    let across: Vec<&Closure> = closures.iter().filter(|c| c.from < LAP as NodeId - 10 && c.to > LAP as NodeId + 10).collect();
    assert!(across.iter().any(|c| c.verdict == Verdict::BeyondDrift), "{across:?}");
    assert!(across.iter().all(|c| c.verdict != Verdict::Accepted), "{across:?}");
}

#[test]
fn closures_do_not_depend_on_the_number_of_threads() {
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let all = events(&street(1));
        pool.install(|| closed(all).0)
    };
    assert_eq!(with(1), with(3));
}

/// The places of a part of a simulation, in a frame of their own.
fn book(simulation: &Simulation, scans: std::ops::Range<u64>, first: NodeId, t_own_map: Pose) -> PlaceBook {
    let mut settings = LoopSettings::default();
    settings.voxel_size = Some(0.7);
    let mut finder = LoopFinder::new(settings);
    for event in events(simulation) {
        match event {
            Event::Scan(scan) if scans.contains(&scan.node) => {
                finder.take(&Event::Scan(Scan { node: first + scan.node, t_map_lidar: t_own_map * scan.t_map_lidar, ..scan }));
            }
            Event::OdometryEdge(edge) if scans.contains(&edge.from) && scans.contains(&edge.to) => {
                finder.take(&Event::OdometryEdge(voxelastic::event::Edge { from: first + edge.from, to: first + edge.to, ..edge }));
            }
            _ => {}
        }
    }
    finder.finish();
    PlaceBook::of(finder).unwrap()
}

#[test]
fn places_of_two_recordings_are_found_in_each_other_after_they_were_stored() {
    let simulation = street(1);
    let truth = simulation.ground_truth();
    let turned = Pose::new(nalgebra::Vector3::new(500.0, -80.0, 3.0), nalgebra::Vector3::new(0.0, 0.0, 2.0));
    let (first, second) = (book(&simulation, 0..40, 0, Pose::identity()), book(&simulation, 20..60, 1000, turned));
    let stored = |book: &PlaceBook| PlaceBook::from_bytes(&book.to_bytes()).unwrap();
    let pairs = PlaceDescriptors::from_bytes(&first.descriptors().to_bytes()).unwrap().alike(&second.descriptors(), 8);
    assert!(pairs.len() <= 8 * second.len() && pairs.iter().all(|pair| pair.first < first.len() && pair.second < second.len()));
    let settings = LoopSettings::default();
    let closures = stored(&first).verify(&stored(&second), &pairs, &settings);
    let accepted: Vec<&Closure> = closures.iter().filter(|closure| closure.verdict == Verdict::Accepted).collect();
    assert!(accepted.len() >= 2, "{closures:?}");
    for closure in accepted {
        let edge = first.edge(closure).unwrap();
        let right = truth[edge.from as usize].inv_mul(&truth[edge.to as usize - 1000]);
        assert!(edge.t_from_to.translation_distance(&right) < 0.5, "{closure:?}");
    }
    assert!(PlaceBook::from_bytes(&first.to_bytes()[..1000]).is_none() && PlaceDescriptors::from_bytes(&[1, 2]).is_none());
}
