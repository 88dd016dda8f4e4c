//! Odometry against the truth of simulated rooms and streets.
#![allow(clippy::print_stdout)]

use voxelastic::event::{Event, Scan};
use voxelastic::geometry::{PoseExt, Rigid};
use voxelastic::{Cloud, Pose};
use voxelastic_sim::imu::ImuSettings;
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::LidarSettings;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};
use voxelastic_slam::odometry::{ImuSample, Level, Odometry, OdometryReport, OdometrySettings, Status};

fn simulation(options: SimOptions) -> Simulation {
    Simulation::new(options).unwrap()
}

/// Reports of all scans, and the largest error of a pose in the frame of the first, metres.
fn track(simulation: &Simulation) -> (Vec<OdometryReport>, f64) {
    let mut odometry = Odometry::new(OdometrySettings::default());
    let reports: Vec<OdometryReport> = simulation.scans(PoseSource::Truth).map(|scan| odometry.register(&scan.cloud, Some(scan.time))).collect();
    let truth = simulation.ground_truth();
    // The map frame is levelled: poses are compared in the frame of the first.
    let first = reports[0].t_map_lidar;
    let error = |(report, pose): (&OdometryReport, &Pose)| first.inv_mul(&report.t_map_lidar).translation_distance(&truth[0].inv_mul(pose));
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

/// A walk with the sensor in the hand: 10 sweeps a second with a pose for each column, shaken and swung.
fn handheld(world: &str, seed: u64, scans: usize, rest: f64) -> Simulation {
    simulation(SimOptions {
        scans: Some(scans),
        rate: Some(10.0),
        columns: Some(512),
        seed,
        carrier: Some("handheld".into()),
        rest,
        lidar: LidarSettings { moving: true, ..LidarSettings::default() },
        imu: Some(ImuSettings::default()),
        ..SimOptions::of(world)
    })
}

/// Reports, and the root mean square error of the positions as a share of the path.
fn walk(simulation: &Simulation, with_imu: bool) -> (Vec<OdometryReport>, f64) {
    let unit = simulation.imu_unit().unwrap();
    let samples = simulation.imu();
    let mut samples = samples.iter().peekable();
    let mut odometry = Odometry::new(OdometrySettings::default());
    let mut reports = Vec::new();
    for scan in simulation.scans(PoseSource::Truth) {
        while let Some(sample) = samples.next_if(|s| with_imu && s.time <= scan.time + 0.11) {
            let turn = |v: [f64; 3]| (unit.t_lidar_imu().rotation * nalgebra::Vector3::from(v)).into();
            odometry.add_imu(ImuSample {
                time: sample.time,
                angular_velocity: turn(sample.angular_velocity),
                acceleration: turn(sample.acceleration),
            });
        }
        reports.push(odometry.register(&scan.cloud, Some(scan.time)));
    }
    let truth = simulation.ground_truth();
    let first = reports[0].t_map_lidar;
    let square = |(r, t): (&OdometryReport, &Pose)| first.inv_mul(&r.t_map_lidar).translation_distance(&truth[0].inv_mul(t)).powi(2);
    let rms = (reports.iter().zip(truth).map(square).sum::<f64>() / reports.len() as f64).sqrt();
    let path: f64 = truth.windows(2).map(|p| p[0].translation_distance(&p[1])).sum();
    (reports, rms / path)
}

#[test]
fn a_shaken_sensor_is_tracked_with_its_inertial_unit() {
    let simulation = handheld("campus", 1, 120, 1.0);
    let truth = simulation.ground_truth();
    let (reports, with) = walk(&simulation, true);
    let (_, without) = walk(&simulation, false);
    println!("{:.3} % of the path with the unit, {:.3} % without", 100.0 * with, 100.0 * without);
    assert!(reports.iter().skip(1).all(|r| r.status == Status::Tracked));
    assert!(with < 0.004, "{} %", 100.0 * with);
    assert!(with < 0.7 * without, "{with} {without}");
    // Where up is in the lidar, against the truth, after ten seconds of shaking.
    let up = |pose: &Pose| pose.rotation.inverse() * nalgebra::Vector3::z();
    let off: Vec<f64> =
        reports.iter().zip(truth).filter_map(|(r, t)| Some((r.t_map_lidar.rotation.inverse() * r.vertical?.measured).angle(&up(t)))).collect();
    println!("verticals wrong by {off:.4?} radians");
    assert!(!off.is_empty() && off.iter().all(|angle| *angle < 0.012), "{off:?}");
}

/// A scan seen by a sensor that is tilted by roll and pitch (degrees) more than it was; also the direction up in its frame.
fn tilted(simulation: &Simulation, roll: f64, pitch: f64) -> (Cloud, nalgebra::Vector3<f64>) {
    let tilt = nalgebra::UnitQuaternion::from_euler_angles(roll.to_radians(), pitch.to_radians(), 0.0);
    let mut cloud = simulation.cloud(0).unwrap();
    cloud.points.iter_mut().filter(|p| p[0].is_finite()).for_each(|p| {
        *p = (tilt * nalgebra::Vector3::from(p.map(f64::from))).map(|v| v as f32).into();
    });
    (cloud, tilt * (simulation.ground_truth()[0].rotation.inverse() * nalgebra::Vector3::z()))
}

#[test]
fn the_map_is_levelled_by_gravity_or_by_ground_and_walls_or_not_at_all() {
    let still = |world: &str| simulation(SimOptions { scans: Some(1), columns: Some(512), ..SimOptions::of(world) });
    for (world, level, roll, pitch) in [
        ("room", Level::Surfaces, 12.0, -7.0),
        ("street", Level::Surfaces, -4.0, 3.0),
        ("campus", Level::Surfaces, 3.0, 6.0),
        ("plane", Level::Unknown, 5.0, 0.0),
        ("sphere", Level::Unknown, 5.0, 0.0),
    ] {
        let (cloud, up) = tilted(&still(world), roll, pitch);
        let mut odometry = Odometry::new(OdometrySettings::default());
        let pose = odometry.register(&cloud, Some(0.0)).t_map_lidar;
        let off = (pose.rotation * up).angle(&nalgebra::Vector3::z()).to_degrees();
        println!("{world}: {:?}, off by {off:.2} degrees", odometry.level());
        assert_eq!(odometry.level(), level, "{world}");
        assert!(if level == Level::Unknown { pose == Pose::identity() } else { off < 0.5 }, "{world}: {off} degrees");
    }
    // Gravity tells it on a plain, too, where the surfaces do not.
    let (cloud, up) = tilted(&still("plane"), 9.0, -14.0);
    let mut odometry = Odometry::new(OdometrySettings::default());
    let gravity: [f64; 3] = (up * 9.81).into();
    (0..20)
        .for_each(|k| odometry.add_imu(ImuSample { time: 0.01 * f64::from(k) - 0.19, angular_velocity: [0.01, 0.0, -0.02], acceleration: gravity }));
    let pose = odometry.register(&cloud, Some(0.0)).t_map_lidar;
    assert_eq!(odometry.level(), Level::Gravity);
    assert!((pose.rotation * up).angle(&nalgebra::Vector3::z()) < 1e-6);
}

#[test]
fn an_odometry_that_was_stored_goes_on_as_if_nothing_had_happened() {
    let simulation = handheld("room", 5, 24, 1.0);
    let scans: Vec<_> = simulation.scans(PoseSource::Truth).collect();
    let mut samples = simulation.imu().into_iter().peekable();
    let inputs: Vec<(Vec<ImuSample>, _)> =
        scans.iter().map(|scan| (std::iter::from_fn(|| samples.next_if(|sample| sample.time <= scan.time + 0.1)).collect(), scan)).collect();
    let track = |every: usize| {
        let mut odometry = Odometry::new(OdometrySettings::default());
        let register = |(k, (imu, scan)): (usize, &(Vec<ImuSample>, &Scan))| {
            if k % every == every - 1 {
                let bytes = postcard::to_stdvec(&odometry.state()).unwrap();
                odometry = Odometry::resume(OdometrySettings::default(), postcard::from_bytes(&bytes).unwrap());
            }
            imu.iter().for_each(|sample| odometry.add_imu(*sample));
            let report = odometry.register(&scan.cloud, Some(scan.time));
            (report.t_map_lidar, report.motion, report.score, report.level)
        };
        inputs.iter().enumerate().map(register).collect::<Vec<_>>()
    };
    let whole = track(usize::MAX);
    for every in [1, 2, 7] {
        assert!(track(every) == whole, "stored before every {every}th scan");
    }
}

/// A scan of a still sensor.
fn scan_at(simulation: &Simulation, pose: Pose, noise: u64) -> Cloud {
    simulation.lidar().scan(simulation.world(), |_| pose, &Stream::new(noise, &[1]))
}

/// A small random motion of the sensor.
fn random_motion(numbers: &mut Stream) -> Pose {
    let [x, y, z, yaw, roll, pitch] = std::array::from_fn(|_| numbers.range(-1.0, 1.0));
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.05 * roll, 0.05 * pitch, 0.15 * yaw);
    Pose::from_parts(nalgebra::Translation3::new(0.5 * x, 0.5 * y, 0.1 * z), turn)
}

