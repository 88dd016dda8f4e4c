//! Runs that are killed go on, and their maps are those of runs that were not.
#![cfg(unix)]

use crate::{fails, json, room, run, voxelastic, works};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};
use voxelastic_testing::PATIENCE;

/// Random numbers.
pub struct Numbers(pub u64);

impl Numbers {
    /// From 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// The files of a map, without what depends on the process: times, when sessions were added, and the size of fields in memory.
pub fn content(map: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(map).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name == "manifest.json" {
            let mut manifest: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
            manifest["crc32"].take();
            manifest["sessions"].as_array_mut().into_iter().flatten().for_each(|session| drop(session["added"].take()));
            files.insert(name, manifest.to_string().into_bytes());
        } else if path.is_file() && ![".lock", "run.json"].contains(&name.as_str()) {
            files.insert(name, fs::read(&path).unwrap());
        }
    }
    files
}

/// The time that a command may take after so many kills of it: a machine that has become busier is slower.
pub fn grown(takes: Duration, kills: usize) -> Duration {
    takes.mul_f64(1.0 + 0.02 * kills as f64)
}

/// Runs the command and kills it at a random moment of the time that it takes; whether it came to its end first.
pub fn ends(dir: &Path, arguments: &str, takes: Duration, numbers: &mut Numbers) -> bool {
    let mut child = voxelastic(dir).args(arguments.split_whitespace()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let until = Instant::now() + takes.mul_f64(1.1 * numbers.unit());
    while Instant::now() < until {
        if let Some(status) = child.try_wait().unwrap() {
            assert_eq!(status.code(), Some(0), "voxelastic {arguments}");
            return true;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    let status = child.wait().unwrap();
    assert!(status.code().is_none_or(|code| code == 0), "voxelastic {arguments}: {status}");
    status.code() == Some(0)
}

/// Maps until a run comes to its end; each is killed at a random moment. Returns the number of kills.
fn map_with_kills(dir: &Path, arguments: &str, takes: Duration, numbers: &mut Numbers) -> usize {
    let mut kills = 0;
    while !ends(dir, arguments, grown(takes, kills), numbers) {
        kills += 1;
        assert!(kills < 500, "no run comes to its end: voxelastic {arguments}");
    }
    kills
}

/// Maps as a whole and with kills (`map DATA`, or `live --from DATA --rate max`), and compares.
pub fn compare(dir: &Path, arguments: &str, rounds: usize, numbers: &mut Numbers) -> usize {
    let clock = Instant::now();
    works(dir, &format!("{arguments} -o whole.vox"));
    let takes = clock.elapsed();
    let whole = content(&dir.join("whole.vox"));
    // A map over another one is not compared: a larger one is kept, and of a submap whose fields are the same, the file is.
    fs::remove_dir_all(dir.join("whole.vox")).unwrap();
    let mut kills = 0;
    for round in 0..rounds {
        let map = dir.join("killed.vox");
        kills += map_with_kills(dir, &format!("{arguments} --checkpoints 2 -o killed.vox"), takes, numbers);
        assert!(!map.join("unfinished").exists(), "{arguments}, round {round}");
        let killed = content(&map);
        assert_eq!(whole.keys().collect::<Vec<_>>(), killed.keys().collect::<Vec<_>>(), "{arguments}, round {round}");
        assert!(whole == killed, "{arguments}, round {round}, after {kills} kills");
        fs::remove_dir_all(map).unwrap();
    }
    kills
}

pub fn simulated(dir: &Path) {
    works(dir, "simulate street -o street --laps 1.3 --spacing 5 --columns 64");
}

/// A run that did not end, with at least one scan in its checkpoint.
fn unfinished(dir: &Path, arguments: &str, map: &str) {
    let mut child = voxelastic(dir).args(arguments.split_whitespace()).args(["--checkpoints", "1"]).stderr(Stdio::null()).spawn().unwrap();
    let clock = Instant::now();
    while !dir.join(map).join("unfinished/manifest.json").exists() {
        assert!(child.try_wait().unwrap().is_none() && clock.elapsed() < PATIENCE, "{arguments}");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_map_after_kills_is_that_of_a_run_without() {
    let dir = tempfile::tempdir().unwrap();
    simulated(dir.path());
    let mut numbers = Numbers(5);
    // With corrections as they were known at the time, then with poses by odometry that are optimised, then with closures from the scans.
    let settings = "map street --voxel-size 0.4 --max-range 20";
    let mut kills = compare(dir.path(), &format!("{settings} --field both"), 1, &mut numbers);
    kills += compare(dir.path(), &format!("{settings} --optimize --rebuild-deformed"), 1, &mut numbers);
    kills += compare(dir.path(), &format!("{settings} --loops"), 1, &mut numbers);
    // Without poses; a scan that cannot be used stays one.
    room::write(&dir.path().join("room"), 40);
    fs::remove_file(dir.path().join("room/poses.tum")).unwrap();
    fs::write(dir.path().join("room/scans/000007.pcd"), "no cloud").unwrap();
    kills += compare(dir.path(), "map room --voxel-size 0.05 --hold-out 9", 1, &mut numbers);
    kills += compare(dir.path(), "map room --voxel-size 0.05 --no-loops", 1, &mut numbers);
    assert!(kills >= 4, "{kills} kills");
}

#[test]
fn a_recording_that_is_played_goes_on_after_kills_too() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    simulated(dir);
    let mut numbers = Numbers(9);
    let settings = "--voxel-size 0.4 --max-range 20 --rate max";
    let mut kills = compare(dir, &format!("live --from street {settings} --field both"), 1, &mut numbers);
    kills += compare(dir, &format!("live --from street {settings} --loops"), 1, &mut numbers);
    room::write(&dir.join("room"), 40);
    fs::write(dir.join("room/scans/000007.pcd"), "no cloud").unwrap();
    kills += compare(dir, "live --from room --rate max --voxel-size 0.05 --slam", 1, &mut numbers);
    // Sweeps in one file, with an inertial unit.
    works(dir, "simulate room -o walk --moving --rate 10 --imu 100 --columns 128 --carrier handheld --rest 1 --scans 30 --bag");
    kills += compare(dir, "live --from walk/recording.mcap --rate max --voxel-size 0.1 --every scan --slam", 1, &mut numbers);
    assert!(kills >= 4, "{kills} kills");
}

#[test]
fn another_run_does_not_go_on_with_it_and_does_not_lose_it() {
    let dir = tempfile::tempdir().unwrap();
    simulated(dir.path());
    let map = "map street --voxel-size 0.1 --max-range 30 -o a.vox";
    unfinished(dir.path(), map, "a.vox");
    fails(dir.path(), "map street --voxel-size 0.2 --max-range 30 -o a.vox", 1, &["voxel_size was 0.1 and is 0.2", "--restart", "another map"]);
    fails(dir.path(), &format!("{map} --max-scans 3 --optimize"), 1, &["--max-scans was none and is 3", "corrections was"]);
    // What is there can be looked at meanwhile.
    assert!(json(dir.path(), "info a.vox/unfinished --check --json")["scans"].as_u64().unwrap() >= 1);
    fails(dir.path(), "info a.vox", 1, &["unfinished"]);
    // Data that were changed.
    let scan = dir.path().join("street/scans/000050.pcd");
    let bytes = fs::read(&scan).unwrap();
    fs::write(&scan, &bytes[..bytes.len() - 12]).unwrap();
    fails(dir.path(), map, 1, &["its data are others"]);
    // A journal or state that is damaged is not gone on with.
    fs::write(&scan, &bytes).unwrap();
    works(dir.path(), "map street --voxel-size 0.4 -o a.vox --restart --max-scans 5 -q");
    assert!(!dir.path().join("a.vox/unfinished").exists());
    fails(dir.path(), "map street --voxel-size 0.4 -o a.vox --resume", 1, &["no run that did not end"]);
    // With as many scans in the map that is there, the other run loses nothing.
    unfinished(dir.path(), "map street --optimize --voxel-size 0.1 -o b.vox", "b.vox");
    let unfinished = dir.path().join("b.vox/unfinished");
    let journal = fs::read_dir(&unfinished).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().is_some_and(|e| e == "vxj")).unwrap();
    let mut bytes = fs::read(&journal).unwrap();
    bytes[20] ^= 1;
    fs::write(&journal, bytes).unwrap();
    fails(dir.path(), "map street --optimize --voxel-size 0.1 -o b.vox", 1, &["cannot go on", ".vxj", "--restart", "repair"]);
}

#[test]
fn an_interrupted_run_goes_on_from_its_map() {
    let dir = tempfile::tempdir().unwrap();
    simulated(dir.path());
    let arguments = "map street --voxel-size 0.15 --max-range 30 -o a.vox";
    let mut child = voxelastic(dir.path()).args(arguments.split_whitespace()).args(["--checkpoints", "3"]).stderr(Stdio::null()).spawn().unwrap();
    while !dir.path().join("a.vox/unfinished/manifest.json").exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(1));
    }
    rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::INT).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let before = json(dir.path(), "info a.vox --json")["scans"].as_u64().unwrap();
    let done = run(dir.path(), &format!("{arguments} --json"));
    assert!(done.code == Some(0) && done.err.contains("going on with the run that did not end"), "{}", done.err);
    let summary: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert!(summary["scans"].as_u64().unwrap() > before, "{summary}");
    works(dir.path(), &arguments.replace("a.vox", "whole.vox"));
    assert!(content(&dir.path().join("a.vox")) == content(&dir.path().join("whole.vox")));
}
