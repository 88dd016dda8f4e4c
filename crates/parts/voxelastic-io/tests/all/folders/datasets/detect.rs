//! What is found without flags, and with them.

use super::*;
use voxelastic_io::dataset::{Keyframing, MatchedBy};
use voxelastic_io::{Error, PoseKind, g2o};

#[test]
fn clouds_in_any_of_the_usual_places() {
    for place in ["scans/", "Scans/", "velodyne/", "clouds/", ""] {
        let folder = Folder::new();
        (0..12).for_each(|k| folder.cloud(&format!("{place}s{k}.pcd"), k));
        folder.tum("trajectory.txt", 12, 0.0, 0.1, 0.0);
        let dataset = folder.open().unwrap();
        assert_eq!(dataset.scans().len(), 12, "{place}");
        // s10 comes after s9, not after s1.
        assert_eq!(dataset.scans()[10].path.file_name().unwrap(), "s10.pcd");
        assert_eq!(dataset.scans()[10].time, 1.0);
        assert_eq!(xs(&dataset)[10], 20.0);
    }
}

#[test]
fn poses_of_every_format() {
    type Write<'a> = &'a dyn Fn(&Folder);
    let formats: [(&str, Write<'_>); 4] = [
        ("TUM", &|f| f.tum("p.txt", 3, 0.0, 1.0, 0.0)),
        ("KITTI rows", &|f| f.kitti("p.txt", 3, 0.0)),
        ("Newer College CSV", &|f| f.text("p.csv", "#sec,nsec,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,0,1\n2,0,2,0,0,0,0,0,1\n3,0,4,0,0,0,0,0,1\n")),
        ("g2o vertices", &|f| g2o::write(f.file("p.g2o"), &graph(&[0, 1, 2], &[])).unwrap()),
    ];
    for (name, write) in formats {
        let folder = Folder::with_scans(3);
        write(&folder);
        let dataset = folder.open().unwrap();
        assert_eq!(xs(&dataset), [0.0, 2.0, 4.0]);
        let used = dataset.description().poses.clone().unwrap();
        assert_eq!((used.format.to_string().as_str(), used.matched_by), (name, MatchedBy::Order));
    }
}

#[test]
fn several_pose_files_are_ambiguous() {
    let folder = Folder::with_scans(2);
    folder.kitti("odometry.txt", 2, 0.0);
    folder.kitti("slam_poses.txt", 2, 10.0);
    folder.kitti("groundtruth_poses.txt", 2, 20.0);
    g2o::write(folder.file("graph.g2o"), &graph(&[0, 1], &[])).unwrap();
    let error = folder.open().unwrap_err();
    let Error::Ambiguous { choices, .. } = &error else { panic!("{error}") };
    assert_eq!(choices, &["graph.g2o", "groundtruth_poses.txt", "odometry.txt", "slam_poses.txt"]);
    assert!(error.to_string().contains("--poses") && error.remedy().contains("--poses"));

    for (asked, x) in [("odom", 0.0), ("odometry.txt", 0.0), ("slam_poses", 10.0), ("ground-truth", 20.0), ("graph", 0.0)] {
        assert_eq!(xs(&folder.open_with(with_poses(asked)).unwrap())[0], x, "{asked}");
    }
    let by_path = folder.file("slam_poses.txt");
    assert_eq!(xs(&folder.open_with(with_poses(by_path.to_str().unwrap())).unwrap())[0], 10.0);

    assert!(matches!(folder.open_with(with_poses("poses")), Err(Error::Ambiguous { choices, .. }) if choices.len() == 2));
    let error = folder.open_with(with_poses("unknown")).unwrap_err().to_string();
    assert!(error.contains("odometry.txt"), "{error}");
}

#[test]
fn poses_before_and_after_optimisation_of_one_system() {
    // SC-A-LOAM, SC-LIO-SAM, FAST-LIO-SLAM.
    let folder = Folder::with_scans(2);
    folder.kitti("odom_poses.txt", 2, 0.0);
    folder.kitti("optimized_poses.txt", 2, 10.0);
    folder.kitti("groundtruth_poses.txt", 2, 20.0);
    g2o::write(folder.file("singlesession_posegraph.g2o"), &graph(&[0, 1], &[])).unwrap();
    folder.text("times.txt", "0.0\n0.5\n");

    let optimised = folder.open().unwrap();
    assert_eq!((xs(&optimised)[0], optimised.scans()[1].time), (10.0, 0.5));
    assert_eq!(optimised.ground_truth().unwrap().t_map_lidar[0].unwrap().translation.x, 20.0);
    let described = optimised.description().to_string();
    assert!(described.contains("poses: optimized_poses.txt") && described.contains("odom_poses.txt are not used"), "{described}");

    let odometry = folder.open_with(OpenOptions { pose_kind: PoseKind::Odometry, ..OpenOptions::default() }).unwrap();
    assert_eq!(xs(&odometry)[0], 0.0);
    let described = odometry.description().to_string();
    assert!(described.contains("poses: odom_poses.txt") && described.contains("graph: singlesession_posegraph.g2o"), "{described}");
    assert_eq!(xs(&folder.open_with(with_poses("groundtruth")).unwrap())[0], 20.0, "a request comes first");

    // A third estimate is not part of that layout.
    folder.kitti("poses_v2.txt", 2, 30.0);
    assert!(matches!(folder.open(), Err(Error::Ambiguous { choices, .. }) if choices.len() == 5));
}

#[test]
fn ground_truth_is_not_used_as_poses() {
    let folder = Folder::with_scans(3);
    folder.kitti("poses.txt", 3, 0.0);
    folder.kitti("groundtruth.txt", 3, 1.0);
    let mut dataset = folder.open().unwrap();
    assert_eq!(xs(&dataset), [0.0, 2.0, 4.0]);
    dataset.retain(|scan| scan.index != 1);
    let truth = dataset.ground_truth().unwrap();
    assert_eq!(truth.t_map_lidar.iter().map(|p| p.unwrap().translation.x).collect::<Vec<_>>(), [1.0, 5.0]);
    assert!(dataset.description().to_string().contains("ground truth: groundtruth.txt, not used as poses"));

    // Only the name `poses` is preferred to ground truth.
    std::fs::rename(folder.file("poses.txt"), folder.file("odometry.txt")).unwrap();
    assert!(matches!(folder.open(), Err(Error::Ambiguous { .. })));
    std::fs::remove_file(folder.file("odometry.txt")).unwrap();
    let dataset = folder.open().unwrap();
    assert!(dataset.description().to_string().contains("groundtruth.txt (ground truth)"));
}

#[test]
fn newer_college_clouds_match_by_time() {
    let folder = Folder::new();
    for (k, nsec) in [82_590_976u32, 182_590_976, 282_592_512].iter().enumerate() {
        folder.cloud(&format!("raw/cloud_1583836591_{nsec}.pcd"), k);
    }
    std::fs::rename(folder.file("raw"), folder.file("scans")).unwrap();
    folder.text(
        "registered_poses.csv",
        "#sec,nsec,x,y,z,qx,qy,qz,qw\n1583836591,82590976,0,0,0,0,0,0,1\n1583836591,282592512,4,0,0,0,0,0,1\n1583836599,0,9,0,0,0,0,0,1\n",
    );
    let dataset = folder.open().unwrap();
    assert_eq!(xs(&dataset), [0.0, 4.0]);
    assert!((dataset.scans()[1].time - 1_583_836_591.282_592_5).abs() < 1e-6);
    let described = dataset.description();
    assert_eq!(described.poses.as_ref().unwrap().matched_by, MatchedBy::Time);
    assert_eq!((described.without_pose.len(), described.poses.as_ref().unwrap().unused), (1, 1));
    assert!(described.to_string().contains("skipped: 1 clouds without a pose, the first is cloud_1583836591_182590976.pcd"), "{described}");
    let strict = folder.open_with(OpenOptions { strict: true, ..OpenOptions::default() });
    assert!(strict.unwrap_err().to_string().contains("1 clouds have no pose"));
}

#[test]
fn times_txt_gives_times_and_matches_by_them() {
    let folder = Folder::with_scans(3);
    folder.kitti("poses.txt", 3, 0.0);
    folder.text("times.txt", "0.0\n0.5\n1.5\n");
    assert_eq!(folder.open().unwrap().scans()[2].time, 1.5);

    let folder = Folder::with_scans(3);
    folder.tum("poses.tum", 20, 0.0, 0.1, 0.0); // x = 20 t
    folder.text("times.txt", "0.1\n0.55\n1.5\n");
    let found = xs(&folder.open().unwrap());
    assert!(found.iter().zip([2.0, 11.0, 30.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
}

#[test]
fn fewer_scans_on_request() {
    let folder = Folder::with_scans(10);
    folder.kitti("poses.txt", 10, 0.0);
    let open = |every| folder.open_with(OpenOptions { keyframing: Some(every), ..OpenOptions::default() }).unwrap();
    assert_eq!(xs(&open(Keyframing::Metres(5.0))), [0.0, 6.0, 12.0, 18.0]);
    let thinned = open(Keyframing::Nth(4));
    assert_eq!(xs(&thinned), [0.0, 8.0, 16.0]);
    assert!(thinned.description().to_string().contains("not taken: 7 scans"));
    assert_eq!(story(&thinned), "S0 S4 O0-4 S8 O4-8");
}

#[test]
fn other_files_are_ignored() {
    let folder = Folder::with_scans(2);
    folder.tum("poses.tum", 2, 0.0, 1.0, 0.0);
    folder.text("calib.txt", "P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n");
    folder.text("README.txt", "A drive.\nTwo scans.\n");
    folder.text("labels.csv", "1,2\n3,4\n");
    folder.text(".hidden.tum", "0 0 0 0 0 0 0 1\n");
    folder.cloud("map.pcd", 0);
    folder.text("scans/notes.txt", "none");
    assert_eq!(folder.open().unwrap().scans().len(), 2);
}
