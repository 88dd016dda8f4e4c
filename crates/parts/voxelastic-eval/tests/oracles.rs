//! Our distances, alignments and trajectory errors against Open3D, small_gicp and evo. Skipped, with a word, where those are not installed.
#![allow(clippy::print_stderr)]

mod support;

use nalgebra::{Translation3, UnitQuaternion};
use support::{hall_scan, numbers, random, read_f32, write_points};
use voxelastic::Pose;
use voxelastic::geometry::PoseExt;
use voxelastic_eval::align::{AlignSettings, align, moved};
use voxelastic_eval::trajectory::{Delta, Fit, Pair, ate, rpe};
use voxelastic_eval::{MeshIndex, MeshView, PointIndex};
use voxelastic_testing::{data, run_python};

struct Sheet {
    vertices: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    points: Vec<[f32; 3]>,
}

/// A bumpy sheet with 20 000 triangles, and points about it.
fn sheet() -> Sheet {
    let (n, mut random) = (100u32, random(5));
    let vertices = (0..(n + 1) * (n + 1))
        .map(|i| ((i % (n + 1)) as f32 * 0.1, (i / (n + 1)) as f32 * 0.1))
        .map(|(x, y)| [x, y, (x * 1.3).sin() + 0.4 * (y * 2.1).cos() + 0.1 * random() as f32])
        .collect();
    let triangles = (0..n * n).map(|i| i / n * (n + 1) + i % n).flat_map(|p| [[p, p + 1, p + n + 2], [p, p + n + 2, p + n + 1]]).collect();
    let points = (0..20_000).map(|_| [random() * 12.0 - 1.0, random() * 12.0 - 1.0, random() * 5.0 - 2.0].map(|c| c as f32)).collect();
    Sheet { vertices, triangles, points }
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

const OPEN3D: &str = r#"
import sys, numpy as np, open3d as o3d
points = np.fromfile(sys.argv[1], np.float32).reshape(-1, 3)
vertices = np.fromfile(sys.argv[2], np.float32).reshape(-1, 3)
triangles = np.fromfile(sys.argv[3], np.uint32).reshape(-1, 3)
cloud = lambda p: o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p.astype(np.float64)))
np.asarray(cloud(points).compute_point_cloud_distance(cloud(vertices))).astype(np.float32).tofile(sys.argv[4])
scene = o3d.t.geometry.RaycastingScene()
scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles))
scene.compute_distance(o3d.core.Tensor(points)).numpy().tofile(sys.argv[5])
"#;

#[test]
fn distances_agree_with_open3d() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let Sheet { vertices, triangles, points } = sheet();
    write_points(&file("points"), &points);
    write_points(&file("vertices"), &vertices);
    std::fs::write(file("triangles"), triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
    let arguments = ["points", "vertices", "triangles", "to_cloud", "to_mesh"].map(file);
    let Some(_) = run_python("numpy, open3d", OPEN3D, &arguments.each_ref().map(|p| p.as_path())) else { return };

    let to_cloud = PointIndex::new(&vertices, "the sheet").unwrap().distances(&points, f32::INFINITY);
    let to_mesh = MeshIndex::new(&MeshView::new(&vertices, &triangles).unwrap()).unwrap().distances(&points, f32::INFINITY);
    let differences = [largest_difference(&to_cloud, &read_f32(&file("to_cloud"))), largest_difference(&to_mesh, &read_f32(&file("to_mesh")))];
    eprintln!(
        "largest difference from Open3D over {} points: to the cloud {:.2e} m, to the mesh {:.2e} m",
        points.len(),
        differences[0],
        differences[1]
    );
    assert!(differences.iter().all(|d| *d < 2e-5));
}

const SMALL_GICP: &str = r#"
import sys, numpy as np, small_gicp
source, target = (np.fromfile(f, np.float32).reshape(-1, 3).astype(np.float64) for f in sys.argv[1:3])
T = np.eye(4)
for resolution, reach in ((1.0, 4.0), (0.4, 1.6), (0.15, 0.6)):
    T = small_gicp.align(target, source, init_T_target_source=T, registration_type='PLANE_ICP',
                         downsampling_resolution=resolution, max_correspondence_distance=reach, max_iterations=40, num_threads=2).T_target_source
print(*T[:3, :4].ravel())
"#;

