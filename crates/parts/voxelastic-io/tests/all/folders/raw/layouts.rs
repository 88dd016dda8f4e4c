//! Layouts that are recognised.

use super::*;
use std::fmt::Write as _;
use voxelastic_io::bag::BagFormat;

/// Lines of times from 13:02:25.5 on, a tenth of a second apart.
fn timestamps(count: usize, offset: f64) -> String {
    (0..count).fold(String::new(), |mut text, k| {
        writeln!(text, "2011-09-26 13:02:{:012.9}", 25.5 + 0.1 * k as f64 + offset).unwrap();
        text
    })
}

#[test]
fn kitti_raw_with_start_and_end_of_sweeps() {
    let folder = Folder::new();
    (0..3).for_each(|k| folder.bin(&format!("velodyne_points/data/{k:010}.bin"), k, 1));
    folder.write("velodyne_points/timestamps.txt", timestamps(3, 0.0).as_bytes());
    folder.write("velodyne_points/timestamps_start.txt", timestamps(3, -0.05).as_bytes());
    folder.write("velodyne_points/timestamps_end.txt", timestamps(3, 0.05).as_bytes());
    folder.write("image_00/data/0000000000.png", b"");
    let scans = folder.scans();
    assert_eq!((scans.len(), scans[1].node, names(&scans)[1]), (3, 1, "0000000001"));
    assert!((scans[1].time - 1_317_042_145.6).abs() < 1e-6, "{}", scans[1].time);
    let [start, end] = scans[1].sweep.unwrap();
    assert!((scans[1].time - start - 0.05).abs() < 1e-6 && (end - scans[1].time - 0.05).abs() < 1e-6);
    let described = folder.open().unwrap().description().to_owned();
    assert!(described.contains("in velodyne_points/data/") && described.contains("start and end of each sweep"), "{described}");
}

#[test]
fn kitti_raw_with_missing_sweeps_takes_times_by_number() {
    let folder = Folder::new();
    for (k, number) in [0, 1, 4].into_iter().enumerate() {
        folder.bin(&format!("velodyne_points/data/{number:010}.bin"), k, 1);
    }
    folder.write("velodyne_points/timestamps.txt", timestamps(5, 0.0).as_bytes());
    let scans = folder.scans();
    assert!((scans[2].time - scans[0].time - 0.4).abs() < 1e-6 && scans[2].node == 4);
}

#[test]
fn kitti_360_from_the_top_of_the_download() {
    let folder = Folder::new();
    let drive = "data_3d_raw/2013_05_28_drive_0000_sync/velodyne_points";
    (0..2).for_each(|k| folder.bin(&format!("{drive}/data/{k:010}.bin"), k, 1));
    folder.write(&format!("{drive}/timestamps.txt"), b"2013-05-28 08:46:02.904448000\n2013-05-28 08:46:03.008448000\n");
    folder.write("calibration/calib_cam_to_velo.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n");
    let scans = folder.scans();
    assert!((scans[1].time - scans[0].time - 0.104).abs() < 1e-6 && scans[0].sweep.is_none());
}

#[test]
fn kitti_odometry_and_semantic_kitti_sequences() {
    let folder = Folder::new();
    for k in 0..3 {
        folder.bin(&format!("sequences/00/velodyne/{k:06}.bin"), k, 1);
        folder.write(&format!("sequences/00/labels/{k:06}.label"), &[0; 4]);
    }
    folder.write("sequences/00/times.txt", b"0.0\n0.25\n0.5\n");
    folder.write("sequences/00/calib.txt", b"P0: 1 0 0 0 0 1 0 0 0 0 1 0\n");
    assert_eq!(times(&folder.scans()), [0.0, 0.25, 0.5]);
    let sequence = raw::open(folder.file("sequences/00"), &OpenOptions::default()).unwrap();
    assert_eq!(sequence.iter().map(|s| s.unwrap().time).collect::<Vec<_>>(), [0.0, 0.25, 0.5]);

    folder.bin("sequences/01/velodyne/000000.bin", 0, 1);
    folder.bin("sequences/01/velodyne/000001.bin", 1, 1);
    let refusal = folder.refusal();
    assert!(refusal.contains("several folders hold clouds: sequences/00/velodyne, sequences/01/velodyne; name one of them"), "{refusal}");
}

