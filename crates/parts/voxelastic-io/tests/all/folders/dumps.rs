//! Folders of SLAM systems and data sets, made small: the poses and clouds that come out are those that went in.

use nalgebra::{Translation3, UnitQuaternion};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use voxelastic::event::Event;
use voxelastic::geometry::PoseExt;
use voxelastic::{Cloud, Pose};
use voxelastic_io::survey::{SurveyCloud, e57};
use voxelastic_io::{OpenOptions, PoseGraph, dataset, g2o, pcd, source};

fn pose(k: usize) -> Pose {
    let k = k as f64;
    Pose::from_parts(Translation3::new(2.0 * k, 0.1 * k, 0.0), UnitQuaternion::from_euler_angles(0.01, 0.02, 0.3 * k))
}

fn cloud(k: usize) -> Cloud {
    Cloud::from_points((0..50).map(|i| [1.0 + i as f32, k as f32, -1.0]).collect())
}

/// `rows` rows of a pose's matrix.
fn matrix(pose: &Pose, rows: usize, separator: &str) -> String {
    let m = pose.to_homogeneous();
    (0..rows).map(|i| (0..4).map(|j| format!("{}", m[(i, j)])).collect::<Vec<_>>().join(" ")).collect::<Vec<_>>().join(separator)
}

fn floats(k: usize, with_intensity: bool) -> Vec<u8> {
    let points = cloud(k).points;
    points.iter().flat_map(|p| p.iter().copied().chain(with_intensity.then_some(0.5)).collect::<Vec<f32>>()).flat_map(f32::to_le_bytes).collect()
}

/// Scans of a folder: node, time, pose.
fn check(folder: &Path, expected: &[(u64, f64)], said: &str) {
    let dataset = dataset::open(folder, &OpenOptions { strict: true, ..OpenOptions::default() }).unwrap();
    let description = dataset.description().to_string();
    assert!(description.contains(said), "{description}");
    let mut scans = 0;
    for event in dataset.events() {
        if let Event::Scan(scan) = event.unwrap() {
            let (node, time) = expected[scans];
            assert_eq!(scan.node, node);
            assert!((scan.time - time).abs() < 1e-6, "{} is not {time}", scan.time);
            let off = (scan.t_map_lidar.translation_distance(&pose(scans)), scan.t_map_lidar.rotation_distance(&pose(scans)));
            assert!(off.0 < 1e-6 && off.1 < 1e-6, "{said}, scan {scans}: {off:?}");
            assert_eq!(scan.cloud.points, cloud(scans).points);
            scans += 1;
        }
    }
    assert_eq!(scans, expected.len());
}

#[test]
fn hdl_graph_slam() {
    let dir = tempfile::tempdir().unwrap();
    for k in 0..3 {
        let folder = dir.path().join(format!("{k:06}"));
        pcd::write(folder.join("cloud.pcd"), &cloud(k)).unwrap();
        let (estimate, odom) = (matrix(&pose(k), 4, "\n"), matrix(&Pose::identity(), 4, "\n"));
        let data = format!("stamp {} 500000000\nestimate\n{estimate}\nodom\n{odom}\naccum_distance {k}\nid {}\n", 1000 + k, 10 * k);
        fs::write(folder.join("data"), data).unwrap();
    }
    let edge = |from, to| voxelastic::event::Edge { from, to, t_from_to: Pose::identity(), information: None };
    let nodes = (0..3).map(|k| (10 * k as u64, pose(k))).collect();
    g2o::write(dir.path().join("graph.g2o"), &PoseGraph { nodes, edges: vec![edge(0, 10), edge(10, 20), edge(0, 20)], ..PoseGraph::default() })
        .unwrap();
    check(dir.path(), &[(0, 1000.5), (10, 1001.5), (20, 1002.5)], "hdl_graph_slam dump");
    assert_eq!(dataset::open(dir.path(), &OpenOptions::default()).unwrap().loop_edges().len(), 1);

    fs::write(dir.path().join("000001/data"), "stamp 1 2\nestimate\n1 0 0 zero").unwrap();
    let error = dataset::open(dir.path(), &OpenOptions::default()).unwrap_err().to_string();
    assert!(error.contains("000001") && error.contains("line 3") && error.contains("\"zero\" is not a number"), "{error}");
}

