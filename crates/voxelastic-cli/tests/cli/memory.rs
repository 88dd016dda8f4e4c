//! The memory budget.

use crate::{fails, json, works};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// The submap files of a map.
fn submaps(map: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(map).unwrap().map(|entry| entry.unwrap().path());
    let found = entries.filter(|path| path.extension().is_some_and(|end| end == "vxs"));
    found.map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(path).unwrap())).collect()
}

/// Maps a street with and without a budget: the same bits, in less memory. Half of the memory without one has to do, but the bound is wider: on a
/// busy machine the thread that gives memory back may come late.
#[test]
fn a_map_larger_than_its_budget_is_the_same_map() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    works(dir, "simulate street -o street --laps 1 --spacing 4 --columns 1024 -q");
    let map = "map street --voxel-size 0.05 --field both --threads 2 --json -q";
    let free = json(dir, &format!("{map} -o free.vox"));
    let peak = free["peak_rss_mb"].as_f64().unwrap();
    let budget = (peak / 2.0).floor();
    let within = json(dir, &format!("{map} -o within.vox --memory {budget}MB"));
    let limited = within["peak_rss_mb"].as_f64().unwrap();
    println!("{peak:.0} MB without a budget; {limited:.0} MB with one of {budget} MB");
    assert!(peak > 200.0, "the map has to be large: {peak} MB");
    assert!(limited < (budget + peak) / 2.0, "{limited} MB, budget {budget} MB, {peak} MB without");
    assert_eq!(free["submaps"], within["submaps"]);
    assert!(submaps(&dir.join("free.vox")) == submaps(&dir.join("within.vox")), "the maps differ");

    for command in ["mesh free.vox", "export free.vox"] {
        works(dir, &format!("{command} -o free.ply -q"));
        works(dir, &format!("{command} -o within.ply -q --memory {budget}MB"));
        assert!(fs::read(dir.join("free.ply")).unwrap() == fs::read(dir.join("within.ply")).unwrap(), "{command}");
    }
}

#[test]
fn a_budget_that_cannot_be_kept_is_refused() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    works(dir, "simulate room -o room --scans 4 --columns 128 -q");
    fails(dir, "map room -o x.vox --memory much", 2, &["500MB"]);
    let nowhere = |arguments: &str, folder: &str| {
        let finished = crate::voxelastic(dir).args(arguments.split(' ')).env("TMPDIR", folder).output().unwrap();
        let message = String::from_utf8_lossy(&finished.stderr).into_owned();
        assert!(!finished.status.success() && message.contains(folder), "{message}");
        message
    };
    nowhere("map room -o x.vox --memory 500MB", "/no/such/folder");
    if Path::new("/dev/shm").is_dir() {
        assert!(nowhere("map room -o x.vox --memory 500MB", "/dev/shm").contains("TMPDIR"));
    }
    works(dir, "map room -o y.vox -q");
    nowhere("mesh y.vox -o y.ply --memory 500MB", "/no/such/folder");
    assert!(!dir.join("x.vox").join("manifest.json").exists() && !dir.join("y.ply").exists());
}
