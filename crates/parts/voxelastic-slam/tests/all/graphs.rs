//! Whole graphs against GTSAM, and what is no graph.
#![allow(clippy::print_stdout)]

use crate::common::drive::{drive, information};
use crate::common::numbers::Numbers;
use voxelastic::event::{Edge, Event, NodeId, Scan, Vertical};
use voxelastic::geometry::PoseExt;
use voxelastic::{Cloud, Pose};
use voxelastic_io::{PoseGraph, g2o};
use voxelastic_slam::SlamError;
use voxelastic_slam::graph::{LiveOptimiser, Options, Problem, optimise};

/// The graph's file, where the development data is; `None` after saying so where it is not.
fn load(name: &str) -> Option<PoseGraph> {
    let path = voxelastic_testing::data(&format!("posegraphs/{name}"))?;
    Some(g2o::read(path).unwrap())
}

/// Half the sum of squares that GTSAM 4.3.0 (Python package, Levenberg-Marquardt, 100 iterations, prior of 1e-4 on the first node)
/// reaches from the poses in the file, and the one it begins with.
const GTSAM: [(&str, f64, f64); 3] = [
    ("tinyGrid3D.g2o", 143.31787355, 9.31390953),
    ("parking-garage.g2o", 8363.60194812, 0.63419240),
    ("sphere2500.g2o", 1305657.71180609, 675.70096488),
];

#[test]
fn costs_equal_those_of_gtsam() {
    for (name, before, after) in GTSAM {
        let Some(graph) = load(name) else { continue };
        let problem = Problem { nodes: &graph.nodes, edges: &graph.edges, fixed: &graph.fixed };
        let clock = std::time::Instant::now();
        let solved = optimise(&problem, &Options { huber: None, ..Options::default() }).unwrap();
        println!("{name}: {} -> {} in {:?}, converged: {}", solved.cost_before, solved.cost, clock.elapsed(), solved.is_converged);
        assert!((solved.cost_before / before - 1.0).abs() < 1e-3, "{name}: begins with {} against {before}", solved.cost_before);
        assert!(solved.cost <= after * 1.001, "{name}: {} against {after}", solved.cost);
        assert!(solved.poses.iter().map(|p| p.0).eq(graph.nodes.iter().map(|n| n.0)));
    }
}

#[test]
fn information_that_is_not_positive_definite_only_for_its_couplings_is_uncoupled() {
    let (nodes, mut edges) = chain(4);
    let mut information = [0.0; 21];
    [0, 6, 11, 15, 18, 20].iter().for_each(|i| information[*i] = 100.0);
    let plain = Edge { information: Some(information), ..edge(0, 3, 3.3) };
    information[13] = 5000.0; // z against pitch
    let coupled = Edge { information: Some(information), ..plain.clone() };
    let mut solve = |loop_edge: &Edge| {
        edges.push(loop_edge.clone());
        let solved = optimise(&Problem { nodes: &nodes, edges: &edges, fixed: &[] }, &Options::default()).unwrap();
        edges.pop();
        solved
    };
    let (plain, coupled) = (solve(&plain), solve(&coupled));
    assert_eq!((plain.uncoupled, coupled.uncoupled), (0, 1));
    assert!(plain.poses == coupled.poses && plain.cost == coupled.cost && plain.cost < plain.cost_before);
}

fn edge(from: NodeId, to: NodeId, x: f64) -> Edge {
    Edge { from, to, t_from_to: Pose::translation(x, 0.0, 0.0), information: None }
}

fn chain(count: u64) -> (Vec<(NodeId, Pose)>, Vec<Edge>) {
    let nodes = (0..count).map(|i| (i, Pose::translation(i as f64, 0.0, 0.0))).collect();
    (nodes, (1..count).map(|i| edge(i - 1, i, 1.0)).collect())
}

#[test]
fn the_kernel_keeps_an_outlier_from_bending_the_graph() {
    let (nodes, mut edges) = chain(30);
    edges.extend([edge(2, 20, 18.0), edge(3, 25, 22.0), edge(5, 27, 22.0), edge(4, 24, 0.0)]);
    let shift = |huber| {
        let solved = optimise(&Problem { nodes: &nodes, edges: &edges, fixed: &[] }, &Options { huber, ..Options::default() }).unwrap();
        solved.poses.iter().zip(&nodes).map(|(a, b)| (a.1.translation.vector - b.1.translation.vector).norm()).fold(0.0, f64::max)
    };
    let (robust, plain) = (shift(Some(3.5)), shift(None));
    assert!(robust < 0.25 * plain, "{robust} m with, {plain} m without the kernel");
}