#[test]
fn glim() {
    let dir = tempfile::tempdir().unwrap();
    for k in 0..2 {
        let folder = dir.path().join(format!("{k:06}"));
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("points_compact.bin"), floats(k, false)).unwrap();
        let still = matrix(&Pose::identity(), 4, "\n");
        let mut data = format!("id: {k}\nT_world_origin: \n{}\nT_origin_endpoint_L: \n{still}\nnum_frames: 3\n", matrix(&pose(k), 4, "\n"));
        for frame in 0..3 {
            writeln!(data, "frame_{frame}\nid: {frame}\nstamp: {}.250000000\nT_odom_lidar: \n{still}", 10 * k + frame).unwrap();
        }
        fs::write(folder.join("data.txt"), data).unwrap();
    }
    check(dir.path(), &[(0, 1.25), (1, 11.25)], "GLIM dump");
}

#[test]
fn balm_and_hba() {
    let dir = tempfile::tempdir().unwrap();
    let mut text = String::new();
    for k in 0..12 {
        pcd::write(dir.path().join(format!("pcd/{k}.pcd")), &cloud(k)).unwrap();
        let (t, q) = (pose(k).translation.vector, pose(k).rotation);
        writeln!(text, "{} {} {} {} {} {} {}", t.x, t.y, t.z, q.w, q.i, q.j, q.k).unwrap();
    }
    fs::write(dir.path().join("pose.json"), text).unwrap();
    let expected: Vec<(u64, f64)> = (0..12).map(|k| (k, k as f64)).collect();
    check(dir.path(), &expected, "BALM / HBA folder");
    fs::remove_file(dir.path().join("pcd/3.pcd")).unwrap();
    assert!(dataset::open(dir.path(), &OpenOptions::default()).unwrap_err().to_string().contains("12 poses for 11 clouds"));
}

#[test]
fn kitti_odometry_as_downloaded() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequences/07");
    fs::create_dir_all(sequence.join("velodyne")).unwrap();
    fs::create_dir_all(dir.path().join("poses")).unwrap();
    // The camera looks along the lidar's x.
    let t_camera_lidar = Pose::from_parts(Translation3::new(0.0, -0.1, -0.3), UnitQuaternion::from_euler_angles(-1.5, 1.4, 0.1));
    let p0 = "1 0 0 0 0 1 0 0 0 0 1 0";
    fs::write(sequence.join("calib.txt"), format!("P0: {p0}\nTr: {}\n", matrix(&t_camera_lidar, 3, " "))).unwrap();
    fs::write(sequence.join("times.txt"), "0.0\n0.1\n0.2\n").unwrap();
    let camera = |k| t_camera_lidar * pose(k) * t_camera_lidar.inverse();
    fs::write(dir.path().join("poses/07.txt"), (0..3).map(|k| matrix(&camera(k), 3, " ") + "\n").collect::<String>()).unwrap();
    (0..3).for_each(|k| fs::write(sequence.join(format!("velodyne/{k:06}.bin")), floats(k, true)).unwrap());
    check(&sequence, &[(0, 0.0), (1, 0.1), (2, 0.2)], "KITTI odometry sequence");
}

#[test]
fn mulran() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("Ouster")).unwrap();
    let mounting = Pose::from_parts(
        Translation3::new(1.7042, -0.021, 1.8047),
        UnitQuaternion::from_euler_angles(0.0001f64.to_radians(), 0.0003f64.to_radians(), 179.6654f64.to_radians()),
    );
    // The first pose of the vehicle is the origin of the map.
    let base = |k: usize| pose(k) * mounting.inverse();
    let origin = base(0).translation.vector;
    let mut text = String::new();
    for k in 0..3usize {
        let mut p = base(k);
        p.translation.vector += nalgebra::Vector3::new(353_000.0, 4_026_000.0, 19.0);
        writeln!(text, "{},{}", 1_560_000_000_000_000_000u64 + k as u64 * 100_000_000, matrix(&p, 3, " ").replace(' ', ",")).unwrap();
        fs::write(dir.path().join(format!("Ouster/{}.bin", 1_560_000_000_000_000_000u64 + k as u64 * 100_000_000)), floats(k, true)).unwrap();
    }
    fs::write(dir.path().join("global_pose.csv"), text).unwrap();
    let dataset = dataset::open(dir.path(), &OpenOptions::default()).unwrap();
    assert!(dataset.description().to_string().contains("MulRan sequence"));
    assert_eq!(dataset.scans().len(), 3);
    for (k, scan) in dataset.scans().iter().enumerate() {
        let expected = Pose::from_parts((pose(k).translation.vector - origin).into(), pose(k).rotation);
        assert!(scan.t_map_lidar.translation_distance(&expected) < 1e-6 && scan.t_map_lidar.rotation_distance(&expected) < 1e-6, "{k}");
    }
}

