//! Derivatives and steps against slow ones: finite differences, and a dense Gauss-Newton over points, poses and planes.

use super::equations::{Equations, Hold};
use super::moments::{Cluster, fit};
use super::planes::Shared;
use crate::graph::exp;
use nalgebra::{DMatrix, DVector, Point3, Vector3, Vector6};
use voxelastic::Pose;

const SIGMA: f64 = 0.02;
const HELD: [f64; 2] = [0.01, 0.1];

struct Random(u64);

impl Random {
    /// Between -1 and 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        size * Vector3::new(self.next(), self.next(), self.next())
    }

    fn pose(&mut self, metres: f64, radians: f64) -> Pose {
        Pose::new(self.vector(metres), self.vector(radians))
    }
}

/// A point of a plane: its scan, what it counts, and where it is in the lidar frame.
type Seen = (u32, f64, Vector3<f64>);

/// Planes that are each seen from most of the poses, with points off by centimetres.
fn world(scans: usize, planes: usize) -> (Vec<Pose>, Vec<Vec<Seen>>, Vec<Shared>) {
    let mut random = Random(11);
    let poses: Vec<Pose> = (0..scans).map(|_| random.pose(5.0, 1.5)).collect();
    let points: Vec<Vec<Seen>> = (0..planes)
        .map(|_| {
            let frame = random.pose(8.0, 3.0);
            let mut of_plane = Vec::new();
            for (scan, pose) in poses.iter().enumerate().filter(|(scan, _)| !(*scan).is_multiple_of(4)) {
                for _ in 0..6 {
                    let on = Point3::new(random.next(), random.next(), 0.02 * random.next());
                    of_plane.push((scan as u32, 1.5 + random.next(), (pose.inverse() * (frame * on)).coords));
                }
            }
            of_plane
        })
        .collect();
    let share = |points: &Vec<Seen>| {
        let clusters = points.chunk_by(|a, b| a.0 == b.0).map(|of| Cluster::of(of[0].0, of.iter().map(|(_, w, p)| (*w, *p)))).collect();
        Shared { clusters }
    };
    let shared = points.iter().map(share).collect();
    (poses, points, shared)
}

fn moved(poses: &[Pose], scan: usize, axis: usize, step: f64) -> Vec<Pose> {
    let mut poses = poses.to_vec();
    poses[scan] *= exp(&Vector6::from_fn(|i, _| if i == axis { step } else { 0.0 }));
    poses
}

#[test]
fn the_gradient_is_that_of_differences() {
    let (poses, _, planes) = world(5, 12);
    let held: Vec<Pose> = poses.iter().map(|p| p * Pose::translation(1e-5, 0.0, -2e-5)).collect();
    let mut equations = Equations::new(5, &planes, &mut [], Hold { poses: &held, sigmas: HELD }, SIGMA).unwrap();
    let gradient = equations.linearise(&poses);
    let step = 1e-5;
    for (scan, gradient) in gradient.iter().enumerate() {
        for axis in 0..6 {
            let difference = equations.cost(&moved(&poses, scan, axis, step)) - equations.cost(&moved(&poses, scan, axis, -step));
            let expected = difference / (2.0 * step);
            let found = gradient[axis];
            assert!((found - expected).abs() < 2e-3 * gradient.norm().max(1.0), "scan {scan}, axis {axis}: {found} {expected}");
        }
    }
}

#[test]
fn steps_are_those_of_a_dense_solver_that_knows_points_and_planes() {
    let (scans, planes) = (5, 12);
    let (poses, points, shared) = world(scans, planes);
    let mut equations = Equations::new(scans, &shared, &mut [], Hold { poses: &poses, sigmas: HELD }, SIGMA).unwrap();
    let found = equations.step(&poses).unwrap();

    // Unknowns: six of each pose, then distance and two slopes of each plane.
    let size = 6 * scans + 3 * planes;
    let (mut matrix, mut right) = (DMatrix::<f64>::zeros(size, size), DVector::<f64>::zeros(size));
    for (k, of_plane) in points.iter().enumerate() {
        let plane = fit(&shared[k].clusters, &poses).unwrap();
        for (scan, weight, p) in of_plane {
            let pose = &poses[*scan as usize];
            let place = |pose: &Pose| (pose * Point3::from(*p)).coords - plane.centre;
            let residual = |pose: &Pose| plane.normal.dot(&place(pose));
            let mut row = DVector::<f64>::zeros(size);
            for axis in 0..6 {
                let by = |step: f64| residual(&(pose * exp(&Vector6::from_fn(|i, _| if i == axis { step } else { 0.0 }))));
                row[6 * *scan as usize + axis] = (by(1e-6) - by(-1e-6)) / 2e-6;
            }
            let at = place(pose);
            let of_plane = [1.0, plane.within[0].dot(&at), plane.within[1].dot(&at)];
            (0..3).for_each(|i| row[6 * scans + 3 * k + i] = of_plane[i]);
            let weight = weight / (SIGMA * SIGMA);
            right += weight * residual(pose) * &row;
            matrix += weight * &row * row.transpose();
        }
    }
    for scan in 0..scans {
        (0..6).for_each(|i| matrix[(6 * scan + i, 6 * scan + i)] += if scan == 0 { 1e-4 } else { HELD[i / 3] }.powi(-2));
    }
    let expected = matrix.lu().solve(&right).unwrap();
    let largest = expected.rows(0, 6 * scans).norm();
    for (scan, step) in found.iter().enumerate() {
        let off = (step - expected.fixed_rows::<6>(6 * scan)).norm();
        assert!(off < 1e-3 * largest, "scan {scan}: {step} {}", expected.fixed_rows::<6>(6 * scan));
    }
}

#[test]
fn clusters_are_planes_wherever_their_scans_are() {
    let (poses, points, shared) = world(5, 12);
    for (points, shared) in points.iter().zip(&shared) {
        let plane = fit(&shared.clusters, &poses).unwrap();
        let distance =
            |(scan, weight, p): &Seen| weight * plane.normal.dot(&((poses[*scan as usize] * Point3::from(*p)).coords - plane.centre)).powi(2);
        let by_points: f64 = points.iter().map(distance).sum();
        assert!((plane.cost - by_points).abs() < 1e-3 * by_points, "{} {by_points}", plane.cost);
    }
}
