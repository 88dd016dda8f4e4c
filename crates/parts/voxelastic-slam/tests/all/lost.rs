//! What goes wrong on the way: it is noticed, said, and survived, and no pose is wrong without a word.
#![allow(clippy::print_stdout)]

use nalgebra::{Translation3, UnitQuaternion};
use voxelastic::geometry::PoseExt;
use voxelastic::{Cloud, Pose};
use voxelastic_sim::random::Stream;
use voxelastic_sim::{SimOptions, Simulation};
use voxelastic_slam::odometry::{Failure, Odometry, OdometryReport, OdometrySettings, Status};

/// A scan with its time and the true pose of the sensor.
struct Taken {
    time: f64,
    truth: Pose,
    cloud: Cloud,
}

fn simulation(world: &str, options: SimOptions) -> Simulation {
    Simulation::new(SimOptions { world: world.into(), ..options }).unwrap()
}

/// Ten scans a second, standing still for each.
fn walk(world: &str, scans: usize) -> Simulation {
    simulation(
        world,
        SimOptions { scans: Some(scans), rate: Some(10.0), columns: Some(512), carrier: Some("pedestrian".into()), ..SimOptions::default() },
    )
}

fn taken(simulation: &Simulation, which: impl Iterator<Item = usize>) -> Vec<Taken> {
    which.map(|k| Taken { time: simulation.times()[k], truth: simulation.ground_truth()[k], cloud: simulation.cloud(k).unwrap() }).collect()
}

fn track(scans: &[Taken]) -> Vec<OdometryReport> {
    let mut odometry = Odometry::new(OdometrySettings::default());
    scans.iter().map(|scan| odometry.register(&scan.cloud, Some(scan.time))).collect()
}

fn is_measured(report: &OdometryReport) -> bool {
    !matches!(report.status, Status::Failed(_))
}

/// Errors of the motions between neighbouring scans that were registered in the same piece, metres; rotations count 2 m a radian.
fn step_errors(scans: &[Taken], reports: &[OdometryReport]) -> Vec<(usize, f64)> {
    let measured: Vec<usize> = (0..reports.len()).filter(|k| is_measured(&reports[*k])).collect();
    let same_piece = |pair: &&[usize]| reports[pair[0]].piece == reports[pair[1]].piece;
    let error = |pair: &[usize]| {
        let [a, b] = [pair[0], pair[1]];
        let off = reports[a].t_map_lidar.inv_mul(&reports[b].t_map_lidar).inv_mul(&scans[a].truth.inv_mul(&scans[b].truth));
        (b, off.translation.vector.norm() + 2.0 * off.rotation.angle())
    };
    measured.windows(2).filter(same_piece).map(error).collect()
}

fn worst(scans: &[Taken], reports: &[OdometryReport]) -> f64 {
    step_errors(scans, reports).into_iter().map(|(_, error)| error).fold(0.0, f64::max)
}

fn pieces(reports: &[OdometryReport]) -> usize {
    reports.last().unwrap().piece + 1
}

#[test]
fn a_sensor_that_does_not_move_stays_where_it_is() {
    let still = simulation("room", SimOptions { scans: Some(30), rate: Some(10.0), rest: 100.0, columns: Some(512), ..SimOptions::default() });
    let scans = taken(&still, 0..30);
    let reports = track(&scans);
    assert!(reports[1..].iter().all(|r| r.status == Status::Tracked));
    let moved = reports[0].t_map_lidar.translation_distance(&reports[29].t_map_lidar);
    // One standard deviation of a simulated range at 10 m.
    let noise = 0.01 + 0.0002 * 10.0;
    assert!(moved < noise, "{moved} m");
}

#[test]
fn scans_of_a_covered_sensor_are_left_out() {
    let walk = walk("campus", 30);
    let mut scans = taken(&walk, 0..30);
    for scan in &mut scans[12..16] {
        let kept = scan.cloud.points.iter().enumerate().filter(|(k, p)| k % 33 == 0 && p[0].is_finite());
        scan.cloud = Cloud::from_points(kept.map(|(_, p)| *p).collect());
    }
    let reports = track(&scans);
    println!("covered: {:?}", reports[11..17].iter().map(|r| (r.status.clone(), r.overlap)).collect::<Vec<_>>());
    assert!(reports[12..16].iter().all(|r| r.status == Status::Failed(Failure::TooFewReturns)));
    assert!(pieces(&reports) == 1 && reports[16..].iter().all(|r| r.status == Status::Tracked));
    assert!(worst(&scans, &reports) < 0.1);
}