#[test]
fn newer_college() {
    let dir = tempfile::tempdir().unwrap();
    let mounting =
        Pose::from_parts(Translation3::new(-0.084, -0.025, 0.05), UnitQuaternion::from_euler_angles(0.0, 0.0, 2.0 * 0.924f64.atan2(0.383)));
    let (mut text, mut with_spaces) = ("#sec,nsec,x,y,z,qx,qy,qz,qw\n".to_owned(), String::new());
    fs::create_dir(dir.path().join("ground_truth")).unwrap();
    for k in 0..3 {
        let camera = pose(k) * mounting.inverse();
        let (t, q) = (camera.translation.vector, camera.rotation);
        writeln!(text, "{},500000000,{},{},{},{},{},{},{}", 1_583_836_590 + k, t.x, t.y, t.z, q.i, q.j, q.k, q.w).unwrap();
        writeln!(with_spaces, "{}.500000 {} {} {} {} {} {} {}", 1_583_836_590 + k, t.x, t.y, t.z, q.i, q.j, q.k, q.w).unwrap();
        pcd::write(dir.path().join(format!("raw_format/ouster_scan/cloud_{}_500000000.pcd", 1_583_836_590 + k)), &cloud(k)).unwrap();
    }
    // The second is how the sequence of the mound has them.
    for text in [text, with_spaces] {
        fs::write(dir.path().join("ground_truth/registered_poses.csv"), text).unwrap();
        check(dir.path(), &[(0, 1_583_836_590.5), (1, 1_583_836_591.5), (2, 1_583_836_592.5)], "Newer College sequence");
    }
    fs::write(dir.path().join("ground_truth/registered_poses.csv"), "1 0 0 0 0 1 0 0 0 0 1 0\n").unwrap();
    let refused = dataset::open(dir.path(), &OpenOptions::default()).unwrap_err().to_string();
    assert!(refused.contains("poses without times"), "{refused}");
}

fn station(k: usize, t_map_scan: Pose) -> e57::E57Scan {
    e57::E57Scan { name: None, t_map_scan, survey: SurveyCloud { cloud: cloud(k), ..SurveyCloud::default() } }
}

#[test]
fn stations_of_a_laser_scanner_are_scans() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("site.e57");
    e57::write(&file, &(0..4).map(|k| station(k, pose(k))).collect::<Vec<_>>()).unwrap();
    check(&file, &[(0, 0.0), (1, 1.0), (2, 2.0), (3, 3.0)], "laser scans (E57)");
    let source = source::open(&file, &OpenOptions::default()).unwrap();
    assert_eq!(source.scans(), Some(4));
    assert_eq!(source.clouds().cloud(2).unwrap().points, cloud(2).points);
    // In a country's coordinates: a run gives the map an origin, as behind every door.
    let far = |k: usize| Pose::translation(453_111.0, 5_421_222.0, 80.0) * pose(k);
    e57::write(&file, &[station(0, far(0)), station(1, far(1))]).unwrap();
    let dataset = dataset::open(&file, &OpenOptions::default()).unwrap();
    assert!((dataset.scans()[1].t_map_lidar.translation.vector - nalgebra::Vector3::new(453_113.0, 5_421_222.1, 80.0)).norm() < 1e-6);
    // Scans all at one place are a cloud in pieces, and poses of another file are not taken.
    e57::write(&file, &[station(0, Pose::identity()), station(1, Pose::identity())]).unwrap();
    let refused = |options: &OpenOptions| dataset::open(&file, options).unwrap_err().to_string();
    assert!(refused(&OpenOptions::default()).contains("do not say where they were taken"));
    assert!(refused(&OpenOptions { poses: Some("a.tum".into()), ..OpenOptions::default() }).contains("its own poses"));
}

