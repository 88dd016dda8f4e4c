//! Refinement on rooms of known shape: what it finds, and what it leaves alone.

use crate::common::numbers::Numbers;
use nalgebra::Vector3;
use voxelastic::Pose;
use voxelastic::event::Edge;
use voxelastic::geometry::PoseExt;
use voxelastic_slam::refine::{RefineSettings, Refined, ScanSurface, refine};

const CELL: f64 = 0.2;

/// A path through a room of 12 x 8 x 3 m.
fn path(scans: usize) -> Vec<Pose> {
    let at = |k: usize| {
        let turn = k as f64 * 0.5;
        Pose::new(Vector3::new(3.0 * turn.cos(), 2.0 * turn.sin(), -0.3 + 0.1 * turn.sin()), Vector3::z() * (turn + 1.0))
    };
    (0..scans).map(at).collect()
}

/// Returns in the lidar frame of what `range` gives from a place in a direction of the map frame, with 1 cm of noise.
fn scan(pose: &Pose, seed: u64, range: impl Fn(&Vector3<f64>, &Vector3<f64>) -> f64) -> ScanSurface {
    let mut random = Numbers(seed);
    let mut points = Vec::new();
    for row in 0..96 {
        for column in 0..720 {
            let (up, around) = ((f64::from(row) - 48.0) * 0.015, (0.5 * f64::from(column)).to_radians());
            let direction = Vector3::new(up.cos() * around.cos(), up.cos() * around.sin(), up.sin());
            let noise = 0.01 * random.normal();
            let p = direction * (range(&pose.translation.vector, &(pose.rotation * direction)) + noise);
            points.push([p.x as f32, p.y as f32, p.z as f32]);
        }
    }
    ScanSurface::of(&points, CELL as f32)
}

/// To the walls of a box around zero.
fn to_walls(half: Vector3<f64>) -> impl Fn(&Vector3<f64>, &Vector3<f64>) -> f64 {
    move |from, along| (0..3).map(|i| (half[i] * along[i].signum() - from[i]) / along[i]).filter(|r| *r > 0.0).fold(f64::INFINITY, f64::min)
}

fn room() -> impl Fn(&Vector3<f64>, &Vector3<f64>) -> f64 {
    to_walls(Vector3::new(6.0, 4.0, 1.5))
}

fn scans(path: &[Pose]) -> Vec<ScanSurface> {
    path.iter().enumerate().map(|(k, pose)| scan(pose, k as u64, room())).collect()
}

/// Poses off by so much, standard deviations.
fn disturbed(path: &[Pose], metres: f64, radians: f64) -> Vec<Pose> {
    let mut random = Numbers(5);
    path.iter().map(|pose| pose * random.motion(metres, radians)).collect()
}

fn refined(poses: &[Pose], scans: &[ScanSurface], edges: &[Edge]) -> Refined {
    refine(poses, scans, edges, CELL, &RefineSettings::default()).unwrap()
}

/// The largest errors of poses relative to each other: metres, radians.
fn errors(found: &[Pose], path: &[Pose]) -> (f64, f64) {
    let off = |k: usize| {
        let (found, right) = (found[0].inv_mul(&found[k]), path[0].inv_mul(&path[k]));
        (found.translation_distance(&right), found.rotation_distance(&right))
    };
    (0..path.len()).map(off).fold((0.0, 0.0), |a, b| (f64::max(a.0, b.0), f64::max(a.1, b.1)))
}

fn has_kept(found: &Refined) -> bool {
    found.rounds.iter().any(|round| round.is_kept)
}

#[test]
fn the_poses_in_a_room_are_found() {
    let path = path(12);
    let given = disturbed(&path, 0.05, 0.01);
    let found = refined(&given, &scans(&path), &[]);
    let (before, after) = (errors(&given, &path), errors(&found.poses, &path));
    assert!(before.0 > 0.05 && after.0 < 0.006 && after.1 < 0.001, "{before:?} {after:?}");
    assert!(found.after.thickness_m < 0.014 && found.after.thickness_m < 0.6 * found.before.thickness_m, "{found:?}");
    assert!(found.after.near > 0.9 && found.after.score < found.before.score);
}

#[test]
fn the_same_bits_with_any_number_of_threads() {
    let path = path(6);
    let (given, scans) = (disturbed(&path, 0.04, 0.01), scans(&path));
    let with = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| refined(&given, &scans, &[]));
    let (one, four) = (with(1), with(4));
    assert_eq!((&one.poses, one.after), (&four.poses, four.after));
    assert!(has_kept(&one));
}

#[test]
fn right_poses_stay() {
    let path = path(8);
    let found = refined(&path, &scans(&path), &[]);
    let after = errors(&found.poses, &path);
    assert!(after.0 < 0.006 && after.1 < 0.001, "{after:?}");
}

