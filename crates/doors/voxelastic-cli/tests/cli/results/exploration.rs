//! The robot's own space, distance fields and exploration.

use crate::results::report::data;
use crate::{fails, json, room, works};
use std::path::Path;

const QUICK: &str = "--voxel-size 0.1 --max-range 20";

fn mapped(dir: &Path, options: &str) {
    works(dir, &format!("map room --overwrite {QUICK} {options}"));
}

#[test]
fn a_robot_starts_where_the_sensor_was() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 3);
    let [x, y, z] = room::pose(0).translation.vector.into();
    let plan = |extra: &str| format!("plan room.vox --start {x},{y},{z} --goal 3,-0.8,1.1 --radius {extra} --time 0.2 -o path.json");
    mapped(dir.path(), "--field occupancy --robot-radius 0");
    fails(dir.path(), &plan("0.3"), 1, &["nearest obstacle or unknown space"]);
    mapped(dir.path(), "--field occupancy");
    works(dir.path(), &plan("0.3"));
    mapped(dir.path(), "--field occupancy --min-range 0.3");
    fails(dir.path(), &plan("0.3"), 1, &["nearest obstacle or unknown space"]);
    let too_large = "map room --overwrite --max-range 20 --voxel-size 0.01 --robot-radius 2";
    fails(dir.path(), too_large, 2, &["robot_radius = 2", "at most 128 voxels"]);
    // A robot that is larger than the space is high does not fit.
    mapped(dir.path(), "--field occupancy --robot-radius 0.5 --robot-height 0.1");
    fails(dir.path(), &plan("0.3"), 1, &["nearest obstacle or unknown space"]);
    mapped(dir.path(), "--field occupancy --robot-radius 0.5 --robot-height 0.5");
    works(dir.path(), &plan("0.3"));
}

/// Shape and numbers of an array that NumPy would read.
fn array(path: &Path) -> (String, Vec<f32>) {
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = String::from_utf8(bytes[10..10 + header].to_vec()).unwrap();
    assert!((10 + header).is_multiple_of(64) && text.ends_with('\n') && text.contains("'<f4'"), "{text}");
    let numbers = bytes[10 + header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    (text, numbers)
}

#[test]
fn distances_are_written_as_arrays_clouds_and_pictures() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 20);
    mapped(dir.path(), "--field both");
    // Along x towards the wall at x = 9 m.
    let summary = json(dir.path(), "esdf room.vox -o d.npy --bounds 7.05,0.55,1.3,8.76,0.56,1.31 --spacing 0.1 --json");
    assert_eq!((summary["shape"].as_array().unwrap().len(), summary["points"].as_u64(), summary["surfaces"].as_bool()), (3, Some(18), Some(true)));
    let (header, distances) = array(&dir.path().join("d.npy"));
    assert!(header.contains("'shape': (1, 1, 18)"), "{header}");
    let mut sum = 0.0;
    for (i, distance) in distances.iter().enumerate() {
        let x = 7.05 + 0.1 * i as f32;
        // The ceiling is 1.3 m above.
        let expected = (9.0 - x).min(1.3);
        // The field is of whole voxels of 0.1 m, and sometimes the nearest one has no surface that corrects it.
        assert!((distance - expected).abs() < 0.12, "{distance} at x = {x}");
        sum += (distance - expected).abs();
    }
    assert!(sum / 18.0 < 0.06, "{distances:?}");
    let cloud = json(dir.path(), "esdf room.vox -o d.ply --max-distance 0.5 --spacing 0.2 --json");
    let bytes = std::fs::read(dir.path().join("d.ply")).unwrap();
    let count = cloud["points"].as_u64().unwrap() as usize;
    let header = String::from_utf8_lossy(&bytes[..400]).into_owned();
    assert!(count > 1000 && header.contains(&format!("element vertex {count}\n")) && header.contains("property float gradient_x"), "{header}");
    assert_eq!(bytes.len(), header.find("end_header\n").unwrap() + 11 + 31 * count);
    works(dir.path(), "esdf room.vox -o d.png --to-unknown");
    assert!(std::fs::read(dir.path().join("d.png")).unwrap().starts_with(b"\x89PNG"));
    let threads = |n: u32| {
        works(dir.path(), &format!("esdf room.vox -o t{n}.npy --spacing 0.2 --to-unknown --threads {n}"));
        std::fs::read(dir.path().join(format!("t{n}.npy"))).unwrap()
    };
    assert!(threads(1) == threads(3));
}

#[test]
fn impossible_distance_fields_have_a_remedy() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 3);
    mapped(dir.path(), "");
    works(dir.path(), "esdf room.vox -o d.png");
    fails(dir.path(), "esdf room.vox -o d.png --to-unknown", 1, &["has no occupancy (its field is tsdf)", "--field both"]);
    fails(dir.path(), "esdf room.vox -o d.txt", 2, &["d.txt", ".npy"]);
    fails(dir.path(), "esdf room.vox -o d.npy --max-distance 5", 2, &["5 m", "at most 4.800 m"]);
    fails(dir.path(), "esdf room.vox -o d.npy --spacing 0.001 --bounds -99,-99,-99,99,99,99", 2, &["--spacing", "--bounds"]);
    fails(dir.path(), "esdf none.vox -o d.npy", 1, &["none.vox"]);
}

