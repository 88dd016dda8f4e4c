//! Bad folders and what each is answered.

use super::*;
use voxelastic_io::{Error, g2o};

#[test]
fn no_clouds_no_poses_no_folder() {
    let folder = Folder::new();
    assert!(folder.refusal().contains("no clouds in scans/"));
    folder.cloud("scans/0.pcd", 0);
    assert!(folder.refusal().contains("no poses"));
    folder.text("poses.txt", "");
    assert!(folder.refusal().contains("no poses"));
    folder.text("poses.txt", &"\0".repeat(4096));
    assert!(folder.refusal().contains("no poses"));
    assert!(matches!(dataset::open(folder.file("gone"), &OpenOptions::default()), Err(Error::Io { .. })));
    let error = dataset::open(folder.file("scans/0.pcd"), &OpenOptions::default()).unwrap_err().to_string();
    assert!(error.contains("a file, not a folder"), "{error}");
}

#[test]
fn poses_that_are_wrong_name_line_and_field() {
    let row = |t: &str, q: &str| format!("{t} 1 2 3 {q}\n");
    let good = |t: &str| row(t, "0 0 0 1");
    for (text, expected) in [
        (good("0") + &good("1") + &row("2", "0 0 0 2"), "poses.tum, line 3, field qx qy qz qw: the quaternion has length 2.0000, not 1"),
        (good("0") + &good("2") + &good("1"), "poses.tum, line 3, field time: 1 is not after 2 of line 2"),
        (good("0") + &good("1") + &good("1"), "line 3, field time"),
        (good("0") + &good("1") + &row("2", "0 0 0 one"), "line 3, field qw: \"one\" is not a number"),
        (good("0") + &good("1") + &row("2", "0 0 nan 1"), "line 3, field qz: nan is not finite"),
        (good("0") + &good("1") + "2 1 2 3 0 0", "line 3: 6 columns, not 8 (TUM); the file is truncated"),
        (good("0") + &good("1") + &row("2", "0 0 0 1 5"), "line 3: 9 columns, not 8 (TUM)"),
        (good("0") + &good("1"), "2 poses for 3 clouds"),
    ] {
        let folder = Folder::new();
        ["a", "b", "c"].iter().enumerate().for_each(|(k, n)| folder.cloud(&format!("scans/{n}.pcd"), k));
        folder.text("poses.tum", &text);
        let refusal = folder.refusal();
        assert!(refusal.contains(expected), "{text}: {refusal}");
    }
}

#[test]
fn maps_are_no_scans() {
    let names = ["CornerMap.pcd", "GlobalMap.pcd", "trajectory.pcd", "transformations.pcd"];
    let folder = Folder::with_scans(3);
    folder.kitti("poses.txt", 3, 0.0);
    names.iter().for_each(|name| folder.cloud(name, 9));
    assert_eq!(folder.open().unwrap().scans().len(), 3, "beside scans, as SC-LIO-SAM saves them");
    std::fs::remove_dir_all(folder.file("scans")).unwrap();
    let expected = "a map and its poses, not scans: CornerMap.pcd, GlobalMap.pcd, trajectory.pcd, transformations.pcd";
    assert!(folder.refusal().contains(expected) && folder.refusal().contains("--poses transformations.pcd"), "{}", folder.refusal());
    let raw = voxelastic_io::raw::open(folder.path(), &OpenOptions::default()).unwrap_err().to_string();
    assert!(raw.contains(expected), "{raw}");
    (0..3).for_each(|k| folder.cloud(&format!("{k}.pcd"), k));
    assert_eq!(folder.open().unwrap().scans().len(), 3, "among scans");
}

#[test]
fn a_quaternion_that_is_slightly_off_is_normalised() {
    let folder = Folder::with_scans(1);
    folder.text("poses.tum", "0 1 2 3 0 0 0 0.995\n");
    assert!((folder.open().unwrap().scans()[0].t_map_lidar.rotation.norm() - 1.0).abs() < 1e-12);
}

