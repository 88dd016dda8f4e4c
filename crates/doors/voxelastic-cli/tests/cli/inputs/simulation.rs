//! `simulate`: what is written, and what is never overwritten.

use crate::{fails, json, run, works};
use std::fs;
use std::path::Path;

/// Half a second of work: a small world, few beams.
pub const ROOM: &str = "simulate room --scans 6 --spacing 0.5 --columns 128";

fn files(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_simulated_folder_is_mapped_and_independent_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let report = json(dir.path(), &format!("{ROOM} -o one --threads 1 --json"));
    assert_eq!((report["scans"].as_u64(), report["interrupted"].as_bool(), report["world"].as_str()), (Some(6), Some(false), Some("room")));
    assert!((2.4..2.7).contains(&report["path_m"].as_f64().unwrap()) && report["largest_drift_m"].as_f64().unwrap() > 0.0, "{report}");
    works(dir.path(), &format!("{ROOM} -o two --threads 2"));
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    assert_eq!(files(&one), ["graph.g2o", "groundtruth.tum", "poses.tum", "scans", "world.toml"]);
    for file in ["graph.g2o", "groundtruth.tum", "poses.tum", "world.toml", "scans/000005.pcd"] {
        assert!(fs::read(one.join(file)).unwrap() == fs::read(two.join(file)).unwrap(), "{file}");
    }
    let map = json(dir.path(), "map one --voxel-size 0.1 --json");
    assert_eq!(map["scans"].as_u64(), Some(6));
}

#[test]
fn options_are_passed_to_the_simulation() {
    let dir = tempfile::tempdir().unwrap();
    works(
        dir.path(),
        "simulate room -o room --laps 0.3 --spacing 1 --columns 64 --sensor vlp-16 --noise 0 --drift 0 --seed 9 --moving --max-range 8",
    );
    let world = fs::read_to_string(dir.path().join("room/world.toml")).unwrap();
    for line in ["sensor = \"vlp-16\"", "seed = 9", "columns = 64", "drift = 0.0", "moving = true", "range_sigma = 0.0", "max_range = 8.0"] {
        assert!(world.contains(line), "{line} in\n{world}");
    }
    let read = |name: &str| fs::read_to_string(dir.path().join("room").join(name)).unwrap();
    assert_eq!(read("poses.tum"), read("groundtruth.tum"), "no drift");
    let scan = voxelastic_io::pcd::read(dir.path().join("room/scans/000001.pcd")).unwrap().cloud;
    assert_eq!((scan.height, scan.width), (16, 64));
}

#[test]
fn a_simulation_replaces_a_simulation_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} -o room"));
    let again = json(dir.path(), "simulate room --scans 2 --columns 64 -o room --json");
    assert_eq!(again["scans"].as_u64(), Some(2));
    assert_eq!(files(&dir.path().join("room/scans")), ["000000.pcd", "000001.pcd"]);
    assert!(!files(&dir.path().join("room")).contains(&".new".to_owned()));

    // With all that a simulation may write.
    for _ in 0..2 {
        works(dir.path(), "simulate street --scans 2 --columns 64 --traffic 2 --camera -o moving");
    }
    assert_eq!(files(&dir.path().join("moving/labels"))[0], "000000.label");

    fs::write(dir.path().join("room/thesis.tex"), "years").unwrap();
    fails(dir.path(), &format!("{ROOM} -o room"), 1, &["room", "thesis.tex", "remedy"]);
    fails(dir.path(), &format!("{ROOM} -o room/thesis.tex"), 1, &["thesis.tex", "a file"]);
    assert_eq!(fs::read_to_string(dir.path().join("room/thesis.tex")).unwrap(), "years");
}

#[test]
fn impossible_simulations_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    fails(dir.path(), "simulate moon -o moon", 2, &["campus", "mine", "street"]);
    fails(dir.path(), "simulate room -o room --sensor os9", 2, &["os9", "os1-64"]);
    fails(dir.path(), "simulate room -o room --spacing 0", 2, &["spacing", "metres"]);
    fails(dir.path(), "simulate room -o room --spacing nan", 2, &["spacing"]);
    fails(dir.path(), "simulate room -o room --laps 1 --spacing 0", 2, &[]);
    fails(dir.path(), "simulate room -o room --noise=-1", 2, &["noise"]);
    fails(dir.path(), "simulate room -o room --noise nan", 2, &["noise"]);
    fails(dir.path(), "simulate room -o room --scans 3 --laps 1", 2, &["--laps"]);
    assert_eq!(files(dir.path()).len(), 0, "nothing is left behind");
}

#[test]
fn sweeps_with_an_inertial_unit_are_written_as_a_folder_and_as_a_recording() {
    let dir = tempfile::tempdir().unwrap();
    let walk = "simulate room --scans 8 --columns 128 --moving --rate 10 --carrier handheld --rest 0.3 --traffic 2 --imu 200";
    works(dir.path(), &format!("{walk} -o folder"));
    let done = json(dir.path(), &format!("{walk} -o bag --bag --json"));
    assert_eq!(done["scans"].as_u64(), Some(8));
    assert_eq!(files(&dir.path().join("folder/imu")), ["samples.csv", "truth.tum"]);
    assert_eq!(files(&dir.path().join("bag")), ["graph.g2o", "groundtruth.tum", "imu", "poses.tum", "recording.mcap", "world.toml"]);
    assert_eq!(voxelastic_io::poses::read(dir.path().join("bag/imu/truth.tum")).unwrap().len(), 161, "0.8 s at 200 Hz");
    // The same scans and samples either way: the same trajectory.
    let folder = run(dir.path(), "odometry folder -o folder.tum");
    let bag = run(dir.path(), "odometry bag -o bag.tum");
    assert!(folder.err.contains("imu: 161 samples in imu/samples.csv") && bag.err.contains("imu: /imu"), "{}{}", folder.err, bag.err);
    let positions = |file: &str| voxelastic_io::poses::read(dir.path().join(file)).unwrap().poses;
    let apart = positions("folder.tum")
        .iter()
        .zip(positions("bag.tum"))
        .map(|(a, b)| (a.translation.vector - b.translation.vector).norm())
        .fold(0.0, f64::max);
    assert!(apart < 1e-6, "times are nanoseconds in the recording: {apart} m");
    works(dir.path(), &format!("{walk} -o bag --bag"));
    fails(dir.path(), "simulate room -o r --carrier horse", 2, &["horse", "handheld"]);
    fails(dir.path(), "simulate room -o r --imu 0", 2, &["imu.rate"]);
    fails(dir.path(), "odometry bag --imu-topic /nothing", 1, &["/nothing", "/imu", "--imu-topic"]);
}
