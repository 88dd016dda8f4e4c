//! Paths through maps.

use crate::{fails, json, room, run, works};

const QUICK: &str = "--voxel-size 0.1 --max-range 20";

fn mapped(field: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 20);
    works(dir.path(), &format!("map room --field {field} {QUICK}"));
    dir
}

#[test]
fn a_path_is_written_drawn_and_summarised() {
    let dir = mapped("occupancy");
    let request = "plan room.vox --start 0,-1,1.2 --goal 6,1.5,1.2 --radius 0.25 --samples 400 --time 60 -o path.json --picture path.png --json";
    let summary = json(dir.path(), request);
    let file: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(dir.path().join("path.json")).unwrap()).unwrap();
    for key in ["length_m", "least_clearance_m", "first_path_s", "start", "goal", "unknown", "samples"] {
        assert_eq!(summary[key], file[key], "{key}");
    }
    let path = file["path"].as_array().unwrap();
    assert_eq!((&path[0], &path[path.len() - 1]), (&serde_json::json!([0.0, -1.0, 1.2]), &serde_json::json!([6.0, 1.5, 1.2])));
    assert_eq!(summary["waypoints"].as_u64(), Some(path.len() as u64));
    assert_eq!(file["clearance_m"].as_array().unwrap().len(), path.len());
    assert_eq!(file["anchors"].as_array().unwrap().len(), path.len());
    let tree = [&file["tree"]["points"], &file["tree"]["parents"]].map(|v| v.as_array().unwrap().len());
    assert!(tree[0] == tree[1] && summary["tree_nodes"].as_u64() == Some(tree[0] as u64));
    assert!(file["tree"]["parents"][0].is_null());
    let (length, straight) = (summary["length_m"].as_f64().unwrap(), summary["straight_m"].as_f64().unwrap());
    assert!(length >= straight && length < 1.2 * straight && summary["least_clearance_m"].as_f64().unwrap() >= 0.2499, "{summary}");
    assert!(std::fs::read(dir.path().join("path.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(!dir.path().join("path.json.part").exists());
    // Enough samples before the time is up: the same again.
    assert_eq!(json(dir.path(), request)["length_m"], summary["length_m"]);
    let rolling =
        json(dir.path(), "plan room.vox --start 0,-1,1.2 --goal 6,0,1.0 --radius 0.25 --ground --height 0.6 --time 0.3 -o roll.json --json");
    assert_eq!((rolling["ground"].as_bool(), rolling["height_m"].as_f64()), (Some(true), Some(0.6)));
}

#[test]
fn impossible_requests_have_a_remedy() {
    let dir = mapped("occupancy");
    let request = |start: &str, rest: &str| format!("plan room.vox --start {start} --goal 6,1,1.2 -o path.json {rest}");
    // In the wall, in the room beyond it, and too near to it: each says so and where the robot would fit.
    fails(
        dir.path(),
        &request("1,-3.02,1.2", ""),
        1,
        &["the start (1.00, -3.02, 1.20) is in occupied space; the robot fits at ", "remedy: try --start 1."],
    );
    fails(
        dir.path(),
        &request("4.3,1.75,1.2", ""),
        1,
        &["the start (4.30, 1.75, 1.20) is in unknown space; the robot fits at ", "remedy: try --start "],
    );
    fails(dir.path(), &request("-0.7,0,1.2", ""), 1, &["the start (-0.70, 0.00, 1.20) is only 0.", "remedy: try --start -0."]);
    fails(
        dir.path(),
        "plan room.vox --start 1,0,1.2 --goal 4.3,1.75,1.2 -o path.json",
        1,
        &["the goal (4.30, 1.75, 1.20) is in unknown", "try --goal "],
    );
    fails(dir.path(), &request("90,0,1.2", ""), 1, &["the start (90.00, 0.00, 1.20) is outside of the map, which reaches from "]);
    fails(dir.path(), "plan room.vox --start 1,0,1.2 --goal 1,0,50 -o path.json", 1, &["the goal (1.00, 0.00, 50.00) is outside of the map"]);
    fails(dir.path(), &request("1,0,1.2", "--radius 5"), 1, &["m from the nearest obstacle", "--radius"]);
    fails(dir.path(), &request("1,0,1.2", "--radius -1"), 2, &["0 to 100"]);
    fails(dir.path(), &request("1,0,nan", ""), 2, &["--start"]);
    fails(dir.path(), &request("1,0", ""), 2, &["three numbers"]);
    fails(dir.path(), &request("1,0,1.2", "--ground --height 0.1"), 2, &["height above the floor"]);
    fails(dir.path(), &request("1,0,1.2", "--height 1"), 2, &["--ground"]);
    fails(dir.path(), "plan room.vox --goal 1,0,1 -o path.json", 2, &["--start"]);
    fails(dir.path(), "plan nowhere.vox --start 1,0,1 --goal 2,0,1 -o path.json", 1, &["nowhere.vox"]);
    fails(dir.path(), &request("1,0,1.2", "").replace("path.json", "nowhere/path.json"), 1, &["nowhere/path.json"]);
    assert!(!dir.path().join("path.json").exists());
    let surfaces = mapped("tsdf");
    fails(surfaces.path(), &request("1,0,1.2", ""), 1, &["no occupancy", "--field occupancy"]);
}

#[test]
fn the_search_for_an_unreachable_goal_ends_in_time() {
    let dir = mapped("occupancy");
    // The pillar fills the strip that the robot has to keep to.
    let request = "plan room.vox --start 2,1.75,1.2 --goal 6.5,1.75,1.2 --bounds 0,1.6,0.4,8,1.9,2.1 -o path.json --time 0.4 --radius ";
    fails(dir.path(), &format!("{request} 0.2"), 1, &["no path was found in ", "the search got ", "more --time, a smaller --radius"]);
    // A point gets no farther.
    fails(dir.path(), &format!("{request} 0"), 1, &["no path was found in "]);
    let point = json(dir.path(), "plan room.vox --start 2,1.75,1.2 --goal 6.5,1.75,1.2 --radius 0 --samples 300 --time 60 -o path.json --json");
    assert!(point["radius_m"] == 0.0 && point["least_clearance_m"].as_f64().unwrap() >= 0.0, "{point}");
}

#[test]
fn a_recheck_reports_blocked_segments() {
    let dir = mapped("occupancy");
    works(dir.path(), "plan room.vox --start 0,-1,1.2 --goal 6,1.5,1.2 --radius 0.25 --samples 300 --time 60 -o path.json");
    let summary = json(dir.path(), "plan room.vox --recheck path.json --json");
    assert_eq!((&summary["holds"], &summary["waypoints_lost"]), (&serde_json::json!(true), &serde_json::json!(0)), "{summary}");
    assert!(summary["broken"].as_array().unwrap().is_empty() && summary["moved_m"].as_f64().unwrap() < 1e-9);
    works(dir.path(), "plan room.vox --start 0,-1,1.2 --goal 6,1.0,1.2 --radius 0.25 --ground --height 0.6 --samples 300 --time 60 -o roll.json");
    works(dir.path(), "plan room.vox --recheck roll.json");
    // Straight through the pillar, for a robot that the command line describes.
    std::fs::write(dir.path().join("through.json"), r#"{"path": [[2, -1, 1.2], [2, 1.75, 1.2], [7, 1.75, 1.2], [7, 0, 1.2]]}"#).unwrap();
    let finished = run(dir.path(), "plan room.vox --recheck through.json --radius 0.3 --json");
    let report: serde_json::Value = serde_json::from_str(&finished.out).unwrap();
    assert!(finished.code == Some(1) && finished.err.contains("blocked between waypoints 1 and 2, after 1."), "{}", finished.err);
    let broken = &report["broken"][0];
    assert!(report["holds"] == false && report["waypoints_lost"] == 4 && broken["piece"] == 1, "{report}");
    let free = broken["free_m"].as_f64().unwrap();
    assert!(free > 1.4 && free < 1.75 && (broken["at"][0].as_f64().unwrap() - 2.0 - free).abs() < 1e-6, "{report}");
    fails(dir.path(), "plan room.vox --recheck nowhere.json", 1, &["nowhere.json"]);
    fails(dir.path(), "plan room.vox --recheck path.json --start 0,0,1", 2, &["--start"]);
    for (text, word) in [
        ("[1]", "not a planned path"),
        (r#"{"path": [[0, 0, 1]], "format": 9}"#, "its format is 9"),
        (r#"{"path": [], "tree": {"points": [[0, 0, 1]], "parents": [3]}}"#, "parents that do not exist"),
    ] {
        std::fs::write(dir.path().join("bad.json"), text).unwrap();
        fails(dir.path(), "plan room.vox --recheck bad.json", 1, &["bad.json", word]);
    }
}
