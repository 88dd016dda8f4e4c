//! Folders that cannot be read, and what the errors say.

use super::*;
use voxelastic_io::Error;

#[test]
fn nothing_there() {
    let folder = Folder::new();
    let refusal = folder.refusal();
    assert!(refusal.contains("no clouds in scans/") && refusal.contains("name a folder that holds"), "{refusal}");
    folder.write("lidar/readme.txt", b"none\n");
    folder.write("image_00/data/0.png", b"");
    assert!(folder.refusal().contains("no clouds in"));
    assert!(matches!(raw::open(folder.file("gone"), &OpenOptions::default()), Err(Error::Io { .. })));
    assert!(raw::open(folder.file("lidar/readme.txt"), &OpenOptions::default()).is_err());
}

#[test]
fn two_candidates() {
    let folder = Folder::new();
    for k in 0..2 {
        folder.pcd(&format!("front/{k}.pcd"), k);
        folder.pcd(&format!("rear/{k}.pcd"), k);
    }
    let refusal = folder.refusal();
    assert!(refusal.contains("several folders hold clouds: front, rear; name one of them"), "{refusal}");
    assert_eq!(raw::open(folder.file("rear"), &OpenOptions::default()).unwrap().count(), Some(2));
    folder.pcd("lidar/0.pcd", 0);
    folder.pcd("pcd/0.pcd", 0);
    assert!(folder.refusal().contains("several folders hold clouds: lidar, pcd"));
}

#[test]
fn mixed_formats() {
    let folder = Folder::new();
    folder.pcd("lidar/0.pcd", 0);
    folder.write("lidar/1.ply", b"ply\n");
    assert!(folder.refusal().contains("as many PCD files as PLY files"));
    folder.pcd("lidar/1.pcd", 1);
    assert_eq!(folder.scans().len(), 2);
    assert!(folder.open().unwrap().description().contains("1 files of another format than PCD are ignored"));
}

#[test]
fn times_that_do_not_fit() {
    let folder = Folder::new();
    (0..3).for_each(|k| folder.bin(&format!("velodyne_points/data/{k:010}.bin"), k, 1));
    folder.write("velodyne_points/timestamps.txt", b"2011-09-26 13:02:25.5\n2011-09-26 13:02:25.6\n");
    assert!(folder.refusal().contains("timestamps.txt: 2 times for 3 clouds"), "{}", folder.refusal());
    folder.write("velodyne_points/timestamps.txt", b"2011-09-26 13:02:25.5\n2011-09-26 13:02:25.6\nyesterday\n");
    assert!(folder.refusal().contains("timestamps.txt, line 3, field date"), "{}", folder.refusal());
    folder.write("velodyne_points/timestamps.txt", b"2011-09-26 13:02:25.5\n2011-09-26 13:02:25.6\n2011-09-26 13:02:25.4\n");
    assert!(folder.refusal().contains("line 3, field time"), "{}", folder.refusal());

    let folder = Folder::new();
    (0..3).for_each(|k| folder.pcd(&format!("lidar/scan_{}.pcd", k + 7), k));
    folder.write("times.txt", b"0\n1\n");
    assert!(folder.refusal().contains("times.txt: 2 times for 3 clouds"), "{}", folder.refusal());
}

#[test]
fn a_damaged_cloud_is_an_item_and_the_next_one_follows() {
    let folder = Folder::new();
    (0..3).for_each(|k| folder.bin(&format!("lidar/{k}.bin"), k, 1));
    folder.write("lidar/1.bin", &[0; 10]);
    let items: Vec<bool> = folder.open().unwrap().iter().map(|scan| scan.is_ok()).collect();
    assert_eq!(items, [true, false, true]);
}

#[test]
fn stations_of_a_laser_scanner_are_not_a_sequence() {
    let folder = Folder::new();
    folder.write("site.e57", b"");
    let refusal = raw::open(folder.file("site.e57"), &OpenOptions::default()).unwrap_err().to_string();
    assert!(refusal.contains("not a sequence"), "{refusal}");
}