#[test]
fn what_no_plane_decides_stays() {
    // A floor alone: height, roll and pitch follow it, the rest keeps.
    let path = path(8);
    let floor = |from: &Vector3<f64>, along: &Vector3<f64>| if along.z < -0.05 { (-1.5 - from.z) / along.z } else { f64::INFINITY };
    let scans: Vec<ScanSurface> = path.iter().enumerate().map(|(k, pose)| scan(pose, k as u64, floor)).collect();
    let mut given = disturbed(&path, 0.04, 0.005);
    // The first says where up is.
    given[0] = path[0];
    let found = refined(&given, &scans, &[]);
    for (k, (now, before)) in found.poses.iter().zip(&given).enumerate() {
        let moved = now.translation.vector - before.translation.vector;
        assert!(moved.xy().norm() < 0.01, "scan {k} moved by {moved}");
    }
    let height = |poses: &[Pose]| {
        let off: Vec<f64> = poses.iter().zip(&path).map(|(p, right)| p.translation.z - right.translation.z).collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        off.iter().map(|z| (z - mean).abs()).fold(0.0, f64::max)
    };
    assert!(height(&found.poses) < 0.25 * height(&given), "{} {}", height(&found.poses), height(&given));
}

#[test]
fn without_planes_nothing_changes() {
    // A thicket: every ray ends somewhere else.
    let path = path(8);
    let mut random = Numbers(1);
    let ranges: Vec<f64> = (0..96 * 720).map(|_| 1.0 + 6.0 * random.next()).collect();
    let thicket = |pose: &Pose, k: usize| {
        let next = std::cell::Cell::new(k * 97);
        scan(pose, k as u64, |_, _| {
            next.set(next.get() + 1);
            ranges[next.get() % ranges.len()]
        })
    };
    let scans: Vec<ScanSurface> = path.iter().enumerate().map(|(k, pose)| thicket(pose, k)).collect();
    let given = disturbed(&path, 0.05, 0.01);
    let found = refined(&given, &scans, &[]);
    assert!(!has_kept(&found) && found.poses == given, "{found:?}");
}

#[test]
fn few_scans_and_empty_ones_are_no_error() {
    let path = path(3);
    let scans = scans(&path);
    for count in 0..2 {
        let found = refined(&path[..count], &scans[..count], &[]);
        assert!(found.before.planes == 0 && found.poses == path[..count]);
    }
    let empty = vec![ScanSurface::default(); 3];
    let found = refined(&path, &empty, &[]);
    assert!(found.before.planes == 0 && found.poses == path);
    let given = disturbed(&path, 0.03, 0.005);
    let found = refined(&given, &scans, &[]);
    assert!(errors(&found.poses, &path).0 < 0.008, "{:?}", errors(&found.poses, &path));
}

#[test]
fn poses_metres_off_hardly_change() {
    let path = path(8);
    let mut given = path.clone();
    let scans = scans(&path);
    for pose in &mut given[4..] {
        *pose = Pose::new(Vector3::new(2.7, 1.4, 0.9), Vector3::new(0.02, 0.0, 0.3)) * *pose;
    }
    let found = refined(&given, &scans, &[]);
    let (before, after) = (errors(&given, &path), errors(&found.poses, &path));
    assert!(after.0 < before.0 + 0.15 && found.after.score <= found.before.score, "{before:?} {after:?}");
}

#[test]
fn things_that_move_do_not_pull() {
    // A board of 2 x 2 m that is 15 cm farther at every scan.
    let path = path(12);
    let with_board = |k: usize| {
        let walls = room();
        move |from: &Vector3<f64>, along: &Vector3<f64>| {
            let far = walls(from, along);
            let to_board = (4.2 + 0.15 * k as f64 - from.x) / along.x;
            let at = from + to_board * along;
            if to_board > 0.0 && to_board < far && at.y.abs() < 1.0 && at.z.abs() < 1.0 { to_board } else { far }
        }
    };
    let scans: Vec<ScanSurface> = path.iter().enumerate().map(|(k, pose)| scan(pose, k as u64, with_board(k))).collect();
    let found = refined(&disturbed(&path, 0.04, 0.008), &scans, &[]);
    let after = errors(&found.poses, &path);
    assert!(after.0 < 0.01 && after.1 < 0.0015, "{after:?}");
}

#[test]
fn a_false_closure_does_not_pull() {
    let path = path(12);
    let given = disturbed(&path, 0.04, 0.008);
    let false_closure = Edge { from: 1, to: 9, t_from_to: path[1].inv_mul(&path[9]) * Pose::translation(1.0, 0.5, 0.0), information: None };
    let found = refined(&given, &scans(&path), &[false_closure]);
    let after = errors(&found.poses, &path);
    assert!(after.0 < 0.008 && after.1 < 0.001, "{after:?}");
}

#[test]
fn edges_that_are_none_are_refused() {
    let (path, scans) = (path(3), scans(&path(3)));
    let edge = |from, to| Edge { from, to, t_from_to: Pose::identity(), information: None };
    for (wrong, words) in [(edge(0, 7), "node 7"), (edge(1, 1), "itself")] {
        let refused = refine(&path, &scans, &[wrong], CELL, &RefineSettings::default()).unwrap_err();
        assert!(refused.to_string().contains(words), "{refused}");
    }
}