#[test]
fn alignment_of_real_scans_agrees_with_small_gicp_and_with_the_poses() {
    let Some(hall) = data("hall") else { return };
    // Ten scans as a map, and one that is not among them, moved by half a metre and three degrees.
    let in_map = |i| {
        let (points, t_map_lidar) = hall_scan(&hall, i);
        moved(&points, &t_map_lidar)
    };
    let target: Vec<[f32; 3]> = (20..31).filter(|i| *i != 25).flat_map(in_map).collect();
    let off = Pose::from_parts(Translation3::new(0.4, -0.3, 0.1), UnitQuaternion::from_euler_angles(0.01, -0.01, 0.05));
    let source = moved(&in_map(25), &off.inverse());
    let start = std::time::Instant::now();
    let found = align(&source, &target, &AlignSettings::default()).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    let from_poses = (found.t_target_source.translation_distance(&off), found.t_target_source.rotation_distance(&off).to_degrees());
    eprintln!(
        "hall, scan 25 to ten others: {:.1} mm and {:.3} deg from the poses in {seconds:.2} s, {:?}",
        from_poses.0 * 1e3,
        from_poses.1,
        found.quality
    );
    assert!(from_poses.0 < 0.02 && from_poses.1 < 0.15);

    let folder = tempfile::tempdir().unwrap();
    let files = ["source", "target"].map(|n| folder.path().join(n));
    write_points(&files[0], &source);
    write_points(&files[1], &target);
    let Some(text) = run_python("numpy, small_gicp", SMALL_GICP, &files.each_ref().map(|p| p.as_path())) else { return };
    let v = numbers(&text);
    let rotation = nalgebra::Matrix3::from_fn(|i, j| v[4 * i + j]);
    let rotation = UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(rotation));
    let theirs = Pose::from_parts(Translation3::new(v[3], v[7], v[11]), rotation);
    let apart = (found.t_target_source.translation_distance(&theirs), found.t_target_source.rotation_distance(&theirs).to_degrees());
    eprintln!(
        "small_gicp: {:.1} mm and {:.3} deg from ours, {:.1} mm from the poses",
        apart.0 * 1e3,
        apart.1,
        theirs.translation_distance(&off) * 1e3
    );
    assert!(apart.0 < 0.03 && apart.1 < 0.2);
}

const EVO: &str = r#"
import sys, numpy as np
from evo.core import metrics, trajectory
poses = np.fromfile(sys.argv[1], np.float64).reshape(2, -1, 4, 4)
make = lambda p: trajectory.PosePath3D(poses_se3=list(p))
ref, est = make(poses[0]), make(poses[1])
def rpe(relation, delta, unit):
    m = metrics.RPE(relation, delta, unit, all_pairs=unit == metrics.Unit.frames, pairs_from_reference=True)
    m.process_data((ref, est))
    return m.get_statistic(metrics.StatisticsType.rmse)
R = metrics.PoseRelation
out = [rpe(R.translation_part, 1, metrics.Unit.frames), rpe(R.rotation_angle_deg, 1, metrics.Unit.frames), rpe(R.translation_part, 5, metrics.Unit.meters)]
est.align(ref)
for relation in (R.translation_part, R.rotation_angle_deg):
    m = metrics.APE(relation)
    m.process_data((ref, est))
    s = m.get_all_statistics()
    out += [s['rmse'], s['mean'], s['median'], s['max'], s['min'], s['std']]
print(*out)
"#;

/// A winding drive and an estimate that drifts and shakes.
fn drive() -> Vec<Pair> {
    let mut random = random(9);
    let mut t_estimate = Pose::from_parts(Translation3::new(3.0, 1.0, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, 0.7));
    let mut last: Option<Pose> = None;
    let mut step = |i: u32| {
        let s = f64::from(i) * 0.05;
        let turn = UnitQuaternion::from_euler_angles(0.02 * s.sin(), 0.03 * s.cos(), s);
        let reference = Pose::from_parts(Translation3::new(20.0 * s.sin(), 15.0 * (0.6 * s).sin(), 0.5 * s), turn);
        let mut small = || random() - 0.5;
        let noise = Pose::from_parts(
            Translation3::new(0.05 * small(), 0.05 * small(), 0.02 * small()),
            UnitQuaternion::from_euler_angles(0.01 * small(), 0.01 * small(), 0.02 * small()),
        );
        if let Some(last) = last {
            t_estimate = t_estimate * (last.inverse() * reference) * noise;
        }
        last = Some(reference);
        Pair { time: f64::from(i), reference, estimate: t_estimate }
    };
    (0..400).map(&mut step).collect()
}

#[test]
fn trajectory_errors_agree_with_evo() {
    let pairs = drive();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("poses");
    let matrices = pairs.iter().map(|p| p.reference).chain(pairs.iter().map(|p| p.estimate)).map(|p| p.to_homogeneous().transpose());
    std::fs::write(&file, matrices.flat_map(|m| m.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()).collect::<Vec<u8>>()).unwrap();
    let Some(text) = run_python("numpy, evo", EVO, &[&file]) else { return };

    let frames = rpe(&pairs, Delta::Frames(1)).unwrap();
    let mut ours = vec![frames.translation_m.rmse, frames.rotation_deg.rmse, rpe(&pairs, Delta::Metres(5.0)).unwrap().translation_m.rmse];
    let absolute = ate(&pairs, Fit::Rigid).unwrap();
    for s in [absolute.translation_m, absolute.rotation_deg] {
        ours.extend([s.rmse, s.mean, s.median, s.max, s.min, s.std_dev]);
    }
    let theirs = numbers(&text);
    let worst = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs() / b.abs().max(1e-9)).fold(0.0, f64::max);
    eprintln!("largest relative difference from evo over {} statistics: {worst:.1e} (ATE rmse {:.4} m)", ours.len(), ours[3]);
    assert!(ours.len() == theirs.len() && worst < 1e-4, "{ours:?}\n{theirs:?}");
}
