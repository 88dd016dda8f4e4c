//! 2-D maps for robots.

use crate::{fails, json, room, run, works};
use std::path::Path;
use std::process::Command;

/// What another reader of such maps says.
fn read_back(python: &str, file: &Path) -> serde_json::Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/results/map_server.py");
    let output = Command::new(python).arg(script).arg(file).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn cells(answer: &serde_json::Value) -> Vec<i64> {
    answer["cells"].as_array().unwrap().iter().map(|cell| cell.as_i64().unwrap()).collect()
}

#[test]
fn a_2d_map_is_read_back_by_the_rules_of_map_server() {
    let Some(python) = voxelastic_testing::python("yaml, PIL, numpy") else { return };
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 20);
    works(dir.path(), "map room --voxel-size 0.1 --max-range 20 --field both");
    let summary = json(dir.path(), "export room.vox -o map.yaml --json");
    let storey = &summary["storeys"][0];
    assert_eq!((summary["storeys"].as_array().unwrap().len(), storey["file"].as_str()), (1, Some("map.yaml")));
    assert!(storey["height_m"].as_f64().unwrap().abs() < 0.03, "{summary}");
    let map = read_back(&python, &dir.path().join("map.yaml"));
    let (size, trinary) = ([0, 1].map(|k| map["size"][k].as_i64().unwrap()), cells(&map));
    let count = |value: i64| trinary.iter().filter(|cell| **cell == value).count() as u64;
    assert_eq!([count(0), count(100), count(-1)], ["free", "occupied", "unknown"].map(|key| storey[key].as_u64().unwrap()));
    let at = |x: f64, y: f64| {
        let [i, j] = [(x, 0), (y, 1)].map(|(c, k)| ((c - map["origin"][k].as_f64().unwrap()) / 0.1).floor() as i64);
        // What is outside of the map is unknown.
        if i >= 0 && j >= 0 && i < size[0] && j < size[1] { trinary[(i + size[0] * j) as usize] } else { -1 }
    };
    // The middle, walls, the side of the pillar that was seen, and what is behind a wall.
    assert_eq!([at(6.05, -1.05), at(9.05, 0.05), at(2.05, 3.05), at(4.05, 1.55), at(9.55, 0.05)], [0, 100, 100, 100, -1]);
    // Where a cell lies follows from its size alone.
    assert!((0..2).all(|k| (map["origin"][k].as_f64().unwrap() / 0.1).rem_euclid(1.0).min(1e-9) < 1e-8), "{}", map["origin"]);
    // The other modes say the same of free, occupied and unknown, and costs.
    let read = |mode: &str| {
        works(dir.path(), &format!("export room.vox -o {mode}.yaml --mode {mode}"));
        cells(&read_back(&python, &dir.path().join(format!("{mode}.yaml"))))
    };
    let [raw, scale] = [read("raw"), read("scale")];
    for ((trinary, raw), scale) in trinary.iter().zip(raw).zip(scale) {
        assert_eq!(*trinary, if (1..100).contains(&raw) { 0 } else { raw });
        assert!((raw - scale).abs() <= 2, "{raw} {scale}");
    }
}

#[test]
fn what_cannot_be_a_2d_map_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 3);
    works(dir.path(), "map room -o surfaces.vox --voxel-size 0.1 --max-range 20");
    fails(dir.path(), "export surfaces.vox -o map.yaml", 1, &["no occupancy", "--field both"]);
    works(dir.path(), "map room --voxel-size 0.1 --max-range 20 --field occupancy");
    // Where floors end is known from surfaces only.
    let said = run(dir.path(), "export room.vox -o map.yaml");
    assert!(said.code == Some(0) && said.err.contains("the map has no surfaces") && said.err.contains("--field both"), "{}", said.err);
    fails(dir.path(), "export room.vox -o map.yaml --resolution 0.01", 2, &["cells of 0.01 m", "0.05"]);
    fails(dir.path(), "export room.vox -o map.yaml --step 3", 2, &["largest step is 3"]);
    fails(dir.path(), "export room.vox -o map.yaml --voxel-size 0.2", 2, &["--resolution"]);
    fails(dir.path(), "export room.vox -o room.ply --slope 10", 2, &["--slope is for 2-D maps"]);
}

/// Ramps, a kerb, a table, a bar.
#[test]
fn low_obstacles_are_not_free_and_the_floor_is_followed() {
    let floor = measured("yard", "os1-64");
    let share = |part: &str| floor[part].as_f64().unwrap() / floor["free"].as_f64().unwrap();
    assert_eq!((floor["storeys"].as_u64(), floor["free_but_deep"].as_u64()), (Some(1), Some(0)), "{floor}");
    assert!(floor["free"].as_u64().unwrap() > 10_000 && share("free_but_blocked") < 5e-3, "{floor}");
    // Of the platform of 0.8 m at most the cells in which its edge is.
    assert!(share("free_but_no_floor") < 1e-3, "{floor}");
    assert!(share("occupied_but_far") < 5e-3 && floor["height_median_m"].as_f64().unwrap() < 0.015, "{floor}");
}

#[test]
fn a_house_with_stairs_has_two_storeys() {
    let floor = measured("house", "os0-64");
    assert_eq!((floor["storeys"].as_u64(), floor["free_but_deep"].as_u64()), (Some(2), Some(0)), "{floor}");
    assert!(floor["free"].as_u64().unwrap() > 5_000, "{floor}");
}

/// The floor of the map of a simulated world, compared with that.
fn measured(world: &str, sensor: &str) -> serde_json::Value {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("simulate {world} -o {world} --sensor {sensor} --drift 0 --columns 512 --spacing 1 --scans 115"));
    works(dir.path(), &format!("map {world} -o {world}.vox --field both --voxel-size 0.08 --max-range 20"));
    json(dir.path(), &format!("eval {world}.vox --truth {world} --field occupancy --max-points 1000 --json"))["floor"].clone()
}