/// Squared errors of random motions in units of what the registrations say of themselves, a sixth of it: 1 on average if they are honest.
fn normalised_errors(world: &str, seeds: std::ops::Range<u64>) -> Vec<f64> {
    let of_world = |seed: u64| {
        let simulation = simulation(SimOptions { columns: Some(512), seed, ..SimOptions::of(world) });
        let mut numbers = Stream::new(seed, &[3]);
        let first = simulation.scene().trajectory.pose(numbers.range(0.0, 10.0)) * random_motion(&mut numbers);
        let second = first * random_motion(&mut numbers);
        let mut odometry = Odometry::new(OdometrySettings::default());
        let t_map_first = odometry.register(&scan_at(&simulation, first, 2 * seed), None).t_map_lidar;
        let report = odometry.register(&scan_at(&simulation, second, 2 * seed + 1), None);
        let off = t_map_first.inv_mul(&report.t_map_lidar).inv_mul(&first.inv_mul(&second));
        let (t, r) = (off.translation.vector, off.rotation.scaled_axis());
        assert!(report.status == Status::Tracked && t.norm() < 0.1 && r.norm() < 0.02, "{world} {seed}: {} m, {} rad", t.norm(), r.norm());
        let error = nalgebra::Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z);
        error.dot(&(report.information * error)) / 6.0
    };
    seeds.map(of_world).collect()
}

