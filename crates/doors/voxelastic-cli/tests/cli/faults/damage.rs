//! Damaged maps: what is whole can be used, and nothing that is whole is lost.

use crate::{fails, json, room, run, works};
use std::fs;
use std::path::{Path, PathBuf};

/// A map of a room in several submaps; its submap files by name.
fn map_of_submaps(dir: &Path, more: &str) -> Vec<PathBuf> {
    room::write(&dir.join("room"), 8);
    let submaps = json(dir, &format!("map room --lambda-odom 0.6 --lambda-cluster 0.1 --json {more}"))["submaps"].as_u64().unwrap();
    assert!(submaps >= 3, "{submaps} submaps are too few to lose one");
    let mut files: Vec<PathBuf> = fs::read_dir(dir.join("room.vox")).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "vxs"));
    files.sort();
    assert_eq!(files.len() as u64, submaps);
    files
}

/// Changes the byte in the middle of a file.
fn damage(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(path, bytes).unwrap();
}

#[test]
fn every_command_can_leave_out_a_damaged_submap() {
    let dir = tempfile::tempdir().unwrap();
    let files = map_of_submaps(dir.path(), "--field both --hold-out 8");
    works(dir.path(), "plan room.vox --start -0.42,0.15,1.14 --goal 0.5,0,1.2 --radius 0.1 -o good.json");
    damage(&files[1]);
    for command in [
        "mesh room.vox -o a.ply",
        "export room.vox -o a.las",
        "export room.vox -o a.bt",
        "render room.vox -o a.png",
        "slice room.vox --z 1 -o a.png",
        "report room.vox -o a.html",
        "plan room.vox --start -0.42,0.15,1.14 --goal 0.5,0,1.2 --radius 0.1 -o path.json",
        "plan room.vox --recheck good.json",
        "heldout room.vox room --hold-out 8",
        "eval room.vox --truth a.ply --no-align",
        "info room.vox --check",
    ] {
        fails(dir.path(), command, 1, &[files[1].file_name().unwrap().to_str().unwrap(), "--skip-damaged", "voxelastic repair room.vox"]);
        let done = run(dir.path(), &format!("{command} --skip-damaged --json"));
        assert!(done.code == Some(0) || command.contains("--recheck"), "{command}: {}", done.err);
        let summary: serde_json::Value = serde_json::from_str(&done.out).unwrap();
        assert_eq!(summary["submaps_damaged"], 1, "{command}: {summary}");
        assert!(done.err.contains(&format!("1 of {} submaps", files.len())), "{command}: {}", done.err);
    }
    // A submap whose file is gone is noticed without reading the files.
    fs::remove_file(&files[1]).unwrap();
    fails(dir.path(), "info room.vox", 1, &["missing", "--skip-damaged"]);
    assert_eq!(json(dir.path(), "info room.vox --skip-damaged --json")["submaps_damaged"], 1);
    // All of them: there is nothing to use.
    files.iter().filter(|file| file.exists()).for_each(|file| damage(file));
    fails(dir.path(), "mesh room.vox -o b.ply --skip-damaged", 1, &["voxelastic repair"]);
}

#[test]
fn repair_takes_damaged_submaps_out_and_changes_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let files = map_of_submaps(dir.path(), "");
    let manifest = || fs::read(dir.path().join("room.vox/manifest.json")).unwrap();
    let before = manifest();
    let done = json(dir.path(), "repair room.vox --json");
    assert_eq!((done["manifest"].as_str(), done["submaps_damaged"].as_u64()), (Some("whole"), Some(0)));
    assert!(manifest() == before, "a whole map was changed");
    damage(&files[1]);
    let done = json(dir.path(), "repair room.vox --json");
    assert_eq!((done["submaps"].as_u64(), done["submaps_damaged"].as_u64()), (Some(files.len() as u64 - 1), Some(1)));
    assert!(done["set_aside"][0].as_str().unwrap().ends_with(".vxs.damaged"), "{done}");
    assert_eq!(json(dir.path(), "info room.vox --check --json")["submaps_damaged"], 0);
    works(dir.path(), "mesh room.vox -o a.ply");
}