#[test]
fn pieces_lone_nodes_and_fixed_nodes_are_solved() {
    let (mut nodes, mut edges) = chain(6);
    edges.remove(2);
    nodes.push((77, Pose::translation(9.0, 9.0, 9.0)));
    edges.push(edge(3, 5, 2.5));
    let solved = optimise(&Problem { nodes: &nodes, edges: &edges, fixed: &[5] }, &Options::default()).unwrap();
    assert!((solved.poses[6].1.translation.vector - nodes[6].1.translation.vector).norm() < 1e-3);
    assert!((solved.poses[5].1.translation.x - 5.0).abs() < 1e-3 && solved.poses[3].1.translation.x < 2.95);
    let empty = optimise(&Problem { nodes: &[], edges: &[], fixed: &[] }, &Options::default()).unwrap();
    assert!(empty.poses.is_empty());
}

#[test]
fn what_is_no_graph_is_refused_by_name() {
    let (nodes, edges) = chain(3);
    let solve =
        |nodes: &[(NodeId, Pose)], edges: &[Edge], fixed: &[NodeId]| optimise(&Problem { nodes, edges, fixed }, &Options::default()).unwrap_err();
    assert_eq!(solve(&[nodes.clone(), nodes[1..2].to_vec()].concat(), &edges, &[]), SlamError::DuplicateNode { node: 1 });
    assert_eq!(solve(&nodes, &[edge(0, 9, 1.0)], &[]), SlamError::UnknownNode { node: 9 });
    assert_eq!(solve(&nodes, &edges, &[5]), SlamError::UnknownNode { node: 5 });
    assert_eq!(solve(&nodes, &[edge(1, 1, 1.0)], &[]), SlamError::SelfEdge { node: 1 });
    assert_eq!(solve(&[(4, Pose::translation(f64::NAN, 0.0, 0.0))], &[], &[]), SlamError::BadPose { node: 4 });
    let negative = Edge { information: Some([-1.0; 21]), ..edge(0, 1, 1.0) };
    assert!(matches!(solve(&nodes, &[negative], &[]), SlamError::BadEdge { from: 0, to: 1, .. }));
    let unreadable = Edge { information: Some([f64::NAN; 21]), ..edge(0, 1, 1.0) };
    assert!(matches!(solve(&nodes, &[unreadable], &[]), SlamError::BadEdge { .. }));
}

#[test]
fn a_stream_is_corrected_after_its_loops() {
    let mut live = LiveOptimiser::new(Options::default());
    let scan =
        |node: NodeId, x: f64, y: f64| Event::Scan(Scan { node, time: 0.0, t_map_lidar: Pose::translation(x, y, 0.0), cloud: Cloud::default() });
    // Out and back on a line; the odometry drifts sideways by 1 cm a node, the loop says that the last node is the first.
    let mut out = Vec::new();
    for i in 0..41u64 {
        let x = if i <= 20 { i as f64 } else { 40.0 - i as f64 };
        out.extend(live.handle(scan(i, x, 0.01 * i as f64)).unwrap());
    }
    assert!(out.iter().all(|e| matches!(e, Event::Scan(_))));
    let closing = Edge { from: 0, to: 40, t_from_to: Pose::identity(), information: None };
    assert_eq!(live.handle(Event::LoopEdge(closing)).unwrap().len(), 1, "it waits for the next scan");
    let after = live.handle(scan(41, 1.0, 0.41)).unwrap();
    let (Event::PoseUpdate(poses), Event::Scan(next)) = (&after[0], &after[1]) else { panic!("{after:?}") };
    assert!(poses.len() == 41 && poses[40].1.translation.y.abs() < 0.1, "{:?}", poses[40]);
    let step = poses[40].1.inv_mul(&next.t_map_lidar);
    assert!((step.translation.vector - nalgebra::Vector3::new(1.0, 0.01, 0.0)).norm() < 1e-9, "odometry goes on from there");
    assert!(live.finish().unwrap().is_none() && live.runs() == 1);
    // Corrections from elsewhere are gone on from.
    live.handle(Event::PoseUpdate(vec![(41, Pose::translation(7.0, 0.0, 0.0))])).unwrap();
    let after = live.handle(scan(42, 8.0, 0.0)).unwrap();
    assert!(matches!(&after[..], [Event::Scan(s)] if (s.t_map_lidar.translation.x - 8.0).abs() < 1e-9), "{after:?}");
    live.handle(Event::PoseUpdate(vec![(41, next.t_map_lidar), (42, next.t_map_lidar * Pose::translation(1.0, 0.0, 0.0))])).unwrap();
    // A loop that says nothing new waits for the end.
    let known = Edge { from: 0, to: 40, t_from_to: poses[0].1.inv_mul(&poses[40].1), information: None };
    live.handle(Event::LoopEdge(known)).unwrap();
    assert_eq!(live.handle(scan(43, 3.0, 0.0)).unwrap().len(), 1);
    assert!(matches!(live.finish().unwrap(), Some(Event::PoseUpdate(poses)) if poses.len() == 44));
}