#[test]
fn registrations_recover_known_motions_within_their_own_covariance() {
    for world in ["room", "street", "campus"] {
        let errors = normalised_errors(world, 1..25);
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let beyond = errors.iter().filter(|e| **e > 3.0).count();
        println!("{world}: mean squared error {mean:.2} of what the registrations say, {beyond} of {} beyond 3", errors.len());
        assert!((0.5..2.0).contains(&mean) && beyond <= 3, "{world}: {mean}, {beyond}");
    }
}

/// `hall`, whose scans are a second apart, with its sensor rolled onto its side, and nose down by 45 degrees. Headings that turn about the sensor's axis lost it.
#[test]
fn a_sensor_on_its_side_is_tracked_as_an_upright_one() {
    let Some(folder) = voxelastic_testing::data("hall") else { return };
    let hall = voxelastic_io::dataset::open(&folder, &voxelastic_io::OpenOptions::default()).unwrap();
    let scans: Vec<Scan> =
        hall.events().filter_map(|event| if let Event::Scan(scan) = event.unwrap() { Some(scan) } else { None }).take(30).collect();
    for mount in [nalgebra::Vector3::new(90f64.to_radians(), 0.0, 0.0), nalgebra::Vector3::new(0.0, 45f64.to_radians(), 0.0)] {
        let mount = Pose::rotation(mount);
        let back = Rigid::from(&mount.inverse());
        let mut odometry = Odometry::new(OdometrySettings::default());
        let mut first = None;
        for scan in &scans {
            let points = scan.cloud.points.iter().map(|p| if Cloud::is_return(p) { back.apply(*p) } else { *p }).collect();
            let found = odometry.register(&Cloud::from_points(points), Some(scan.time)).t_map_lidar;
            let (found_first, true_first) = *first.get_or_insert((found, scan.t_map_lidar * mount));
            let off = (found_first.inv_mul(&found)).translation_distance(&true_first.inv_mul(&(scan.t_map_lidar * mount)));
            assert!(off < 0.2, "scan {}: {off} m", scan.node);
        }
    }
}
