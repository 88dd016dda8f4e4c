//! Nothing that was mapped is lost: messages that cannot be written, repeated signals, shorter runs.
#![cfg(unix)]

use crate::{fails, json, room, run, voxelastic};
use rustix::process::{Pid, Signal, kill_process};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};

/// A folder of `count` scans, all links to one file.
fn long_room(dir: &Path, count: usize) {
    let data = dir.join("room");
    room::write(&data, 1);
    for i in 1..count {
        std::fs::hard_link(data.join("scans/000000.pcd"), data.join(format!("scans/{i:06}.pcd"))).unwrap();
    }
    room::write_poses(&data, count);
}

/// Starts mapping a folder of thousands of scans and waits for the first to be in the map.
fn started(dir: &Path) -> (Child, impl Iterator<Item = String> + use<>) {
    long_room(dir, 3000);
    let arguments = ["map", "room", "--voxel-size", "0.03"];
    let mut child = voxelastic(dir).args(arguments).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.by_ref().any(|line| line.contains("sensor:")));
    (child, lines)
}

fn scans(dir: &Path, map: &str) -> u64 {
    json(dir, &format!("info {map} --check --json"))["scans"].as_u64().unwrap()
}

#[test]
fn messages_that_cannot_be_written_do_not_end_a_run() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 3);
    let full = || File::options().write(true).open("/dev/full").unwrap();
    let mut map = voxelastic(dir.path());
    let status = map.args(["-vv", "map", "room", "-o", "full.vox"]).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(0), "{status}");
    assert_eq!(scans(dir.path(), "full.vox"), 3);
    // A reader that is gone, as in `2>&1 | head -1`.
    let mut map = voxelastic(dir.path());
    let mut child = map.args(["-vv", "map", "room", "-o", "gone.vox"]).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stderr.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(scans(dir.path(), "gone.vox"), 3);
    // Errors keep their exit codes.
    let status = voxelastic(dir.path()).args(["map", "nothing"]).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(1), "{status}");
}

#[test]
fn a_signal_delivered_twice_is_one_request() {
    for signal in [Signal::TERM, Signal::HUP] {
        let dir = tempfile::tempdir().unwrap();
        let (mut child, lines) = started(dir.path());
        for _ in 0..3 {
            kill_process(Pid::from_child(&child), signal).unwrap();
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let log = lines.collect::<Vec<_>>().join("\n");
        assert_eq!(child.wait().unwrap().code(), Some(130), "{log}");
        assert!(scans(dir.path(), "room.vox") >= 1, "{log}");
    }
}

#[test]
fn input_without_end_or_beginning_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 1);
    let pipe = dir.path().join("pipe.bag");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for command in ["map pipe.bag", "info pipe.bag"] {
        fails(dir.path(), command, 1, &["pipe.bag", "a pipe or a device"]);
    }
    fails(dir.path(), "map room --config /dev/zero", 2, &["/dev/zero", "are no configuration"]);
    let done = run(dir.path(), "map room --threads 1024 --json");
    assert!(done.code == Some(0) && done.err.contains("more than four for each core"), "{}", done.err);
    let summary: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert!(summary["threads"].as_u64().unwrap() < 1024, "{summary}");
}

#[test]
fn a_scan_of_points_at_the_sensor_is_skipped() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 3);
    let points = (0..600).map(|i| [(1 + i % 7) as f32 * 1e-40, 1e-40, 1e-40]).collect::<Vec<_>>();
    let cloud = voxelastic::Cloud::from_points(points);
    voxelastic_io::pcd::write(dir.path().join("room/scans/000000.pcd"), &cloud).unwrap();
    let done = run(dir.path(), "map room --json");
    assert!(done.code == Some(0) && !done.err.contains("has a bug"), "{}", done.err);
    // Alone it is an error, and no map.
    room::write_poses(&dir.path().join("room"), 1);
    (1..3).for_each(|i| std::fs::remove_file(dir.path().join(format!("room/scans/{i:06}.pcd"))).unwrap());
    fails(dir.path(), "map room -o alone.vox", 1, &["no scan could be integrated"]);
}

#[test]
fn scans_farther_away_than_anything_on_earth_are_skipped() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 3);
    let mut poses: Vec<(f64, voxelastic::Pose)> = (0..3).map(|i| (0.1 * i as f64, room::pose(i))).collect();
    poses[1].1.translation.x += 1e9;
    voxelastic_io::poses::write_tum(dir.path().join("room/poses.tum"), &poses).unwrap();
    let done = run(dir.path(), "map room --json");
    let summary: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!((summary["scans"].as_u64(), summary["scans_skipped"].as_u64()), (Some(2), Some(1)), "{}", done.err);
    assert!(done.err.contains("1000000000 m from the one before"), "{}", done.err);
}

#[test]
fn a_lock_that_is_a_link_is_not_followed() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 1);
    std::fs::write(dir.path().join("precious"), "years of work").unwrap();
    std::fs::create_dir(dir.path().join("room.vox")).unwrap();
    std::os::unix::fs::symlink("../precious", dir.path().join("room.vox/.lock")).unwrap();
    fails(dir.path(), "map room", 1, &[".lock", "a link"]);
    assert_eq!(std::fs::read(dir.path().join("precious")).unwrap(), b"years of work");
}

#[test]
fn a_shorter_run_does_not_replace_a_larger_map() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 4);
    assert_eq!(json(dir.path(), "map room --json")["scans"], 4);
    let summary = json(dir.path(), "map room --max-scans 2 --json");
    assert_eq!(summary["output"], "room-2.vox");
    assert_eq!((scans(dir.path(), "room.vox"), scans(dir.path(), "room-2.vox")), (4, 2));
    let finished = run(dir.path(), "map room --max-scans 2");
    assert!(finished.err.contains("room.vox has 4 scans and is kept") && finished.err.contains("room-3.vox"), "{}", finished.err);
    // As many scans replace it, and so does one who asks for it.
    assert_eq!(json(dir.path(), "map room --json")["output"], "room.vox");
    assert_eq!(json(dir.path(), "map room --max-scans 2 --overwrite --json")["output"], "room.vox");
    assert_eq!(scans(dir.path(), "room.vox"), 2);
}