#[test]
fn a_lost_manifest_is_made_again_from_the_submap_files() {
    let dir = tempfile::tempdir().unwrap();
    map_of_submaps(dir.path(), "--field both");
    works(dir.path(), "mesh room.vox -o before.ply");
    let manifest = dir.path().join("room.vox/manifest.json");
    let before = fs::read_to_string(&manifest).unwrap();
    for damaged in [None, Some("{}"), Some(&before[..before.len() / 2])] {
        match damaged {
            None => fs::remove_file(&manifest).unwrap(),
            Some(text) => fs::write(&manifest, text).unwrap(),
        }
        fails(dir.path(), "mesh room.vox -o after.ply", 1, &["voxelastic repair"]);
        fails(dir.path(), "info room.vox", 1, &["voxelastic repair"]);
        assert_eq!(json(dir.path(), "repair room.vox --json")["manifest"], "rebuilt");
        assert_eq!(fs::read_to_string(&manifest).unwrap(), before);
        works(dir.path(), "mesh room.vox -o after.ply");
        assert!(fs::read(dir.path().join("after.ply")).unwrap() == fs::read(dir.path().join("before.ply")).unwrap(), "another mesh");
    }
    assert!(dir.path().join("room.vox/manifest.json.damaged").is_file());
    // A folder without submaps has nothing to repair.
    fs::create_dir(dir.path().join("empty")).unwrap();
    fails(dir.path(), "repair empty", 1, &["no manifest and no submap files"]);
    fails(dir.path(), "repair nothing", 1, &["nothing"]);
}

#[test]
fn mapping_over_a_damaged_map_sets_it_aside() {
    let dir = tempfile::tempdir().unwrap();
    let files = map_of_submaps(dir.path(), "");
    let manifest = dir.path().join("room.vox/manifest.json");
    fs::write(&manifest, "{ half").unwrap();
    let done = run(dir.path(), "map room --json");
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(done.err.contains("set aside as room-damaged.vox"), "{}", done.err);
    assert_eq!(json(dir.path(), "info room.vox --check --json")["scans"], 8);
    assert_eq!(json(dir.path(), "repair room-damaged.vox --json")["submaps"], files.len());
    // What is not a map of ours is not touched.
    fs::create_dir(dir.path().join("web.vox")).unwrap();
    fs::write(dir.path().join("web.vox/manifest.json"), "{}").unwrap();
    fails(dir.path(), "map room -o web.vox", 1, &["not a Voxelastic map"]);
}

#[test]
fn mapping_again_writes_a_damaged_submap_again() {
    let dir = tempfile::tempdir().unwrap();
    let files = map_of_submaps(dir.path(), "");
    damage(&files[1]);
    fails(dir.path(), "info room.vox --check", 1, &["checksum"]);
    works(dir.path(), "map room --lambda-odom 0.6 --lambda-cluster 0.1");
    assert_eq!(json(dir.path(), "info room.vox --check --json")["submaps_damaged"], 0);
}

#[test]
fn a_voxel_size_out_of_range_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    map_of_submaps(dir.path(), "");
    let manifest = dir.path().join("room.vox/manifest.json");
    let text = fs::read_to_string(&manifest).unwrap().replace("\"voxel_size\": \"", "\"voxel_size\": \"70000000");
    // With a checksum that fits, as an editor that means well would write it.
    let at = text.find("\"crc32\": \"").unwrap() + 10;
    let zeros = format!("{}00000000{}", &text[..at], &text[at + 8..]);
    let crc = format!("{:08x}", crc32(zeros.as_bytes()));
    fs::write(&manifest, zeros.replacen("00000000", &crc, 1)).unwrap();
    fails(dir.path(), "mesh room.vox -o a.ply", 1, &["manifest.json", "voxel_size = 70000000", "must be"]);
}

fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = !0u32;
    for byte in bytes {
        crc ^= u32::from(*byte);
        (0..8).for_each(|_| crc = if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 });
    }
    !crc
}