#[test]
fn a_gap_is_said_and_bridged_or_begins_a_new_piece() {
    for world in ["campus", "room"] {
        let walk = walk(world, 90);
        let scans = taken(&walk, (0..20).chain(70..90));
        let reports = track(&scans);
        println!("{world}: pieces {}, worst step {:.3} m", pieces(&reports), worst(&scans, &reports));
        assert_eq!(reports.iter().filter(|r| r.gap.is_some_and(|s| (s - 5.1).abs() < 1e-6)).count(), 1, "{world}");
        assert!(worst(&scans, &reports) < 0.2, "{world}: {} m", worst(&scans, &reports));
        assert!(reports[30..].iter().all(is_measured), "{world}");
    }
}

#[test]
fn a_clock_that_is_set_back_begins_a_new_piece_and_one_set_forward_is_a_gap() {
    let walk = walk("room", 24);
    let jump = |seconds: f64| {
        let mut scans = taken(&walk, 0..24);
        scans[12..].iter_mut().for_each(|scan| scan.time += seconds);
        let reports = track(&scans);
        assert!(worst(&scans, &reports) < 0.1, "{seconds} s");
        reports
    };
    let back = jump(-1000.0);
    let late = || back.iter().filter(|r| r.status == Status::Failed(Failure::TimeNotAscending)).count();
    assert_eq!((pieces(&back), late()), (2, 2), "two are left out, with the third it is sure");
    assert!(back[15..].iter().all(is_measured));
    let forward = jump(1e6);
    assert!(pieces(&forward) == 1 && forward.iter().all(is_measured) && forward[12].gap.is_some());
    // A single scan out of order is left out.
    let mut scans = taken(&walk, 0..24);
    scans.swap(9, 10);
    let reports = track(&scans);
    assert_eq!((pieces(&reports), reports.iter().filter(|r| !is_measured(r)).count()), (1, 1));
}

#[test]
fn scans_of_two_sensors_in_one_stream_are_noticed() {
    let walk = walk("campus", 40);
    let mut scans = taken(&walk, 0..40);
    let other = Pose::from_parts(Translation3::new(0.0, -1.2, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, 0.6));
    let trajectory = &walk.scene().trajectory;
    for (k, scan) in scans.iter_mut().enumerate().filter(|(k, _)| k % 2 == 1) {
        scan.truth = trajectory.pose(scan.time) * other;
        scan.cloud = walk.lidar().scan(walk.world(), |_| scan.truth, &Stream::new(9, &[k as u64]));
    }
    let reports = track(&scans);
    println!("two sensors: noticed with scan {:?}, worst step {:.3} m", reports.iter().position(|r| r.alternates), worst(&scans, &reports));
    assert!(reports.iter().position(|r| r.alternates).is_some_and(|k| k <= 20));
    assert!(worst(&scans, &reports) < 0.3, "{}", worst(&scans, &reports));
    // A shaken sensor is none.
    let shaken = simulation(
        "campus",
        SimOptions { scans: Some(30), rate: Some(10.0), columns: Some(512), carrier: Some("handheld".into()), ..SimOptions::default() },
    );
    assert!(track(&taken(&shaken, 0..30)).iter().all(|r| !r.alternates));
}

/// Reports on a sensor that takes 16 scans of a route, is moved while it is off, and takes 16 more; also the largest error of a step, metres.
fn kidnapped(world: &str, spacing: f64, columns: usize, [first, second]: [usize; 2]) -> (Vec<OdometryReport>, f64) {
    let options = SimOptions { scans: Some(first.max(second) + 16), spacing, columns: Some(columns), ..SimOptions::default() };
    let drive = simulation(world, options);
    let mut scans = taken(&drive, (first..first + 16).chain(second..second + 16));
    (0..).zip(&mut scans).for_each(|(k, scan)| scan.time = 0.1 * f64::from(k));
    let reports = track(&scans);
    let worst = worst(&scans, &reports);
    (reports, worst)
}