#[test]
fn fewer_poses_than_numbered_clouds_are_skips() {
    let folder = Folder::with_scans(5);
    folder.kitti("poses.txt", 3, 0.0);
    let dataset = folder.open().unwrap();
    assert_eq!((dataset.scans().len(), dataset.description().without_pose.len()), (3, 2));
    let strict = folder.open_with(OpenOptions { strict: true, ..OpenOptions::default() });
    assert!(strict.unwrap_err().to_string().contains("2 clouds have no pose, the first is"));
}

#[test]
fn times_that_fit_nothing() {
    let folder = Folder::with_scans(3);
    folder.kitti("poses.txt", 3, 0.0);
    folder.text("times.txt", "0\n1\n");
    assert!(folder.refusal().contains("2 times for 3 clouds and 3 poses"));
    folder.text("times.txt", "0\n2\n1\n");
    assert!(folder.refusal().contains("times.txt, line 3, field time: 1 is not after 2 of line 2"));
    folder.text("times.txt", "0\n1\n2\n");
    std::fs::remove_file(folder.file("poses.txt")).unwrap();
    folder.tum("poses.tum", 3, 1e9, 1.0, 0.0);
    let refusal = folder.refusal();
    assert!(refusal.contains("clouds are from 0 to 2 s, poses from 1000000000 to 1000000002 s"), "{refusal}");
}

#[test]
fn clouds_in_two_places_or_formats() {
    let folder = Folder::with_scans(2);
    folder.kitti("poses.txt", 2, 0.0);
    folder.cloud("velodyne/0.pcd", 0);
    assert!(folder.refusal().contains("several folders hold clouds: scans, velodyne"));
    std::fs::remove_dir_all(folder.file("velodyne")).unwrap();
    folder.text("scans/map.ply", "ply\n");
    assert!(folder.open().unwrap().description().to_string().contains("1 files of another format"));
    folder.text("scans/map2.ply", "ply\n");
    assert!(folder.refusal().contains("as many PCD files as PLY files"));
}

#[test]
fn graphs_that_do_not_belong() {
    let folder = Folder::new();
    ["a", "b"].iter().enumerate().for_each(|(k, n)| folder.cloud(&format!("scans/{n}.pcd"), k));
    folder.kitti("poses.txt", 2, 0.0);
    g2o::write(folder.file("graph.g2o"), &graph(&[0, 1, 2], &[(2, 0)])).unwrap();
    let dataset = folder.open().unwrap();
    assert_eq!(story(&dataset), "S0 S1 O0-1");
    assert!(dataset.description().to_string().contains("its 3 nodes cannot be matched to the 2 clouds"));
    assert!(folder.open_with(OpenOptions { strict: true, ..OpenOptions::default() }).is_err());

    g2o::write(folder.file("other.g2o"), &graph(&[0, 1], &[])).unwrap();
    let error = folder.open().unwrap_err();
    assert!(matches!(&error, Error::Ambiguous { choices, .. } if choices.len() == 2) && error.to_string().contains("--graph"), "{error}");
    let chosen = folder.open_with(OpenOptions { graph: Some("other".into()), ..OpenOptions::default() }).unwrap();
    assert_eq!(chosen.description().graph, Some(("other.g2o".into(), [2, 1, 0])));
    let wrong = folder.open_with(OpenOptions { graph: Some("poses.txt".into()), ..OpenOptions::default() });
    assert!(wrong.unwrap_err().to_string().contains("not a g2o pose graph"));
}

#[test]
fn a_broken_ground_truth_does_not_end_a_run() {
    let folder = Folder::with_scans(2);
    folder.kitti("poses.txt", 2, 0.0);
    folder.text("groundtruth.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 9 0 0 0 0 1 0\n");
    let dataset = folder.open().unwrap();
    assert!(dataset.ground_truth().is_none());
    assert!(dataset.description().to_string().contains("the ground truth is ignored"));
}
