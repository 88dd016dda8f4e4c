//! Times of points in another unit than they seem: every command reads them alike.

use crate::{json, run, works};
use std::fs;
use std::path::Path;
use voxelastic_io::pcd;

/// A walk whose points have half of their times. Without poses, too, it is known how often clouds come.
fn walk(dir: &Path) {
    works(dir, "simulate room -o walk --sensor os1-32 --columns 256 --rate 10 --scans 60 --carrier handheld --moving --drift 0 -q");
    for entry in fs::read_dir(dir.join("walk/scans")).unwrap() {
        let path = entry.unwrap().path();
        let mut cloud = pcd::read(&path).unwrap().cloud;
        cloud.time.iter_mut().flatten().for_each(|t| *t *= 0.5);
        pcd::write(&path, &cloud).unwrap();
    }
    let poses = fs::read_to_string(dir.join("walk/groundtruth.tum")).unwrap();
    let times: String = poses.lines().filter(|line| !line.starts_with('#')).map(|line| format!("{}\n", line.split(' ').next().unwrap())).collect();
    fs::write(dir.join("walk/times.txt"), times).unwrap();
}

/// The submaps of a map as they are stored.
fn submaps(map: &Path) -> Vec<Vec<u8>> {
    let mut files: Vec<_> =
        fs::read_dir(map).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.extension().is_some_and(|e| e == "vxs")).collect();
    files.sort();
    assert!(!files.is_empty());
    files.iter().map(|file| fs::read(file).unwrap()).collect()
}

#[test]
fn times_that_surfaces_contradict_are_read_alike_by_every_command() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    walk(dir);
    let common = "--voxel-size 0.1 --poses groundtruth --every scan";
    let made = json(dir, &format!("map walk -o map.vox {common} --json"));
    let codes = |warnings: &serde_json::Value| -> Vec<String> {
        warnings.as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(codes(&made["warnings"]), ["times-changed"], "{made}");
    works(dir, &format!("map walk -o off.vox {common} --poses-check off"));
    works(dir, &format!("map walk -o named.vox {common} --point-times over-interval"));
    works(dir, &format!("live --from walk -o live.vox {common} --rate max"));
    works(dir, &format!("map walk -o given.vox {common} --point-times given"));
    let whole = submaps(&dir.join("map.vox"));
    for same in ["off.vox", "named.vox", "live.vox"] {
        assert!(submaps(&dir.join(same)) == whole, "{same}");
    }
    assert!(submaps(&dir.join("given.vox")) != whole);
    // The odometry and held-out scans are read so, too.
    let said = |arguments: &str| run(dir, arguments).err;
    assert!(said("odometry walk").contains("a sweep is taken to last"), "odometry");
    assert!(said("heldout map.vox walk --poses groundtruth --hold-out 10").contains("a sweep is taken to last"), "heldout");
    let checked = run(dir, "check walk --poses groundtruth");
    assert_eq!(checked.code, Some(3), "{}", checked.err);
}
