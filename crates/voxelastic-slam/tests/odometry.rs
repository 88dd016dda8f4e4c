//! Odometry against the truth of simulated rooms and streets.
#![allow(clippy::print_stdout)]

use voxelastic::Pose;
use voxelastic::geometry::PoseExt;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};
use voxelastic_slam::odometry::{Odometry, OdometryReport, OdometrySettings, Status};

fn simulation(options: SimOptions) -> Simulation {
    Simulation::new(options).unwrap()
}

/// Reports of all scans, and the largest error of a pose in the frame of the first, metres.
fn track(simulation: &Simulation) -> (Vec<OdometryReport>, f64) {
    let mut odometry = Odometry::new(OdometrySettings::default());
    let reports: Vec<OdometryReport> = simulation.scans(PoseSource::Truth).map(|scan| odometry.register(&scan.cloud, Some(scan.time))).collect();
    let truth = simulation.ground_truth();
    let error = |(report, pose): (&OdometryReport, &Pose)| report.t_map_lidar.translation_distance(&truth[0].inv_mul(pose));
    let largest = reports.iter().zip(truth).map(error).fold(0.0, f64::max);
    (reports, largest)
}

#[test]
fn rooms_and_streets_are_tracked() {
    let of = |world: &str, seed: u64, scans: usize, spacing: f64| SimOptions {
        scans: Some(scans),
        spacing,
        columns: Some(512),
        seed,
        ..SimOptions::of(world)
    };
    for seed in [1, 2, 3] {
        for (world, scans, spacing, most) in [("room", 20, 0.3, 0.05), ("street", 30, 1.0, 0.1), ("campus", 30, 1.0, 0.1)] {
            let simulation = simulation(of(world, seed, scans, spacing));
            let (reports, error) = track(&simulation);
            println!("{world} {seed}: {error:.3} m after {} scans", reports.len());
            assert!(reports.iter().skip(1).all(|r| r.status == Status::Tracked), "{world} {seed}");
            assert!(error < most, "{world} {seed}: {error} m");
        }
    }
}

#[test]
fn poses_do_not_depend_on_the_number_of_threads() {
    let simulation = simulation(SimOptions { scans: Some(8), spacing: 1.0, columns: Some(256), ..SimOptions::of("campus") });
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| track(&simulation).0.iter().map(|r| (r.t_map_lidar, r.information)).collect::<Vec<_>>())
    };
    assert_eq!(with(1), with(3));
}
