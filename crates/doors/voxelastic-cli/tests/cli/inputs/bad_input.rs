//! Errors: exit code, file, place and remedy in the message.

use crate::{fails, json, room, run, works};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A folder with a `room` of `count` scans in it.
fn with_room(count: usize) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), count);
    dir
}

/// Replaces a file of the room.
fn put(dir: &TempDir, name: &str, content: impl AsRef<[u8]>) {
    fs::write(dir.path().join("room").join(name), content).unwrap();
}

fn edit(dir: &TempDir, name: &str, change: impl FnOnce(String) -> String) {
    let path = dir.path().join("room").join(name);
    fs::write(&path, change(fs::read_to_string(&path).unwrap())).unwrap();
}

const MAP: &str = "map room --voxel-size 0.1 --max-range 20";

/// Mapping must go on without scan 2, saying `words`; with `--strict` it must fail with the same words and write nothing.
fn skips_one(dir: &TempDir, words: &[&str]) {
    fails(dir.path(), &format!("{MAP} --strict -o strict.vox"), 1, words);
    assert!(!dir.path().join("strict.vox").exists(), "a failed run leaves nothing");
    let finished = run(dir.path(), &format!("{MAP} --json"));
    assert_eq!(finished.code, Some(0), "{}", finished.err);
    for word in words.iter().chain(&["scan skipped"]) {
        assert!(finished.err.contains(word), "no `{word}` in\n{}", finished.err);
    }
    let summary: serde_json::Value = serde_json::from_str(&finished.out).unwrap();
    assert_eq!((summary["scans"].as_u64(), summary["scans_skipped"].as_u64()), (Some(3), Some(1)), "{summary}");
}

#[test]
fn a_truncated_cloud_is_skipped() {
    let dir = with_room(4);
    let whole = fs::read(dir.path().join("room/scans/000002.pcd")).unwrap();
    put(&dir, "scans/000002.pcd", &whole[..whole.len() / 2]);
    skips_one(&dir, &["000002.pcd"]);
}

#[test]
fn a_cloud_of_zeros_is_skipped() {
    let dir = with_room(4);
    put(&dir, "scans/000002.pcd", vec![0u8; 4096]);
    skips_one(&dir, &["000002.pcd"]);
}

#[test]
fn a_cloud_without_a_return_is_skipped() {
    let dir = with_room(4);
    let mut points = vec![[f32::NAN; 3]; 50];
    points.resize(100, [0.0; 3]);
    voxelastic_io::pcd::write(dir.path().join("room/scans/000002.pcd"), &voxelastic::Cloud::from_points(points)).unwrap();
    skips_one(&dir, &["000002.pcd", "no return"]);
}

#[test]
fn a_header_that_claims_ten_gigabytes_is_skipped() {
    let dir = with_room(4);
    let header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 900000000\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 900000000\nDATA binary\n";
    put(&dir, "scans/000002.pcd", [header.as_bytes(), &[7u8; 1000]].concat());
    skips_one(&dir, &["000002.pcd"]);
    let map = json(dir.path(), &format!("{MAP} --json"));
    assert!(map["peak_rss_mb"].as_f64().is_none_or(|mb| mb < 1000.0), "{map}");
}

#[test]
fn a_field_of_the_wrong_type_is_skipped() {
    let dir = with_room(4);
    let text = "VERSION 0.7\nFIELDS x y\nSIZE 4 4\nTYPE F F\nCOUNT 1 1\nWIDTH 1\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA ascii\n1 2\n";
    put(&dir, "scans/000002.pcd", text);
    skips_one(&dir, &["000002.pcd"]);
}

#[test]
fn a_scan_without_a_pose_is_skipped() {
    let dir = with_room(4);
    edit(&dir, "poses.tum", |text| text.lines().take(3).map(|l| format!("{l}\n")).collect());
    let finished = run(dir.path(), &format!("{MAP} --strict"));
    assert_eq!(finished.code, Some(1), "{}", finished.err);
    assert!(finished.err.contains("pose"), "{}", finished.err);
}

#[test]
fn a_quaternion_that_is_no_rotation_is_named() {
    let dir = with_room(4);
    edit(&dir, "poses.tum", |text| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let third = lines.iter_mut().filter(|l| !l.starts_with('#')).nth(2).unwrap();
        *third = "0.2 0 0 0 0 0 0 3".to_owned();
        lines.join("\n")
    });
    fails(dir.path(), MAP, 1, &["poses.tum", "line ", "quaternion"]);
}

#[test]
fn times_that_go_back_are_named() {
    let dir = with_room(4);
    edit(&dir, "poses.tum", |text| text.lines().rev().map(|l| format!("{l}\n")).collect());
    fails(dir.path(), MAP, 1, &["poses.tum", "line "]);
}

