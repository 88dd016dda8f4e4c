//! Full disks: the map stays in memory until a disk takes it, and files that were there before stay as they were.

use crate::{Finished, fails, json, room, run, voxelastic, works};
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::Stdio;
use voxelastic_testing::SmallDisk;

/// What a folder holds: contents by name, without the lock, which names the last process that wrote.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries
        .filter(|entry| entry.path().is_file() && entry.file_name() != ".lock")
        .map(|e| (e.file_name().into_string().unwrap(), fs::read(e.path()).unwrap()))
        .collect()
}

fn scans(dir: &Path, map: &str) -> u64 {
    json(dir, &format!("info {map} --check --json"))["scans"].as_u64().unwrap()
}

/// A room of `count` scans and a small disk at `disk`.
fn room_and_disk(dir: &Path, count: usize, bytes: usize) -> Option<SmallDisk> {
    room::write(&dir.join("room"), count);
    SmallDisk::mount(&dir.join("disk"), bytes)
}

#[test]
fn a_map_that_does_not_fit_is_saved_elsewhere() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = room_and_disk(dir.path(), 3, 64 << 10) else { return };
    let done = run(dir.path(), "map room -o disk/room.vox --json");
    assert_eq!(done.code, Some(3), "{}", done.err);
    let summary: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert!(done.err.contains("No space left on device") && done.err.contains("saved as"), "{}", done.err);
    let output = summary["output"].as_str().unwrap();
    assert!(Path::new(output).ends_with("room.vox") && !output.contains("disk"), "{output}");
    assert_eq!(scans(dir.path(), output), 3);
    // Nothing is left that keeps the disk full.
    assert_eq!(fs::read_dir(disk.folder()).unwrap().count(), 0);
    // A map that is there already is not replaced by one from a full disk.
    let again = run(dir.path(), "map room --max-scans 2 -o disk/room.vox --json");
    assert_eq!(again.code, Some(3), "{}", again.err);
    assert_eq!(scans(dir.path(), output), 3);
}

#[test]
fn a_save_that_fails_leaves_the_old_map_and_no_orphans() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = room_and_disk(dir.path(), 3, 512 << 10) else { return };
    works(dir.path(), "map room -o disk/room.vox --max-scans 1 --voxel-size 0.3");
    let before = contents(&disk.folder().join("room.vox"));
    disk.fill();
    let words = ["No space left on device", "of 3 scans is lost", "room.vox", "remedy"];
    fails(dir.path(), "map room -o disk/room.vox --on-full-disk fail", 1, &words);
    assert!(contents(&disk.folder().join("room.vox")) == before, "the map that was there changed");
    assert_eq!(scans(dir.path(), "disk/room.vox"), 1);
}

#[test]
fn waiting_ends_when_there_is_space() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = room_and_disk(dir.path(), 3, 8 << 20) else { return };
    works(dir.path(), "map room -o disk/room.vox --max-scans 1");
    let ballast = disk.fill();
    let mut map = voxelastic(dir.path());
    let mut child = map.args("map room -o disk/room.vox --on-full-disk wait".split(' ')).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.by_ref().any(|line| line.contains("in memory") && line.contains("waiting")));
    fs::remove_file(ballast).unwrap();
    let log = lines.collect::<Vec<_>>().join("\n");
    assert_eq!(child.wait().unwrap().code(), Some(0), "{log}");
    assert_eq!(scans(dir.path(), "disk/room.vox"), 3);
}

#[test]
fn waiting_ends_with_an_interrupt_and_the_map_is_saved_elsewhere() {
    use rustix::process::{Pid, Signal, kill_process};
    let dir = tempfile::tempdir().unwrap();
    let Some(_disk) = room_and_disk(dir.path(), 3, 64 << 10) else { return };
    let mut map = voxelastic(dir.path());
    let mut child = map.args("map room -o disk/room.vox --on-full-disk wait".split(' ')).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.by_ref().any(|line| line.contains("waiting")));
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    let log = lines.collect::<Vec<_>>().join("\n");
    assert_eq!(child.wait().unwrap().code(), Some(3), "{log}");
    assert_eq!(scans(dir.path(), "room.vox"), 3);
}

#[test]
fn a_map_beside_which_nothing_can_be_written_is_kept_too() {
    let dir = tempfile::tempdir().unwrap();
    let Some(maps) = room_and_disk(dir.path(), 4, 64 << 10) else { return };
    let Some(_inner) = SmallDisk::mount(&maps.folder().join("room.vox"), 64 << 20) else { return };
    maps.make_read_only();
    works(dir.path(), "map room -o disk/room.vox");
    let done = run(dir.path(), "map room -o disk/room.vox --max-scans 2 --json");
    assert_eq!(done.code, Some(3), "{}", done.err);
    let summary: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!((scans(dir.path(), "disk/room.vox"), scans(dir.path(), summary["output"].as_str().unwrap())), (4, 2));
}

#[test]
fn good_files_survive_a_full_disk() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = room_and_disk(dir.path(), 3, 16 << 20) else { return };
    works(dir.path(), "map room --field both");
    let commands = [
        "report room.vox -o disk/room.html",
        "render room.vox -o disk/room.png",
        "slice room.vox --z 1 -o disk/slice.png",
        "mesh room.vox -o disk/room.ply",
        "export room.vox -o disk/room.laz",
    ];
    commands.iter().for_each(|command| drop(works(dir.path(), command)));
    disk.fill();
    let before = contents(disk.folder());
    for command in commands {
        let Finished { code, err, .. } = fails(dir.path(), command, 1, &["No space left on device"]);
        assert_eq!(code, Some(1), "{command}: {err}");
        assert!(contents(disk.folder()) == before, "{command} changed what was there");
    }
}