#[test]
fn a_maze_is_explored_and_the_robot_comes_home() {
    let dir = tempfile::tempdir().unwrap();
    let explore = "explore maze --time 40 --columns 256 --max-range 15 --picture maze.png --report maze.html --json";
    let run = json(dir.path(), &format!("{explore} --threads 2"));
    assert_eq!((run["is_home"].as_bool(), run["collisions"].as_u64()), (Some(true), Some(0)), "{run}");
    assert!(run["time_s"].as_f64().unwrap() <= 40.0 && run["distance_m"].as_f64().unwrap() > 20.0, "{run}");
    let course = run["course"].as_array().unwrap();
    let share = |moment: &serde_json::Value| moment["known_share"].as_f64().unwrap();
    assert!(course.len() >= 3 && share(&course[course.len() - 1]) > 2.0 * share(&course[0]), "{run}");
    let volume = |moment: &serde_json::Value| moment["tare_volume_m3"].as_f64().unwrap();
    assert!(course.windows(2).all(|pair| volume(&pair[0]) <= volume(&pair[1])) && volume(&course[0]) > 5.0, "{run}");
    assert_eq!(run["tare_volume_m3"], course[course.len() - 1]["tare_volume_m3"]);
    // Obstacles of 10 cm: half of their edge, and what drift leaves in 40 s.
    assert!(run["surface_error_m"]["median"].as_f64().unwrap() < 0.1 && run["surface_error_m"]["p95"].as_f64().unwrap() < 0.4, "{run}");
    assert_eq!(run["known_share"], course[course.len() - 1]["known_share"]);
    let periods = run["periods"].as_array().unwrap();
    let sum = |key: &str| periods.iter().map(|period| period[key].as_u64().unwrap()).sum::<u64>();
    assert!((2..=5).contains(&periods.len()) && [sum("scans"), sum("plans")] == ["scans", "plans"].map(|key| run[key].as_u64().unwrap()), "{run}");
    let (first, last) = (&periods[0], periods.last().unwrap());
    assert!(last["time_s"] == run["time_s"] && last["places"] == run["places"] && last["submaps"] == run["submaps"], "{run}");
    let number = |period: &serde_json::Value, key: &str| period[key].as_f64().unwrap();
    assert!((10.0..11.0).contains(&number(first, "time_s")) && first["mapping_ms"]["median"].as_f64().unwrap() > 0.0, "{run}");
    let known = number(&run, "known_share") * number(&run, "reachable_m3");
    assert!((number(last, "known_m3") - known).abs() < 0.01 && number(first, "known_m3") < known, "{run}");
    assert!(number(last, "resident_mb") > number(last, "map_mb") && number(first, "map_mb") > 0.1, "{run}");
    assert!(std::fs::read(dir.path().join("maze.png")).unwrap().starts_with(b"\x89PNG"));
    let page = data(&dir.path().join("maze.html"));
    let (moments, steps) = (&page["exploration"]["moments"], page["exploration"]["steps"].as_array().unwrap());
    assert!(moments.as_array().unwrap().len() == course.len() && moments[1]["known_share"] == course[1]["known_share"]);
    assert!(steps.len() > 20 && steps[0]["path"].as_array().unwrap().len() > 1 && !steps[0]["frontier"].as_array().unwrap().is_empty());
    // Of the way home, and where it is at home.
    assert_eq!(steps.last().unwrap()["time_s"], run["time_s"]);
    assert!(!page["surfaces"][0]["chunks"].as_array().unwrap().is_empty());
    let again = json(dir.path(), &format!("{explore} --threads 1"));
    assert_eq!(again["course"], run["course"], "the same again, with another number of threads");
    fails(dir.path(), "explore maze --speed 0", 2, &["--speed"]);
    fails(dir.path(), "explore maze --bounds 50,50,0,60,60,2", 2, &["does not fit at its start", "--bounds"]);
    fails(dir.path(), "explore maze --no-return never", 2, &["--no-return", "free"]);
    fails(dir.path(), "explore moon", 2, &["maze"]);
}

#[test]
fn beams_without_a_return_may_be_free_space() {
    let dir = tempfile::tempdir().unwrap();
    // Nothing is above the ground.
    let explore = "explore plane --bounds -12,-12,0.5,12,12,3 --time 1 --columns 256 --max-range 15 --json";
    let known = |flags: &str| json(dir.path(), &format!("{explore} {flags}"))["known_share"].as_f64().unwrap();
    let (unknown, free) = (known("--no-return unknown"), known("--no-return free"));
    assert!(known("") == unknown && free > 2.0 * unknown, "{unknown} and {free}");
}

#[test]
fn a_robot_on_wheels_leaves_its_start_and_comes_home() {
    let dir = tempfile::tempdir().unwrap();
    let run = json(dir.path(), "explore maze --ground --time 60 --columns 256 --max-range 15 --json");
    assert_eq!((run["is_home"].as_bool(), run["collisions"].as_u64()), (Some(true), Some(0)), "{run}");
    assert!(run["time_s"].as_f64().unwrap() <= 60.0 && run["distance_m"].as_f64().unwrap() > 20.0, "{run}");
}