#[test]
fn a_sensor_that_is_moved_while_it_is_off_is_lost_and_begins_a_new_piece() {
    // Along one street, round its corner, across a campus.
    for (world, spacing, at) in
        [("street", 1.0, [10, 75]), ("street", 1.0, [10, 110]), ("street", 1.0, [40, 190]), ("campus", 1.0, [10, 90]), ("campus", 1.0, [150, 20])]
    {
        let (reports, worst) = kidnapped(world, spacing, 512, at);
        let said = reports.iter().filter(|r| matches!(r.status, Status::Failed(Failure::InFreeSpace | Failure::TooLittleOverlap))).count();
        println!("{world} {at:?}: {said} refused, {} pieces, worst step {worst:.3} m", pieces(&reports));
        assert!(worst < 0.3, "{world} {at:?}: {worst} m without a word");
        assert!(said >= 2 && pieces(&reports) == 2, "{world} {at:?}: {said}, {}", pieces(&reports));
        assert!(reports[20..].iter().all(is_measured), "{world} {at:?}");
    }
}

#[test]
fn a_tunnel_without_features_is_said_to_be_degenerate_and_is_driven_through_straight() {
    // 300 m of smooth walls: with 60 m of range, neither end is seen in its middle.
    let (range, length) = (60.0, 300.0);
    let drive = simulation("tunnel", SimOptions { scans: Some(85), spacing: 3.0, columns: Some(1024), ..SimOptions::default() });
    let scans = taken(&drive, 0..85);
    let mut settings = OdometrySettings::default();
    settings.max_range = range;
    let mut odometry = Odometry::new(settings);
    let reports: Vec<OdometryReport> = scans.iter().map(|scan| odometry.register(&scan.cloud, Some(scan.time))).collect();
    let to_truth = scans[0].truth * reports[0].t_map_lidar.inverse();
    let (mut counts, mut worst) = ([[0; 2]; 2], [0.0_f64; 3]);
    for (scan, report) in scans.iter().zip(&reports) {
        let x = scan.truth.translation.x;
        let is_degenerate = matches!(report.status, Status::Degenerate { .. });
        if x < 0.0 {
            counts[0][usize::from(is_degenerate)] += 1;
        } else if x > range && x < length - range {
            counts[1][usize::from(is_degenerate)] += 1;
            let pose = to_truth * report.t_map_lidar;
            let off = pose.translation.vector - scan.truth.translation.vector;
            let turned = pose.rotation_distance(&scan.truth).to_degrees();
            worst = [worst[0].max(off.x.abs()), worst[1].max(off.y.hypot(off.z)), worst[2].max(turned)];
        }
    }
    let [[_, in_yard], [unsaid, said]] = counts;
    let [along, sideways, turned] = worst;
    println!("tunnel: {said} said, {unsaid} not, {in_yard} in the yard; {along:.2} m along, {sideways:.3} m sideways, {turned:.3} degrees");
    // Far from both ends only the velocity before says how far it is.
    assert!(unsaid * 8 < said && said >= 45 && in_yard == 0, "{counts:?}");
    assert!(along < 50.0 && sideways < 0.1 && turned < 0.1, "{worst:?}");
}

#[test]
fn a_recording_that_starts_in_motion_is_tracked() {
    // A car at 8 m/s from the first sweep on: 0.8 m in each sweep, of which nothing is known at first.
    let options = SimOptions {
        scans: Some(20),
        rate: Some(10.0),
        columns: Some(512),
        carrier: Some("car".into()),
        lidar: voxelastic_sim::sensor::LidarSettings { moving: true, ..Default::default() },
        ..SimOptions::default()
    };
    let drive = simulation("street", options);
    let scans = taken(&drive, 0..20);
    let reports = track(&scans);
    let errors = step_errors(&scans, &reports);
    println!("starts in motion: {:.3?}", errors.iter().map(|(_, e)| *e).collect::<Vec<_>>());
    assert!(pieces(&reports) == 1 && reports[1..].iter().all(is_measured));
    // The first sweep is smeared over its motion; then the velocity is known.
    assert!(errors.iter().all(|(k, error)| *error < if *k < 6 { 0.3 } else { 0.05 }), "{errors:?}");
}
