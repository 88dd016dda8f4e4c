//! Recordings read back as the scans and samples that were written.

use std::ops::ControlFlow;
use voxelastic::geometry::Rigid;
use voxelastic_io::{OpenOptions, raw};
use voxelastic_sim::imu::ImuSettings;
use voxelastic_sim::sensor::LidarSettings;
use voxelastic_sim::{SimOptions, Simulation};

#[test]
fn a_recording_reads_back_as_what_was_simulated() {
    let dir = tempfile::tempdir().unwrap();
    let options = SimOptions {
        columns: Some(128),
        scans: Some(6),
        rate: Some(10.0),
        carrier: Some("handheld".into()),
        lidar: LidarSettings { moving: true, ..LidarSettings::default() },
        imu: Some(ImuSettings { rate: 200.0, ..ImuSettings::default() }),
        ..SimOptions::of("room")
    };
    let simulation = Simulation::new(options).unwrap();
    let written = simulation.write_as_recording(dir.path(), &mut |_, _| ControlFlow::Continue(())).unwrap();
    assert_eq!(written, 6);
    let scans = raw::open(dir.path(), &OpenOptions::default()).unwrap();
    let mut samples = Vec::new();
    for (k, scan) in scans.iter().enumerate() {
        let scan = scan.unwrap();
        let truth = simulation.cloud(k).unwrap();
        assert!((scan.time - simulation.times()[k]).abs() < 1e-9);
        let bits = |points: &[[f32; 3]]| points.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
        assert_eq!(bits(&scan.cloud.points), bits(&truth.points));
        let off = scan.cloud.time.unwrap().iter().zip(truth.time.unwrap()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 1e-8, "{off} s, single precision at 0.1 s");
        assert_eq!((scan.cloud.intensity, scan.cloud.ring), (truth.intensity, truth.ring));
        samples.extend(scan.imu);
    }
    let expected = simulation.imu();
    assert_eq!(samples.len(), expected.len(), "all come, the last with the last scan");
    let turn = Rigid::from(simulation.imu_unit().unwrap().t_lidar_imu());
    for (a, b) in samples.iter().zip(&expected) {
        assert!((a.time - b.time).abs() < 1e-9);
        // Readers turn the axes into the lidar's.
        let at_lidar = turn.rotate(b.angular_velocity.map(|v| v as f32));
        assert!((0..3).all(|i| (a.angular_velocity[i] - f64::from(at_lidar[i])).abs() < 1e-5), "{a:?} {b:?}");
    }
}

/// A folder gives the same scans and samples as a recording, and damaged samples are named.
#[test]
fn a_folder_reads_back_as_the_recording() {
    let dir = tempfile::tempdir().unwrap();
    let options = SimOptions {
        columns: Some(64),
        scans: Some(5),
        rate: Some(10.0),
        rest: 0.2,
        lidar: LidarSettings { moving: true, ..LidarSettings::default() },
        imu: Some(ImuSettings::default()),
        ..SimOptions::of("room")
    };
    let simulation = Simulation::new(options).unwrap();
    let go = &mut |_, _| ControlFlow::Continue(());
    simulation.write(dir.path().join("folder"), go).unwrap();
    simulation.write_as_recording(dir.path().join("bag"), go).unwrap();
    let samples = |what: &str| {
        let scans = raw::open(dir.path().join(what), &OpenOptions::default()).unwrap();
        scans.iter().map(|scan| scan.unwrap().imu).collect::<Vec<_>>()
    };
    let (folder, bag) = (samples("folder"), samples("bag"));
    assert_eq!(folder.iter().map(Vec::len).collect::<Vec<_>>(), bag.iter().map(Vec::len).collect::<Vec<_>>());
    for (a, b) in folder.iter().flatten().zip(bag.iter().flatten()) {
        assert!((a.time - b.time).abs() < 1e-8 && (a.acceleration[2] - b.acceleration[2]).abs() < 1e-3, "{a:?} {b:?}");
    }
    let exact = OpenOptions { use_imu: false, ..OpenOptions::default() };
    assert!(raw::open(dir.path().join("bag"), &exact).unwrap().iter().all(|scan| scan.unwrap().imu.is_empty()));
    let path = dir.path().join("folder/imu/samples.csv");
    let (pose, read) = voxelastic_io::imu_csv::read(&path).unwrap();
    assert_eq!((pose, &read), (*simulation.imu_unit().unwrap().t_lidar_imu(), &simulation.imu()));
    let text = std::fs::read_to_string(&path).unwrap();
    for (from, to, word) in [("\n0.01,", "\n0,", "line 4"), ("\n0.02,", "\nup,", "time"), ("t_lidar_imu 0.05", "t_lidar_imu", "line 1")] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let message = raw::open(dir.path().join("folder"), &OpenOptions::default()).unwrap_err().to_string();
        assert!(message.contains(word), "{word}: {message}");
    }
}

/// A unit beside the axis of a turn feels what the lidar does not: readers take that away.
#[test]
fn readers_move_the_samples_to_the_lidar() {
    let dir = tempfile::tempdir().unwrap();
    let walk = |imu: ImuSettings| {
        let options = SimOptions {
            columns: Some(64),
            scans: Some(20),
            rate: Some(10.0),
            carrier: Some("handheld".into()),
            lidar: LidarSettings { moving: true, ..LidarSettings::default() },
            imu: Some(imu),
            ..SimOptions::of("plane")
        };
        Simulation::new(options).unwrap()
    };
    let beside = ImuSettings { position: [0.4, -0.3, 0.2], rotation_deg: [180.0, 0.0, 90.0], ..ImuSettings::exact(400.0) };
    walk(beside).write(dir.path().join("beside"), &mut |_, _| ControlFlow::Continue(())).unwrap();
    let scans = raw::open(dir.path().join("beside"), &OpenOptions::default()).unwrap();
    let moved: Vec<_> = scans.iter().flat_map(|scan| scan.unwrap().imu).collect();
    let at_lidar = walk(ImuSettings::exact(400.0)).imu();
    let (mut off, mut raw_off) = (0.0, 0.0);
    for ((a, b), raw) in moved.iter().zip(&at_lidar).zip(walk(beside).imu()).skip(2) {
        let apart = |v: [f64; 3]| (0..3).map(|k| (v[k] - b.acceleration[k]).powi(2)).sum::<f64>();
        assert!((0..3).all(|k| (a.angular_velocity[k] - b.angular_velocity[k]).abs() < 1e-9));
        off += apart(a.acceleration);
        raw_off += apart([raw.acceleration[1], raw.acceleration[0], -raw.acceleration[2]]);
    }
    assert!(off < 0.02 * raw_off, "{off} of {raw_off}");
}
