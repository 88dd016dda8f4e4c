//! Whether the odometry errs as much as it says.
#![allow(clippy::print_stdout)]

use voxelastic::Pose;
use voxelastic_io::{OpenOptions, dataset};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};
use voxelastic_slam::odometry::{Odometry, OdometryReport, OdometrySettings, Status, covariance_between};

/// How far apart poses are that are compared, metres of path, and how many begin.
const APART: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0];
const BEGINS: usize = 60;

/// Errors in standard deviations, of positions and of rotations: of motions over several lengths of path, component by component.
fn errors(reports: &[OdometryReport], truth: &[Pose]) -> [Vec<f64>; 2] {
    let mut path = vec![0.0];
    for pair in reports.windows(2) {
        path.push(path[path.len() - 1] + pair[0].t_map_lidar.inv_mul(&pair[1].t_map_lidar).translation.vector.norm());
    }
    let mut errors = [Vec::new(), Vec::new()];
    for apart in APART {
        for i in (1..reports.len() - 1).step_by((reports.len() / BEGINS).max(1)) {
            let j = path.partition_point(|along| *along < path[i] + apart);
            let Some(covariance) = reports.get(i..=j).and_then(covariance_between) else { continue };
            let moved = reports[i].t_map_lidar.inv_mul(&reports[j].t_map_lidar);
            let error = truth[i].inv_mul(&truth[j]).inv_mul(&moved);
            let (position, rotation) = (error.translation.vector, error.rotation.scaled_axis());
            for k in 0..3 {
                errors[0].push(position[k].abs() / covariance[(k, k)].sqrt());
                errors[1].push(rotation[k].abs() / covariance[(k + 3, k + 3)].sqrt());
            }
        }
    }
    errors
}

/// Shares within 1, 2 and 3 standard deviations.
fn shares(errors: &[f64]) -> [f64; 3] {
    [1.0, 2.0, 3.0].map(|most| errors.iter().filter(|e| **e < most).count() as f64 / errors.len() as f64)
}

fn recorded_drive(name: &str, poses: &str) -> Option<(Vec<OdometryReport>, Vec<Pose>)> {
    let folder = voxelastic_testing::data(name)?;
    let drive = dataset::open(&folder, &OpenOptions { poses: Some(folder.join(poses)), ..OpenOptions::default() }).unwrap();
    let mut odometry = Odometry::new(OdometrySettings::default());
    let mut reports = Vec::new();
    for scan in drive.scans() {
        reports.push(odometry.register(&drive.cloud(scan).unwrap(), drive.has_times().then_some(scan.time)));
    }
    Some((reports, drive.scans().iter().map(|scan| scan.t_map_lidar).collect()))
}

fn simulated(world: &str, scans: usize, spacing: f64) -> (Vec<OdometryReport>, Vec<Pose>) {
    let simulation = Simulation::new(SimOptions { scans: Some(scans), spacing, columns: Some(512), ..SimOptions::of(world) }).unwrap();
    let mut odometry = Odometry::new(OdometrySettings::default());
    let reports = simulation.scans(PoseSource::Truth).map(|scan| odometry.register(&scan.cloud, Some(scan.time))).collect();
    (reports, simulation.ground_truth().to_vec())
}

/// A tenth is allowed on the way to the ideal; who errs less than it says is careful, which is no harm.
#[test]
fn errors_are_within_what_is_said_as_often_as_they_should_be() {
    const IDEAL: [f64; 3] = [0.683, 0.954, 0.997];
    let recorded = [("kitti00-seq", "poses_groundtruth.txt"), ("kitti00-street", "poses_groundtruth.txt"), ("hall", "poses.tum")];
    let mut drives: Vec<(String, _)> =
        recorded.into_iter().filter_map(|(name, poses)| Some((name.to_owned(), recorded_drive(name, poses)?))).collect();
    drives.extend([("room", 40, 0.3), ("street", 60, 1.0)].map(|(world, scans, spacing)| (world.to_owned(), simulated(world, scans, spacing))));
    for (name, (reports, truth)) in drives {
        let all = errors(&reports, &truth);
        let found = shares(&all.concat());
        println!("{name}: {found:.2?}; positions {:.2?}, rotations {:.2?}", shares(&all[0]), shares(&all[1]));
        assert!(found.iter().zip(IDEAL).all(|(found, ideal)| *found > ideal - 0.1), "{name}: {found:?}");
        // Along roads, where errors add up, it is not too careful either.
        assert!(!name.starts_with("kitti") || found[0] < IDEAL[0] + 0.1, "{name}: {found:?}");
    }
}

#[test]
fn what_is_said_of_a_pose_is_the_sum_of_what_scans_add() {
    let (reports, _) = simulated("street", 20, 1.0);
    for (k, report) in reports.iter().enumerate().skip(1) {
        let sum = covariance_between(&reports[..=k]).unwrap();
        assert!(report.status == Status::Tracked && (sum - report.covariance).norm() < 1e-9 * sum.norm(), "{k}");
        let trace = |k: usize| reports[k].covariance.trace();
        assert!(k < 2 || trace(k) > 0.5 * trace(k - 1), "{k}");
    }
    let [near, far] = [3, 19].map(|k: usize| reports[k].covariance.trace());
    assert!(far > 4.0 * near && covariance_between(&reports[..1]).is_none(), "{near} {far}");
}
