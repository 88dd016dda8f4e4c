//! Pose graphs with measured positions.

use crate::common::numbers::Numbers;
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};
use voxelastic_slam::SlamError;
use voxelastic_slam::graph::{MeasuredPosition, Options, Problem, largest_bend, optimise_with_positions};

/// A round of 400 m, and the same with a heading and a scale that drift.
fn rounds() -> (Vec<Pose>, Vec<(NodeId, Pose)>, Vec<Edge>) {
    let on_way = |k: usize, rate: f64| {
        let angle = rate * k as f64;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        Pose::from_parts(Translation3::from(turn * Vector3::new(0.0, -63.0, 0.0)), turn)
    };
    let truth: Vec<Pose> = (0..200).map(|k| on_way(k, 0.0317)).collect();
    let mut drifted = vec![(0, truth[0])];
    for k in 1..truth.len() {
        let mut motion = truth[k - 1].inv_mul(&truth[k]);
        motion.translation.vector *= 1.01;
        motion.rotation *= UnitQuaternion::from_euler_angles(0.0, 0.0, 3e-4);
        drifted.push((k as NodeId, drifted[k - 1].1 * motion));
    }
    let edge = |k: usize| Edge { from: k as NodeId - 1, to: k as NodeId, t_from_to: drifted[k - 1].1.inv_mul(&drifted[k].1), information: None };
    let edges = (1..drifted.len()).map(edge).collect();
    (truth, drifted, edges)
}

const LEVER: Vector3<f64> = Vector3::new(0.4, -0.2, 1.1);

/// Every second node has a position of the antenna with noise of 2 cm; every tenth of them is off by metres.
fn positions(truth: &[Pose], t_plane_map: &Pose, outliers: bool) -> Vec<MeasuredPosition> {
    let mut random = Numbers(5);
    let mut one = |k: usize| {
        let noise = Vector3::from_fn(|_, _| 0.02 * random.normal());
        let off = if outliers && k % 20 == 10 { Vector3::new(5.0 + k as f64 / 5.0, -8.0, 3.0) } else { Vector3::zeros() };
        let measured = (t_plane_map * truth[k] * Point3::from(LEVER)).coords + noise + off;
        MeasuredPosition { node: k as NodeId, in_node: LEVER, measured, covariance: Matrix3::identity() * 4e-4 }
    };
    (0..truth.len()).step_by(2).map(&mut one).collect()
}

fn rms(found: &[(NodeId, Pose)], t_plane_map: &Pose, truth: &[Pose], true_plane: &Pose) -> f64 {
    let square = |(i, (_, pose)): (usize, &(NodeId, Pose))| {
        ((t_plane_map * pose).translation.vector - (true_plane * truth[i]).translation.vector).norm_squared()
    };
    (found.iter().enumerate().map(square).sum::<f64>() / found.len() as f64).sqrt()
}

#[test]
fn a_map_that_drifts_is_bent_onto_positions_and_wrong_ones_are_sorted_out() {
    let (truth, drifted, edges) = rounds();
    let plane = Pose::from_parts(Translation3::new(300.0, -50.0, 7.0), UnitQuaternion::from_euler_angles(0.01, 0.02, 2.0));
    let start = plane * Pose::from_parts(Translation3::new(0.5, 0.5, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, 0.01));
    let problem = Problem { nodes: &drifted, edges: &edges, fixed: &[] };
    let mut errors = Vec::new();
    for outliers in [false, true] {
        let measured = positions(&truth, &plane, outliers);
        let found = optimise_with_positions(&problem, &measured, &start, &Options::default()).unwrap();
        let wrong = found.is_used.iter().filter(|used| !**used).count();
        assert_eq!(wrong, if outliers { 10 } else { 0 });
        assert_eq!(found.solved.poses[0].0, 0);
        assert!((found.solved.poses[0].1.translation.vector - drifted[0].1.translation.vector).norm() < 1e-2, "the first node stays");
        assert!(largest_bend(&drifted, &found.solved.poses) > 1.0);
        errors.push(rms(&found.solved.poses, &found.t_measured_map, &truth, &plane));
    }
    assert!(errors[0] < 0.03 && errors[1] < 1.1 * errors[0], "{errors:?}");
    assert!(rms(&drifted, &start, &truth, &plane) > 1.0);
}

#[test]
fn positions_that_are_too_sure_of_themselves_are_weighed_by_what_they_are_worth() {
    let (truth, ..) = rounds();
    let nodes: Vec<(NodeId, Pose)> = (0..).zip(truth.iter().copied()).collect();
    // Odometry to a tenth of a millimetre does not follow noise of 2 cm.
    let mut information = [0.0; 21];
    [0, 6, 11].iter().for_each(|k| information[*k] = 1e8);
    [15, 18, 20].iter().for_each(|k| information[*k] = 1e10);
    let edge = |k: usize| Edge { from: k as NodeId - 1, to: k as NodeId, t_from_to: truth[k - 1].inv_mul(&truth[k]), information: Some(information) };
    let edges: Vec<Edge> = (1..truth.len()).map(edge).collect();
    let mut measured = positions(&truth, &Pose::identity(), false);
    measured.iter_mut().for_each(|p| p.covariance *= 1e-2);
    let found =
        optimise_with_positions(&Problem { nodes: &nodes, edges: &edges, fixed: &[] }, &measured, &Pose::identity(), &Options::default()).unwrap();
    let used = found.is_used.iter().filter(|used| **used).count();
    assert!(used > 90 && found.spread > 3.0, "{used} used, spread {}", found.spread);
}

#[test]
fn what_is_no_position_is_refused() {
    let (truth, drifted, edges) = rounds();
    let problem = Problem { nodes: &drifted, edges: &edges, fixed: &[] };
    let good = positions(&truth, &Pose::identity(), false)[0];
    let solve = |bad: MeasuredPosition| optimise_with_positions(&problem, &[bad], &Pose::identity(), &Options::default()).unwrap_err();
    assert_eq!(solve(MeasuredPosition { node: 999, ..good }), SlamError::UnknownNode { node: 999 });
    assert_eq!(solve(MeasuredPosition { covariance: Matrix3::zeros(), ..good }), SlamError::BadPosition { node: 0 });
    assert_eq!(solve(MeasuredPosition { measured: Vector3::repeat(f64::NAN), ..good }), SlamError::BadPosition { node: 0 });
}