#[test]
fn several_pose_files_are_listed() {
    let dir = with_room(4);
    fs::copy(dir.path().join("room/poses.tum"), dir.path().join("room/groundtruth.tum")).unwrap();
    fs::rename(dir.path().join("room/poses.tum"), dir.path().join("room/odometry.tum")).unwrap();
    fails(dir.path(), MAP, 1, &["odometry", "groundtruth", "--poses"]);
    works(dir.path(), &format!("{MAP} --poses odometry"));
}

#[test]
fn folders_without_scans_are_an_error() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("room")).unwrap();
    fails(dir.path(), MAP, 1, &["room"]);
    fails(dir.path(), "map nowhere", 1, &["nowhere"]);
    fails(dir.path(), "map nowhere -o /", 1, &[]);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "nothing is left behind");
}

#[test]
fn only_maps_are_replaced() {
    let dir = with_room(2);
    let other = dir.path().join("other");
    fs::create_dir(&other).unwrap();
    fs::write(other.join("thesis.tex"), "years").unwrap();
    fails(dir.path(), &format!("{MAP} -o other"), 1, &["other", "thesis.tex"]);
    fails(dir.path(), &format!("{MAP} -o other/thesis.tex"), 1, &["thesis.tex"]);
    assert_eq!(fs::read_to_string(other.join("thesis.tex")).unwrap(), "years");
    works(dir.path(), MAP);
    works(dir.path(), MAP);
}

#[test]
fn mistakes_on_the_command_line_and_in_settings_exit_with_2() {
    let dir = with_room(1);
    fails(dir.path(), "map room --voxel-size 99", 2, &["voxel_size = 99", "0.005 to 5 m"]);
    fails(dir.path(), "map room --voxel-size fine", 2, &["0.005 to 5 m"]);
    fails(dir.path(), "map room --min-range 10 --max-range 5", 2, &["min_range", "max_range"]);
    fails(dir.path(), "map room --sensor os9-64", 2, &["os9-64", "os1-64"]);
    fails(dir.path(), "map room --field colour", 2, &["tsdf"]);
    fails(dir.path(), "map room --t-base-lidar 1,2,3", 2, &["x y z qx qy qz qw"]);
    fails(dir.path(), "map room --hold-out 1", 2, &["2 or more"]);
    fs::write(dir.path().join("bad.toml"), "voxel_size = 0.1\nvoxels = 2\n").unwrap();
    fails(dir.path(), "map room --config bad.toml", 2, &["bad.toml, line 2", "did you mean `voxel_size`"]);
    fails(dir.path(), "map room --config missing.toml", 1, &["missing.toml"]);
    fails(dir.path(), "mesh room.vox -o room.stl", 2, &[".ply or .glb"]);
    fails(dir.path(), "render room.vox -o x.png --eye 1,2", 2, &[]);
    fails(dir.path(), "render room.vox -o x.png --size 10", 2, &["1600x1200"]);
    fails(dir.path(), "paint room", 2, &[]);
}

#[test]
fn damaged_maps_and_other_folders_are_refused() {
    let dir = with_room(2);
    fails(dir.path(), "mesh room -o x.ply", 1, &["room", "not a Voxelastic map"]);
    fails(dir.path(), "mesh nothing.vox -o x.ply", 1, &["nothing.vox"]);
    fails(dir.path(), "info nothing.vox", 1, &["nothing.vox"]);
    works(dir.path(), MAP);
    fails(dir.path(), "mesh room.vox -o x.ply --min-weight 50", 1, &["50 observations", "--min-weight"]);
    fails(dir.path(), "mesh room.vox -o room/poses.tum/x.ply", 1, &["x.ply"]);
    let file = submap_file(&dir.path().join("room.vox"));
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(&file, bytes).unwrap();
    let name = file.file_name().unwrap().to_str().unwrap();
    fails(dir.path(), "mesh room.vox -o x.ply", 1, &[name, "damaged"]);
    fails(dir.path(), "info room.vox --check", 1, &[name]);
    works(dir.path(), "info room.vox");
    fs::write(dir.path().join("room.vox/manifest.json"), "{").unwrap();
    fails(dir.path(), "info room.vox", 1, &["manifest.json"]);
}

fn submap_file(map: &Path) -> std::path::PathBuf {
    let mut files = fs::read_dir(map).unwrap().map(|e| e.unwrap().path());
    files.find(|p| p.extension().is_some_and(|e| e == "vxs")).unwrap()
}

#[test]
fn a_map_is_not_measured_with_its_own_scans() {
    let dir = with_room(4);
    works(dir.path(), MAP);
    fails(dir.path(), "heldout room.vox room --hold-out 2", 1, &["part of the map", "--hold-out"]);
    fails(dir.path(), "heldout room.vox room --hold-out 100", 1, &["--hold-out"]);
}
