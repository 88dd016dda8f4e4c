//! Motion compensation against other software: Newer College scans as measured and as undistorted by gtsam_points.
//!
//! The scans come without a trajectory. The motion is estimated every 5 ms from pairs of raw and undistorted points, one in thirty of them; undistortion with it must
//! then move the other points to their undistorted positions, too.

use crate::sensor::data::numbers;
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use voxelastic::{Cloud, Motion, Pose};

fn points(relative: &str) -> Option<Vec<Point3<f64>>> {
    Some(numbers(relative)?.chunks_exact(3).map(|p| Point3::new(p[0].into(), p[1].into(), p[2].into())).collect())
}

/// The rigid transform that maps the first points of the pairs to the second in the sense of least squares.
fn fit(pairs: &[(Point3<f64>, Point3<f64>)]) -> Pose {
    let n = pairs.len() as f64;
    let (a, b) = pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |(a, b), (p, q)| (a + p.coords, b + q.coords));
    let (a, b) = (a / n, b / n);
    let covariance: Matrix3<f64> = pairs.iter().map(|(p, q)| (q.coords - b) * (p.coords - a).transpose()).sum();
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u.unwrap(), svd.v_t.unwrap());
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant()));
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * sign * v_t));
    Pose::from_parts((b - rotation * a).into(), rotation)
}

#[test]
fn scans_of_newer_college_are_undistorted_like_by_gtsam_points() {
    for k in 0..3 {
        let file = |kind: &str| format!("newer-college-sample/{kind}_{k:02}.bin");
        let (Some(raw), Some(right), Some(times)) = (points(&file("raw")), points(&file("deskewed")), numbers(&file("times"))) else { return };
        let near = |t: f32| -> Vec<(Point3<f64>, Point3<f64>)> {
            (0..raw.len()).filter(|&i| (times[i] - t).abs() < 2.5e-4).map(|i| (raw[i], right[i])).collect()
        };
        let fitted: Vec<(f32, Pose)> =
            (0..=20).map(|k| 0.005 * k as f32).map(|t| (t, near(t))).filter(|(_, p)| p.len() >= 15).map(|(t, p)| (t, fit(&p))).collect();
        let t_imu_lidar = fitted[0].1;
        let motion = Motion::through(fitted.iter().map(|(t, pose)| (*t, t_imu_lidar.inv_mul(pose)))).unwrap();
        let single = |p: &Point3<f64>| [p.x as f32, p.y as f32, p.z as f32];
        let mut cloud = Cloud::from_points(raw.iter().map(single).collect());
        (cloud.time, cloud.motion) = (Some(times.clone()), Some(motion));
        let moved = cloud.undistorted().unwrap();
        let off = |points: &[[f32; 3]]| -> Vec<f64> {
            let mut off: Vec<f64> = points.iter().zip(&right).map(|(p, q)| ((t_imu_lidar * Point3::from(p.map(f64::from))) - q).norm()).collect();
            off.sort_by(f64::total_cmp);
            off
        };
        let (before, after) = (off(&cloud.points), off(&moved.points));
        let at = |off: &[f64], share: f64| 100.0 * off[(share * (off.len() - 1) as f64) as usize];
        println!(
            "scan {k}: {} points; off by {:.1} cm in the median as measured, {:.2} cm undistorted (95 % within {:.1} cm before, {:.2} cm after)",
            raw.len(),
            at(&before, 0.5),
            at(&after, 0.5),
            at(&before, 0.95),
            at(&after, 0.95)
        );
        assert!(at(&after, 0.5) < 1.0 && at(&after, 0.95) < 0.1 * at(&before, 0.95));
    }
}