#[test]
fn pieces_are_joined_by_loops_and_not_by_where_they_began() {
    let scan =
        |node: NodeId, x: f64| Event::Scan(Scan { node, time: node as f64, t_map_lidar: Pose::translation(x, 0.0, 0.0), cloud: Default::default() });
    // Odometry was lost after node 1 and went on 98 m away; the loop says that it was 1 m.
    let events = || {
        vec![
            scan(0, 0.0),
            scan(1, 1.0),
            Event::OdometryEdge(edge(0, 1, 1.0)),
            scan(2, 99.0),
            scan(3, 100.0),
            Event::OdometryEdge(edge(2, 3, 1.0)),
            Event::LoopEdge(edge(1, 2, 1.0)),
        ]
    };
    let last = |mut optimiser: LiveOptimiser| {
        events().into_iter().for_each(|event| drop(optimiser.handle(event).unwrap()));
        optimiser.finish().unwrap();
        optimiser.poses()[3].1.translation.x
    };
    let joined = last(LiveOptimiser::new(Options::default()).with_pieces());
    assert!((joined - 3.0).abs() < 1e-3, "{joined} m");
    let bridged = last(LiveOptimiser::new(Options::default()));
    assert!(bridged - 3.0 > 0.05, "with an edge over the gap, that pulls at the loop: {bridged} m");
}

/// Closures come one by one, and some are wrong. The poses are those of a solution of the whole graph by the library, without what is outvoted.
#[test]
fn a_growing_graph_is_where_the_whole_graph_would_be() {
    for seed in 0..6 {
        let mut drive = drive(500 + 50 * seed as usize, 7, seed);
        let mut numbers = Numbers(seed + 100);
        if seed % 2 == 1 {
            let wrong = drive.closures.len() / 2;
            drive.closures[wrong].t_from_to *= numbers.motion(3.0, 0.2);
        }
        assert!(drive.closures.len() > 5, "{} closures", drive.closures.len());
        let mut live = LiveOptimiser::new(Options::default());
        let (mut edges, mut runs) = (Vec::new(), 0);
        let compare = |live: &LiveOptimiser, edges: &[Edge], start: Vec<(NodeId, Pose)>| {
            let outvoted = live.outvoted();
            let edges: Vec<Edge> = edges.iter().filter(|e| !outvoted.contains(&(e.from, e.to))).cloned().collect();
            let solve = |nodes: &[(NodeId, Pose)]| optimise(&Problem { nodes, edges: &edges, fixed: &[] }, &Options::default()).unwrap();
            // The library ends when the cost falls by less than a millionth: until it has nothing to gain, it begins again.
            let mut solved = solve(&start);
            for _ in 0..20 {
                let next = solve(&solved.poses);
                let is_settled = solved.cost - next.cost <= 1e-10 * solved.cost;
                solved = next;
                if is_settled {
                    break;
                }
            }
            let off = |(a, b): (&(NodeId, Pose), &(NodeId, Pose))| (a.1.translation_distance(&b.1), a.1.rotation_distance(&b.1));
            let off = solved.poses.iter().zip(live.poses()).map(off).fold((0.0, 0.0), |a: (f64, f64), b| (a.0.max(b.0), a.1.max(b.1)));
            let done = live.last().unwrap();
            assert!(off.0 < 1e-3 && off.1 < 1e-4, "seed {seed}, {} nodes: {off:?}, {done:?} against {}", live.poses().len(), solved.cost);
            assert!(done.cost <= solved.cost * (1.0 + 1e-7) && done.is_converged, "seed {seed}: {done:?} against {}", solved.cost);
        };
        for node in 0..drive.truth.len() {
            for event in drive.events(node) {
                if let Event::OdometryEdge(edge) | Event::LoopEdge(edge) = &event {
                    edges.push(edge.clone());
                }
                let start = live.poses().to_vec();
                live.handle(event).unwrap();
                if live.runs() > runs && live.runs().is_multiple_of(9) {
                    let known: Vec<Edge> = edges.iter().filter(|e| (e.from.max(e.to) as usize) < start.len()).cloned().collect();
                    compare(&live, &known, start);
                }
                runs = live.runs();
            }
        }
        let start = live.poses().to_vec();
        live.finish().unwrap();
        compare(&live, &edges, start);
    }
}

