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
    works(dir, "simulate street -o street --scans 50 --spacing 4 --columns 1024 -q");
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
    what_is_made_of_it_keeps_the_budget(dir);
}

/// What is made of a map is part of the budget: the same files, in less memory. The bound is as wide as above.
fn what_is_made_of_it_keeps_the_budget(dir: &Path) {
    const BUDGET: f64 = 70.0;
    works(dir, "mesh free.vox -o truth.ply --lod 2 -q");
    let commands = [
        ("mesh free.vox -o", "mesh.ply"),
        ("export free.vox -o", "cloud.laz"),
        ("export free.vox --voxel-size 0.1 -o", "octomap.ot"),
        ("report free.vox -o", "report.html"),
        ("eval free.vox --lod 1 --truth truth.ply --error-ply", "errors.ply"),
    ];
    for (command, file) in commands {
        let peaks = ["", &format!("--memory {BUDGET}MB")].map(|memory| {
            let arguments = format!("{command} {}{file} --threads 2 -q {memory}", if memory.is_empty() { "free-" } else { "within-" });
            peak(dir, &arguments)
        });
        let [free, within] = peaks;
        println!("{command} {file}: {free:.0} MB without a budget; {within:.0} MB with one of {BUDGET} MB");
        let read = |kind: &str| fs::read(dir.join(format!("{kind}-{file}"))).unwrap();
        assert!(read("free") == read("within"), "{command}");
        assert!(free > 2.0 * BUDGET, "{command} has to take much: {free} MB");
        assert!(within < (BUDGET + free) / 2.0, "{command}: {within} MB, {free} MB without a budget");
    }
}

/// Runs the command and returns its peak resident memory, megabytes, as the system had it a moment before its end.
fn peak(dir: &Path, arguments: &str) -> f64 {
    let mut child = crate::voxelastic(dir).args(arguments.split_whitespace()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak = 0.0;
    loop {
        let finished = child.try_wait().unwrap();
        let text = fs::read_to_string(&status).unwrap_or_default();
        if let Some(line) = text.lines().find_map(|line| line.strip_prefix("VmHWM:")) {
            peak = line.trim().trim_end_matches(" kB").parse::<f64>().unwrap() * 1024.0 / 1e6;
        }
        if let Some(finished) = finished {
            assert!(finished.success(), "voxelastic {arguments}");
            return peak;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
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

/// The memory of a node that maps the same room again and again, which grows by what a correction needs of each scan: with what checkpoints and published paths needed for a
/// moment, and with the log of the run, it grew by 2.2 kB a scan; by 0.6 without.
#[cfg(feature = "foxglove")]
#[test]
fn a_node_that_runs_for_long_does_not_grow_by_more_than_it_needs() {
    const ROUNDS: usize = 50;
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate room -o room --laps 1 --rate 10 --columns 64");
    let (round, long) = (dir.path().join("room"), dir.path().join("long"));
    let poses = fs::read_to_string(round.join("groundtruth.tum")).unwrap();
    let poses: Vec<&str> =
        poses.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.split_once(' ').map(|(_, pose)| pose)).collect();
    fs::create_dir_all(long.join("scans")).unwrap();
    let mut tum = String::new();
    for k in 0..ROUNDS * poses.len() {
        let scan = round.join(format!("scans/{:06}.pcd", k % poses.len()));
        fs::hard_link(scan, long.join(format!("scans/{k:06}.pcd"))).unwrap();
        tum += &format!("{:.3} {}\n", 0.1 * k as f64, poses[k % poses.len()]);
    }
    fs::write(long.join("poses.tum"), tum).unwrap();
    let flags = "--rate max --every scan --checkpoints 25 --voxel-size 0.2 --max-range 12 --foxglove=127.0.0.1:0 --threads 1";
    works(dir.path(), &format!("live --from long {flags}"));
    let log: serde_json::Value = serde_json::from_slice(&fs::read(dir.path().join("long.vox/run.json")).unwrap()).unwrap();
    let resident: Vec<f64> = log["scans"]["rss_mb"].as_array().unwrap().iter().map(|mb| mb.as_f64().unwrap()).collect();
    assert_eq!(resident.len(), ROUNDS * poses.len());
    // The first quarter has what is made once.
    let mean = |from: usize| resident[from..from + 200].iter().sum::<f64>() / 200.0;
    let [begin, end] = [resident.len() / 4, resident.len() - 200];
    let kb_a_scan = 1e3 * (mean(end) - mean(begin)) / (end - begin) as f64;
    println!("{} scans: {:.1} MB at a quarter, {:.1} MB at the end, {kb_a_scan:.2} kB a scan", resident.len(), mean(begin), mean(end));
    assert!(kb_a_scan < 0.8, "{kb_a_scan} kB a scan");
}
