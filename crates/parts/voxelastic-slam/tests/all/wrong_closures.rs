//! A wrong closure in each of 20 graphs: it must not count in the end.
#![allow(clippy::print_stdout)]

use crate::common::drive::{Drive, drive, information};
use crate::common::numbers::Numbers;
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::g2o;
use voxelastic_slam::graph::{LiveOptimiser, Options};

/// A wrong closure joins places that are at least so far apart, metres.
const WRONG_CLOSURE_DISTANCE: f64 = 30.0;

/// Optimises the drive as a stream: final poses, and the loops that are outvoted.
fn optimised(drive: &Drive) -> (Vec<Pose>, Vec<(NodeId, NodeId)>) {
    let mut live = LiveOptimiser::new(Options::default());
    for event in (0..drive.truth.len()).flat_map(|node| drive.events(node)) {
        live.handle(event).unwrap();
    }
    live.finish().unwrap();
    (live.poses().iter().map(|p| p.1).collect(), live.outvoted())
}

/// Says that two places far apart are the same, seen from about the same spot.
fn wrong_closure(drive: &Drive, numbers: &mut Numbers) -> Edge {
    let count = drive.truth.len();
    loop {
        let (a, b) = ((numbers.next() * count as f64) as usize, (numbers.next() * count as f64) as usize);
        let (from, to) = (a.min(b), a.max(b));
        if drive.truth[from].translation_distance(&drive.truth[to]) > WRONG_CLOSURE_DISTANCE {
            let t_from_to = numbers.motion(1.0, 0.3);
            return Edge { from: from as NodeId, to: to as NodeId, t_from_to, information: Some(information(0.07, 0.0035)) };
        }
    }
}

/// Mean error after optimisation, metres, and the loops that are outvoted.
fn error(drive: &Drive) -> (f64, Vec<(NodeId, NodeId)>) {
    let (poses, outvoted) = optimised(drive);
    (poses.iter().zip(&drive.truth).map(|(a, b)| a.translation_distance(b)).sum::<f64>() / poses.len() as f64, outvoted)
}

/// Adds a wrong closure; returns how much worse than `before`, without it, the poses become, metres, and whether it alone was outvoted.
fn inject(name: &str, mut drive: Drive, before: f64, seed: u64) -> (f64, bool) {
    let wrong = wrong_closure(&drive, &mut Numbers(seed));
    let apart = drive.truth[wrong.from as usize].translation_distance(&drive.truth[wrong.to as usize]);
    let (from, to) = (wrong.from, wrong.to);
    let at = drive.closures.partition_point(|c| c.to <= to);
    drive.closures.insert(at, wrong);
    let (after, outvoted) = error(&drive);
    let is_outvoted = outvoted.contains(&(from, to));
    println!(
        "| {name} | {} | {} | {from} to {to}, {apart:.0} m | {before:.3} | {after:.3} | {} | {} |",
        drive.truth.len(),
        drive.closures.len() - 1,
        if is_outvoted { "yes" } else { "NO" },
        outvoted.len() - usize::from(is_outvoted)
    );
    (after - before, is_outvoted && outvoted.len() == 1)
}

#[test]
fn a_wrong_closure_is_outvoted_in_simulated_drives() {
    println!("| graph | nodes | right closures | wrong | error without | with | outvoted | others outvoted |");
    for seed in 0..10 {
        let drive = drive(1200, 10, seed + 20);
        let (before, none) = error(&drive);
        assert!(none.is_empty(), "{none:?}");
        let (worse, is_outvoted) = inject(&format!("simulated {seed}"), drive, before, seed);
        assert!(is_outvoted && worse.abs() < 0.01, "seed {seed}: {worse} m");
    }
}

/// The graph of the whole of KITTI 00: odometry with drift, 35 closures, true poses.
#[test]
fn a_wrong_closure_is_outvoted_in_kitti() {
    let Some(folder) = voxelastic_testing::data("kitti00-loops") else { return };
    let rows = |name: &str| -> Vec<Pose> {
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        let row = |line: &str| {
            let v: Vec<f64> = line.split_whitespace().map(|w| w.parse().unwrap()).collect();
            let rotation = nalgebra::Matrix3::from_fn(|i, j| v[4 * i + j]);
            Pose::from_parts(nalgebra::Vector3::new(v[3], v[7], v[11]).into(), nalgebra::UnitQuaternion::from_matrix(&rotation))
        };
        text.lines().map(row).collect()
    };
    let graph = g2o::read(folder.join("singlesession_posegraph.g2o")).unwrap();
    let whole = || {
        let mut closures: Vec<Edge> = graph.edges.iter().filter(|e| e.from.abs_diff(e.to) > 1).cloned().collect();
        closures.iter_mut().filter(|e| e.from > e.to).for_each(|e| {
            *e = Edge { from: e.to, to: e.from, t_from_to: e.t_from_to.inverse(), information: None };
        });
        closures.sort_by_key(|e| (e.to, e.from));
        Drive { truth: rows("groundtruth_poses.txt"), odometry: rows("odom_poses.txt"), closures }
    };
    let (before, none) = error(&whole());
    assert!(none.is_empty(), "{none:?}");
    for seed in 0..10 {
        let (worse, is_outvoted) = inject(&format!("KITTI 00, {seed}"), whole(), before, seed + 50);
        assert!(is_outvoted && worse.abs() < 0.02, "seed {seed}: {worse} m");
    }
}