#[test]
fn what_has_not_moved_is_not_linearised_again() {
    let drive = drive(800, 5, 4);
    let mut live = LiveOptimiser::new(Options::default());
    let mut linearised = Vec::new();
    for event in (0..800).flat_map(|node| drive.events(node)) {
        let runs = live.runs();
        live.handle(event).unwrap();
        if live.runs() > runs {
            linearised.push(live.last().unwrap().linearised);
        }
    }
    linearised.sort_unstable();
    assert!(linearised.len() > 10 && linearised[linearised.len() / 2] < 60, "{linearised:?} of 800 edges");
}

#[test]
fn edges_that_are_no_measurements_are_refused_and_the_stream_goes_on() {
    let mut live = LiveOptimiser::new(Options::default());
    let drive = drive(60, 5, 1);
    (0..50).flat_map(|node| drive.events(node)).for_each(|event| drop(live.handle(event).unwrap()));
    let negative = Edge { information: Some([-1.0; 21]), ..edge(3, 40, 1.0) };
    assert!(matches!(live.handle(Event::LoopEdge(negative)), Err(SlamError::BadEdge { from: 3, to: 40, .. })));
    assert!(matches!(live.handle(Event::LoopEdge(edge(3, 3, 1.0))), Err(SlamError::SelfEdge { node: 3 })));
    // This one waits for its node; its correction comes with it.
    let t_from_to = drive.odometry[0].inv_mul(&drive.odometry[55]) * Pose::translation(0.3, 0.0, 0.0);
    let early = Edge { t_from_to, information: Some(information(0.001, 0.0001)), ..edge(0, 55, 0.0) };
    live.handle(Event::LoopEdge(early)).unwrap();
    (50..60).flat_map(|node| drive.events(node)).for_each(|event| drop(live.handle(event).unwrap()));
    live.finish().unwrap();
    let found = live.poses()[0].1.inv_mul(&live.poses()[55].1);
    assert!(found.translation_distance(&t_from_to) < 0.05, "{found}");
}

/// A drive on level ground whose odometry climbs: it pitches up by a little from node to node. Poses and odometry edges.
fn climbing(count: u64) -> (Vec<Pose>, Vec<Edge>) {
    let step = Pose::translation(1.0, 0.0, 0.0) * Pose::rotation(nalgebra::Vector3::new(0.0, -0.0005, 0.0));
    let mut poses = vec![Pose::identity()];
    (1..count).for_each(|_| poses.push(poses[poses.len() - 1] * step));
    let edge = |k: u64| Edge { from: k, to: k + 1, t_from_to: step, information: None };
    (poses, (0..count - 1).map(edge).collect())
}

#[test]
fn verticals_level_a_drive_without_closures() {
    let (poses, edges) = climbing(200);
    let after = |every: u64, tilted: bool| {
        let mut live = LiveOptimiser::new(Options::default());
        for (node, pose) in (0..).zip(&poses) {
            live.handle(Event::Scan(Scan { node, time: node as f64, t_map_lidar: *pose, cloud: Cloud::default() })).unwrap();
            if node > 0 {
                live.handle(Event::OdometryEdge(edges[node as usize - 1].clone())).unwrap();
            }
            if node % every == every - 1 {
                // One of them is that of a long acceleration.
                let off = if tilted && node == 99 { 0.3 } else { 0.0 };
                let up_lidar = nalgebra::Vector3::new(off, 0.0, 1.0).normalize().into();
                live.handle(Event::Vertical(Vertical { node, up_lidar, up_map: [0.0, 0.0, 1.0], sigma: 0.006 })).unwrap();
            }
        }
        live.finish().unwrap();
        live.poses().iter().map(|(_, pose)| pose.translation.z.abs()).fold(0.0, f64::max)
    };
    let climbed = poses.last().unwrap().translation.z;
    assert!(climbed > 9.0, "{climbed}");
    let [levelled, disturbed] = [after(10, false), after(10, true)];
    println!("{climbed:.2} m high by odometry, {levelled:.2} m with verticals, {disturbed:.2} m with one that is wrong");
    assert!(levelled < 0.05 * climbed && disturbed < 0.1 * climbed, "{levelled} {disturbed}");
    let bad = Event::Vertical(Vertical { node: 0, up_lidar: [0.0; 3], up_map: [0.0, 0.0, 1.0], sigma: 0.006 });
    let mut live = LiveOptimiser::new(Options::default());
    live.handle(Event::Scan(Scan { node: 0, time: 0.0, t_map_lidar: Pose::identity(), cloud: Cloud::default() })).unwrap();
    assert_eq!(live.handle(bad).unwrap_err(), SlamError::BadVertical { node: 0 });
}