#[test]
fn nuscenes_keyframes_and_sweeps_in_the_order_of_time() {
    let folder = Folder::new();
    for k in 0..4usize {
        let part = if k % 2 == 0 { "samples" } else { "sweeps" };
        let stamp = 1_532_402_927_647_951u64 + 50_000 * k as u64;
        folder.bin(&format!("{part}/LIDAR_TOP/n015-2018-07-24-11-22-45+0800__LIDAR_TOP__{stamp}.pcd.bin"), k, 2);
    }
    let scans = folder.scans();
    assert_eq!(scans.len(), 4);
    assert!((scans[1].time - 1_532_402_927.697_951).abs() < 1e-6, "{}", scans[1].time);
    assert_eq!((scans[0].cloud.ring.as_deref(), scans[0].cloud.intensity.as_deref()), (Some(&[7u16][..]), Some(&[7.0f32][..])));
    assert!(scans[0].name.ends_with("__1532402927647951"));

    let sweeps = raw::open(folder.file("sweeps/LIDAR_TOP"), &OpenOptions::default()).unwrap();
    assert_eq!((sweeps.count(), sweeps.iter().next().unwrap().unwrap().cloud.points[0][0]), (Some(2), 2.0));
}

#[test]
fn usual_names_and_any_name() {
    for place in ["scans", "velodyne", "clouds", "lidar", "pcd", "points", "PointClouds", "lidar/data", "", "frames", "run_1/frames", "a/b/frames"] {
        let folder = Folder::new();
        (0..12).for_each(|k| folder.pcd(format!("{place}/s{k}.pcd").trim_start_matches('/'), k));
        let scans = folder.scans();
        // s10 comes after s9, not after s1; without times, scans are taken to be 0.1 s apart.
        assert_eq!((names(&scans)[10], scans[10].node, scans[10].time), ("s10", 10, 1.0), "{place}");
    }
}

#[test]
fn a_usual_name_is_preferred_and_one_cloud_is_no_sequence() {
    let folder = Folder::new();
    (0..2).for_each(|k| folder.pcd(&format!("lidar/{k}.pcd"), k));
    (0..2).for_each(|k| folder.pcd(&format!("submaps/{k}.pcd"), k + 5));
    assert_eq!(folder.scans().len(), 2);

    let folder = Folder::new();
    (0..2).for_each(|k| folder.pcd(&format!("frames/{k}.pcd"), k));
    folder.pcd("output/map.pcd", 9);
    assert_eq!(folder.scans().len(), 2);
}

#[test]
fn times_from_names() {
    let folder = Folder::new();
    (0..3).for_each(|k| folder.pcd(&format!("pcd/{}.pcd", 1_600_000_000_500_000_000u64 + 100_000_000 * k as u64), k));
    let found = times(&folder.scans());
    assert!((found[0] - 1_600_000_000.5).abs() < 1e-6 && (found[2] - found[0] - 0.2).abs() < 1e-6, "{found:?}");
}

#[test]
fn times_of_points_are_relative_to_the_scan() {
    let folder = Folder::new();
    let header = "VERSION 0.7\nFIELDS x y z timestamp\nSIZE 4 4 4 8\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n";
    for k in 0..2 {
        let t = 1.6e9 + 0.1 * f64::from(k);
        folder.write(&format!("lidar/{k}.pcd"), format!("{header}{} 0 0 {t:.6}\n5 0 0 {:.6}\n", k + 1, t + 0.05).as_bytes());
    }
    // Without times in names or files, the clouds' own count.
    let scans = folder.scans();
    assert!((scans[1].time - 1_600_000_000.1).abs() < 1e-5, "{}", scans[1].time);
    let t = scans[1].cloud.time.as_ref().unwrap();
    assert!(t[0].abs() < 1e-5 && (t[1] - 0.05).abs() < 1e-5, "{t:?}");
}

#[test]
fn poses_are_not_used_and_dumps_give_their_keyframes() {
    let folder = Folder::new();
    let identity = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    for k in 0..2 {
        folder.pcd(&format!("{k:06}/cloud.pcd"), k);
        folder.write(&format!("{k:06}/data"), format!("stamp {} 500000000\nestimate\n{identity}id {}\n", 10 + k, 4 * k).as_bytes());
    }
    let scans = folder.scans();
    assert_eq!((times(&scans), scans[1].node, names(&scans)[1]), (vec![10.5, 11.5], 4, "000001/cloud"));
}

#[test]
fn recordings_and_captures_are_read_without_poses() {
    let bag = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/bags/fixtures/ouster_bz2.bag");
    assert_eq!(BagFormat::of(&bag).unwrap(), Some(BagFormat::Ros1));
    let opened = raw::open(&bag, &OpenOptions::default()).unwrap();
    assert!(opened.description().starts_with("recording: ROS 1 bag\nclouds: "), "{}", opened.description());
    let scans: Vec<TimedScan> = opened.iter().map(|scan| scan.unwrap()).collect();
    assert_eq!((Some(scans.len()), scans.len()), (opened.count(), 12));
    assert!((scans[3].time - 100.3).abs() < 1e-6 && scans[3].cloud.time.is_some());
    let mut again = opened.clouds();
    assert_eq!(again.cloud(5).unwrap().points, scans[5].cloud.points);
    assert_eq!(again.cloud(0).unwrap().points, scans[0].cloud.points);
}
