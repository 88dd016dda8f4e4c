//! Scans without poses: `odometry`, and `map` on such data.

use crate::{fails, json, room, run, works};
use std::fs;
use std::path::Path;
use voxelastic::Cloud;
use voxelastic_io::{g2o, pcd, poses};

/// A room without poses; the true ones are beside it.
fn write(dir: &Path, count: usize) {
    room::write(&dir.join("room"), count);
    fs::rename(dir.join("room/poses.tum"), dir.join("true.tum")).unwrap();
}

#[test]
fn odometry_finds_the_poses_and_writes_them_in_three_formats() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), 20);
    let done = json(dir.path(), "odometry room -o p.tum --truth true.tum --json -q");
    assert_eq!((done["registered_of"].as_u64(), done["pieces"].as_u64(), &done["failed"]), (Some(20), Some(1), &serde_json::json!({})), "{done}");
    let (error, path) = (done["errors"]["ate"]["translation_m"]["max"].as_f64().unwrap(), done["path_m"].as_f64().unwrap());
    assert!(path > 5.0 && error < 0.01 * path, "{error} m after {path} m");
    works(dir.path(), "odometry room -o p.txt --threads 1");
    works(dir.path(), "odometry room -o p.g2o --threads 2");
    let tum = poses::read(dir.path().join("p.tum")).unwrap();
    assert!(tum.times.unwrap().iter().zip(0..).all(|(time, k)| (time - 0.1 * f64::from(k)).abs() < 1e-9), "0.1 s is assumed");
    assert_eq!(poses::read(dir.path().join("p.txt")).unwrap().len(), 20);
    let graph = g2o::read(dir.path().join("p.g2o")).unwrap();
    assert_eq!((graph.nodes.len(), graph.edges.len()), (20, 19));
    assert!(graph.nodes.iter().map(|n| n.1).eq(tum.poses), "the same bits with any number of threads");
    assert!(graph.edges.iter().all(|e| e.information.is_some_and(|i| i[0] > 1e3)), "edges have the information of their registration");
}

#[test]
fn data_without_poses_are_mapped_by_odometry() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), 20);
    let finished = run(dir.path(), "map room --voxel-size 0.05 --hold-out 10 --json");
    assert_eq!(finished.code, Some(0), "{}", finished.err);
    assert!(finished.err.contains("no poses in room: they are estimated"), "{}", finished.err);
    let done: serde_json::Value = serde_json::from_str(&finished.out).unwrap();
    assert_eq!((done["scans"].as_u64(), done["scans_held_out"].as_u64(), done["odometry"]["pieces"].as_u64()), (Some(18), Some(2), Some(1)));
    // The scans that were held out lie on the map, at the poses of the same odometry.
    works(dir.path(), "odometry room -o p.tum -q");
    let held_out = json(dir.path(), "heldout room.vox room --poses ../p.tum --hold-out 10 --json");
    assert_eq!(held_out["nodes"], serde_json::json!([9, 19]));
    let median = held_out["distances"]["median"].as_f64().unwrap();
    assert!(median < 0.01, "{median} m, a fifth of a voxel");
    // With poses in the data they are used, unless --slam asks for odometry.
    fs::copy(dir.path().join("true.tum"), dir.path().join("room/poses.tum")).unwrap();
    assert!(json(dir.path(), "map room -o given.vox --max-scans 3 --json")["odometry"].is_null());
    assert_eq!(json(dir.path(), "map room -o own.vox --max-scans 3 --slam --json")["odometry"]["registered_of"], 3);
    fails(dir.path(), "map room --slam --poses true.tum", 2, &["--slam", "--poses"]);
}

#[test]
fn scans_that_fit_nowhere_are_said_and_begin_a_new_piece() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), 12);
    let file = |k: usize| dir.path().join(format!("room/scans/{k:06}.pcd"));
    // A covered sensor, a damaged file, and a sensor that is somewhere else from then on.
    let covered = room::scan(&room::pose(4)).points.into_iter().step_by(97).collect();
    pcd::write(file(4), &Cloud::from_points(covered)).unwrap();
    fs::write(file(6), "VERSION 0.7").unwrap();
    for k in 9..15 {
        pcd::write(file(k), &elsewhere(k as f32)).unwrap();
    }
    let finished = run(dir.path(), "odometry room --json");
    assert_eq!(finished.code, Some(0), "{}", finished.err);
    for words in ["scan 000004: not registered: too few returns", "000006.pcd", "piece 2 of the trajectory begins"] {
        assert!(finished.err.contains(words), "no `{words}` in\n{}", finished.err);
    }
    let done: serde_json::Value = serde_json::from_str(&finished.out).unwrap();
    assert_eq!(
        (done["pieces"].as_u64(), done["unreadable"].as_u64(), done["failed"]["too few returns"].as_u64()),
        (Some(2), Some(1), Some(1)),
        "{done}"
    );
    let mapped = json(dir.path(), "map room --voxel-size 0.1 --json -q");
    let failed: u64 = done["failed"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(mapped["scans_skipped"].as_u64(), Some(failed + 1), "{mapped}");
    assert_eq!(mapped["scans"].as_u64(), Some(15 - failed - 1));
    fails(dir.path(), "odometry room -o p.csv", 2, &[".tum", ".g2o"]);
    fails(dir.path(), "odometry nowhere", 1, &["nowhere"]);
}

