//! Paths through maps.

use crate::{fails, json, room, works};

const QUICK: &str = "--voxel 0.1 --max-range 20";

fn mapped(field: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 20);
    works(dir.path(), &format!("map room --field {field} {QUICK}"));
    dir
}

#[test]
fn a_path_is_written_drawn_and_summed_up() {
    let dir = mapped("occupancy");
    let ask = "plan room.vox --start 0,-1,1.2 --goal 6,1.5,1.2 --radius 0.25 --samples 400 --time 60 -o path.json --picture path.png --json";
    let said = json(dir.path(), ask);
    let file: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(dir.path().join("path.json")).unwrap()).unwrap();
    for key in ["length_m", "least_clearance_m", "first_path_s", "start", "goal", "unknown", "samples"] {
        assert_eq!(said[key], file[key], "{key}");
    }
    let path = file["path"].as_array().unwrap();
    assert_eq!((&path[0], &path[path.len() - 1]), (&serde_json::json!([0.0, -1.0, 1.2]), &serde_json::json!([6.0, 1.5, 1.2])));
    assert_eq!(said["waypoints"].as_u64(), Some(path.len() as u64));
    assert_eq!(file["clearance_m"].as_array().unwrap().len(), path.len());
    assert_eq!(file["anchors"].as_array().unwrap().len(), path.len());
    let tree = [&file["tree"]["points"], &file["tree"]["parents"]].map(|v| v.as_array().unwrap().len());
    assert!(tree[0] == tree[1] && said["tree_nodes"].as_u64() == Some(tree[0] as u64));
    assert!(file["tree"]["parents"][0].is_null());
    let (length, straight) = (said["length_m"].as_f64().unwrap(), said["straight_m"].as_f64().unwrap());
    assert!(length >= straight && length < 1.2 * straight && said["least_clearance_m"].as_f64().unwrap() >= 0.2499, "{said}");
    assert!(std::fs::read(dir.path().join("path.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(!dir.path().join("path.json.part").exists());
    // Enough samples before the time is up: the same again.
    assert_eq!(json(dir.path(), ask)["length_m"], said["length_m"]);
    let rolling =
        json(dir.path(), "plan room.vox --start 0,-1,1.2 --goal 6,0,1.0 --radius 0.25 --ground --height 0.6 --time 0.3 -o roll.json --json");
    assert_eq!((rolling["ground"].as_bool(), rolling["height_m"].as_f64()), (Some(true), Some(0.6)));
}

#[test]
fn what_cannot_be_planned_is_said_with_a_remedy() {
    let dir = mapped("occupancy");
    let ask = |start: &str, rest: &str| format!("plan room.vox --start {start} --goal 6,1,1.2 -o path.json {rest}");
    fails(dir.path(), &ask("-0.9,0,1.2", ""), 1, &["the start (-0.90, 0.00, 1.20)", "remedy: try --start -0."]);
    fails(dir.path(), &ask("90,0,1.2", ""), 1, &["outside of the map"]);
    fails(dir.path(), &ask("1,0,1.2", "--radius 5"), 1, &["m from the nearest obstacle", "--radius"]);
    fails(dir.path(), &ask("1,0,1.2", "--radius -1"), 2, &["0 to 100"]);
    fails(dir.path(), &ask("1,0", ""), 2, &["three numbers"]);
    fails(dir.path(), &ask("1,0,1.2", "--ground --height 0.1"), 2, &["height above the floor"]);
    fails(dir.path(), &ask("1,0,1.2", "--height 1"), 2, &["--ground"]);
    assert!(!dir.path().join("path.json").exists());
    let surfaces = mapped("tsdf");
    fails(surfaces.path(), &ask("1,0,1.2", ""), 1, &["no occupancy", "--field occupancy"]);
}