#[test]
fn kitti_raw_with_the_poses_of_its_imu() {
    let dir = tempfile::tempdir().unwrap();
    let drive = dir.path().join("2011_09_26/2011_09_26_drive_0001_sync");
    fs::create_dir_all(drive.join("velodyne_points/data")).unwrap();
    fs::create_dir_all(drive.join("oxts/data")).unwrap();
    // Any mounting will do: the lidar behind and above the IMU.
    let t_lidar_imu = Pose::from_parts(Translation3::new(-0.8, 0.3, -0.8), UnitQuaternion::from_euler_angles(0.01, 0.02, -0.03));
    let r = t_lidar_imu.rotation.to_rotation_matrix();
    let rows = r.matrix().transpose().iter().map(|v| format!("{v:.12}")).collect::<Vec<_>>().join(" ");
    fs::write(dir.path().join("2011_09_26/calib_imu_to_velo.txt"), format!("calib_time: 1\nR: {rows}\nT: -0.8 0.3 -0.8\n")).unwrap();
    let (latitude, longitude, altitude) = (49.0f64, 8.4f64, 116.0f64);
    let metres_per_degree = latitude.to_radians().cos() * 6_378_137.0 * std::f64::consts::PI / 180.0;
    // The IMU goes east and turns.
    let imu = |k: usize| {
        Pose::from_parts(Translation3::new(2.0 * k as f64, 0.0, 0.1 * k as f64), UnitQuaternion::from_euler_angles(0.01, 0.02, 0.1 * k as f64))
    };
    let mut stamps = String::new();
    for k in 0..3 {
        let (t, (roll, pitch, yaw)) = (imu(k).translation.vector, imu(k).rotation.euler_angles());
        let oxts = format!("{latitude} {:.12} {} {roll} {pitch} {yaw} {}", longitude + t.x / metres_per_degree, altitude + t.z, "0 ".repeat(24));
        fs::write(drive.join(format!("oxts/data/{k:010}.txt")), oxts).unwrap();
        fs::write(drive.join(format!("velodyne_points/data/{k:010}.bin")), floats(k, true)).unwrap();
        writeln!(stamps, "2011-09-26 13:02:25.{}00000000", k + 1).unwrap();
    }
    fs::write(drive.join("velodyne_points/timestamps.txt"), &stamps).unwrap();
    fs::write(drive.join("oxts/timestamps.txt"), &stamps).unwrap();
    let dataset = dataset::open(&drive, &OpenOptions::default()).unwrap();
    assert!(dataset.description().to_string().contains("KITTI raw drive"), "{}", dataset.description());
    let lidar = |k: usize| imu(k) * t_lidar_imu.inverse();
    for (k, scan) in dataset.scans().iter().enumerate() {
        let expected = lidar(0).inv_mul(&lidar(k));
        let off = (scan.t_map_lidar.translation_distance(&expected), scan.t_map_lidar.rotation_distance(&expected));
        assert!(off.0 < 1e-4 && off.1 < 1e-7, "{k}: {off:?}");
        assert_eq!(scan.node, k as u64);
    }
    assert!((dataset.scans()[2].time - dataset.scans()[0].time - 0.2).abs() < 1e-6);
    fs::remove_file(dir.path().join("2011_09_26/calib_imu_to_velo.txt")).unwrap();
    assert!(dataset::open(&drive, &OpenOptions::default()).unwrap().description().to_string().contains("no calib_imu_to_velo.txt"));
    fs::write(drive.join("oxts/data/0000000001.txt"), "49.0 8.4 x").unwrap();
    let error = dataset::open(&drive, &OpenOptions::default()).unwrap_err().to_string();
    assert!(error.contains("line 1, field altitude"), "{error}");
    // Without the IMU's poses, the clouds can still be read.
    fs::remove_dir_all(drive.join("oxts")).unwrap();
    assert!(matches!(dataset::open(&drive, &OpenOptions::default()), Err(voxelastic_io::Error::NoPoses { .. })));
    assert_eq!(voxelastic_io::raw::open(&drive, &OpenOptions::default()).unwrap().count(), Some(3));
}
