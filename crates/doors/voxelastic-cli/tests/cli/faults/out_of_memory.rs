//! Memory that ends while a map is made.

use crate::{json, room, voxelastic, works};
use std::process::{Command, Stdio};
use voxelastic_io::store::MapStore;

/// Maps with limits on the address space, each larger, until one is reached after the first checkpoint: the message says what helps, and what was mapped is
/// gone on with.
#[test]
fn memory_that_ends_is_named_and_the_run_goes_on() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    works(dir, "simulate street -o street --laps 1 --spacing 4 --columns 1024 -q");
    let map = "map street --voxel-size 0.06 --field both --threads 1 --checkpoints 4";
    let mut messages = Vec::new();
    let limited = |megabytes: usize, arguments: &str| {
        let script = format!("ulimit -v {}; exec \"$0\" {arguments}", megabytes * 1000);
        let output = Command::new("sh").args(["-c", &script, env!("CARGO_BIN_EXE_voxelastic")]).current_dir(dir).stdin(Stdio::null()).output();
        let output = output.unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    for megabytes in (300..1500).step_by(50) {
        let (code, message) = limited(megabytes, &format!("{map} -o a.vox"));
        assert_ne!(code, Some(0), "{megabytes} MB were enough: {messages:#?}");
        messages.push(message);
        if dir.join("a.vox/unfinished/manifest.json").exists() {
            assert_eq!(code, Some(1), "{megabytes} MB: {messages:#?}");
            break;
        }
    }
    let message = messages.last().unwrap();
    assert!(
        ["error: out of memory", "--memory", "--voxel-size", "the same command goes on"].iter().all(|words| message.contains(words)),
        "{message}"
    );
    let kept = json(dir, "info a.vox/unfinished --check --json")["scans"].as_u64().unwrap();
    assert!(kept >= 4, "{kept} scans");
    let output = voxelastic(dir).args(format!("{map} -o a.vox --memory 200MB").split(' ')).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && message.contains("going on with the run"), "{message}");
    works(dir, &format!("{map} -o whole.vox"));
    let names = |map: &str| MapStore::open(dir.join(map)).unwrap().manifest().submaps.iter().map(|entry| entry.file.clone()).collect::<Vec<_>>();
    assert_eq!(names("a.vox"), names("whole.vox"), "names have the hash of the content");
}

/// A file that says that it is larger than memory is damaged, and no reason to end without a word.
#[test]
fn a_length_that_nobody_has_memory_for_is_an_error_of_the_file() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    room::write(&dir.join("room"), 3);
    let scan = dir.join("room/scans/000001.pcd");
    let text = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4000000000\nHEIGHT 100\nPOINTS 400000000000\nDATA binary\n";
    std::fs::write(scan, text).unwrap();
    let done = json(dir, "map room -o a.vox --voxel-size 0.1 --json");
    assert_eq!((done["scans"].as_u64(), done["scans_skipped"].as_u64()), (Some(2), Some(1)));
}

/// A large request that is refused ends the command as a small one does, and the file is named.
#[test]
fn a_large_scan_that_nobody_has_memory_for_is_named() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    room::write(&dir.join("room"), 3);
    let points = 35_000_000;
    let head = format!("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA binary\n");
    let scan = dir.join("room/scans/000001.pcd");
    std::fs::write(&scan, &head).unwrap();
    std::fs::File::options().write(true).open(&scan).unwrap().set_len(head.len() as u64 + 12 * points).unwrap();
    // Enough for the bytes of the file, and not for its points.
    let script = "ulimit -v 1000000; exec \"$0\" map room -o a.vox --threads 1";
    let output = Command::new("sh").args(["-c", script, env!("CARGO_BIN_EXE_voxelastic")]).current_dir(dir).stdin(Stdio::null()).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(["error: out of memory", "room/scans/00000", "--memory"].iter().all(|words| message.contains(words)), "{message}");
}