/// A scan of a long low hall full of pillars, seen from `step` along it.
fn elsewhere(step: f32) -> Cloud {
    let mut points = Vec::new();
    for i in 0..3000 {
        let (u, v) = ((i % 100) as f32 / 100.0, (i / 100) as f32 / 30.0);
        let [near, far] = [40.0 * u - 20.0 - 0.2 * step, 16.0 * v - 8.0];
        points.extend([[near, far, -0.6], [near, far, 2.4], [near, -8.0, 3.0 * u - 0.6]]);
        points.push([40.0 * u - 20.0 - 0.2 * step, 8.0, 5.0 * v - 0.6]);
        points.push([20.0 - 0.2 * step, 16.0 * u - 8.0, 5.0 * v - 0.6]);
        let (pillar, turn) = ((i % 10) as f32, std::f32::consts::TAU * u);
        points.push([3.3 * pillar - 15.0 - 0.2 * step + 0.4 * turn.cos(), 4.0 * (pillar * 1.7).sin() + 0.4 * turn.sin(), 5.0 * v - 0.6]);
    }
    Cloud::from_points(points)
}

#[test]
fn loops_are_closed_from_the_scans_alone() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate street -o street --laps 1.3 --spacing 5 --columns 128");
    for entry in fs::read_dir(dir.path().join("street")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.contains("poses@") || name.ends_with(".g2o") {
            fs::remove_file(path).unwrap();
        }
    }
    let error = |map: &str| {
        let found = json(dir.path(), &format!("eval {map} --truth street --field tsdf --max-points 2000 --json"));
        found["trajectory"]["ate_in_place"]["translation_m"]["max"].as_f64().unwrap()
    };
    let plain = json(dir.path(), "map street -o plain.vox --voxel-size 0.4 --max-range 20 --json");
    assert!(plain["closures"].is_null() && plain["loops"].as_array().unwrap().is_empty(), "{plain}");
    let closed = json(dir.path(), "map street -o closed.vox --voxel-size 0.4 --max-range 20 --loops --json");
    let closures = &closed["closures"];
    let count = |verdict: &str| closures["tried"].as_array().unwrap().iter().filter(|c| c["verdict"] == verdict).count() as u64;
    assert!(closures["accepted"].as_u64() >= Some(3) && closures["accepted"].as_u64() == Some(count("accepted")), "{closures}");
    assert!(closures["free_space"].as_u64() >= Some(1) && closures["free_space"].as_u64() == Some(count("free_space")), "{closures}");
    assert!(!closed["corrections"].as_array().unwrap().is_empty(), "{closed}");
    let (plain, closed) = (error("plain.vox"), error("closed.vox"));
    assert!(closed < 0.5 * plain, "{plain} m, {closed} m");
}

#[test]
fn scans_are_localised_in_a_map_that_does_not_have_them() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate street -o street --laps 0.7 --spacing 4 --columns 512");
    works(dir.path(), "map street -o half.vox --poses groundtruth.tum --hold-out 2 --voxel-size 0.2 --max-range 30");
    let done = json(dir.path(), "localize half.vox street --truth groundtruth.tum -o visit.tum --every 3 --json");
    let located: Vec<&serde_json::Value> = done["located"].as_array().unwrap().iter().filter(|row| row["node"].as_u64().unwrap() % 2 == 1).collect();
    let good =
        |row: &&&serde_json::Value| row["certain"] == true && row["error_m"].as_f64().unwrap() < 0.2 && row["error_deg"].as_f64().unwrap() < 0.5;
    let share = located.iter().filter(good).count() as f64 / located.len() as f64;
    assert!(located.len() >= 5 && share >= 0.9 && done["errors"]["wrong"] == 0, "{share}: {done}");
    assert_eq!(poses::read(dir.path().join("visit.tum")).unwrap().len() as u64, done["certain"].as_u64().unwrap());
    // Somewhere else, no place is certain; far from the guess, none is even tried.
    fs::create_dir(dir.path().join("away")).unwrap();
    (0..3).for_each(|k| pcd::write(dir.path().join(format!("away/{k}.pcd")), &elsewhere(k as f32)).unwrap());
    assert_eq!(json(dir.path(), "localize half.vox away --json")["certain"], 0);
    let far = json(dir.path(), "localize half.vox street --every 20 --guess 900,0,0 --json");
    assert!(far["located"].as_array().unwrap().iter().all(|row| row["t_map_lidar"].is_null()), "{far}");
    fails(dir.path(), "localize half.vox street --guess 1,2", 2, &["X,Y,Z"]);
    // With the heading known, a pose of another heading is none.
    let truth = poses::read(dir.path().join("street/groundtruth.tum")).unwrap().poses[0];
    let (at, yaw) = (truth.translation.vector, truth.rotation.euler_angles().2.to_degrees());
    let certain = |yaw: f64| {
        json(dir.path(), &format!("localize half.vox street --every 1000 --guess {},{},{},{yaw} --json", at.x, at.y, at.z))["certain"].clone()
    };
    assert_eq!((certain(yaw + 20.0), certain(yaw + 180.0)), (1.into(), 0.into()));
}
