//! Maps that go on: sessions that are added to a saved map, merged, and taken out again.

use crate::{fails, json, room, run, works};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::{Submap, SubmapScan};
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::{MapStore, MapWriter, ScanEntry, SessionEntry, SubmapEntry};
use voxelastic_io::{pcd, poses};

/// Two laps of a street, and each as a drive of its own; the second in a frame that is turned and far away.
fn two_drives(dir: &Path) -> (usize, Pose) {
    let made = json(dir, "simulate street -o street --laps 2 --spacing 3 --columns 256 --json -q");
    let scans = made["scans"].as_u64().unwrap() as usize;
    let t_own_map = Pose::new(nalgebra::Vector3::new(300.0, -120.0, 4.0), nalgebra::Vector3::new(0.0, 0.0, 2.1));
    drive(dir, "first", 0..scans / 2, "groundtruth.tum", &Pose::identity(), 1.0);
    drive(dir, "second", scans / 2..scans, "groundtruth.tum", &t_own_map, 1.0);
    (scans, t_own_map)
}

/// A part of the street as a folder of its own, in another frame, with lengths in another unit.
pub fn drive(dir: &Path, name: &str, scans: Range<usize>, from: &str, t_own_map: &Pose, scale: f64) {
    fs::create_dir_all(dir.join(name).join("scans")).unwrap();
    let all = poses::read(dir.join("street").join(from)).unwrap();
    let mut own = Vec::new();
    for (k, scan) in scans.enumerate() {
        let (source, target) = (dir.join(format!("street/scans/{scan:06}.pcd")), dir.join(format!("{name}/scans/{k:06}.pcd")));
        if scale == 1.0 {
            fs::copy(source, target).unwrap();
        } else {
            let mut cloud = pcd::read(source).unwrap().cloud;
            cloud.points.iter_mut().flatten().for_each(|c| *c *= scale as f32);
            pcd::write(target, &cloud).unwrap();
        }
        let mut pose = t_own_map * all.poses[scan];
        pose.translation.vector *= scale;
        own.push((k as f64, pose));
    }
    poses::write_tum(dir.join(name).join("poses.tum"), &own).unwrap();
}

const COARSE: &str = "--voxel-size 0.3 --max-range 30";

/// All files of a map but the lock.
pub fn files(map: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(map).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    let named = entries.map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), path));
    named.filter(|(name, _)| name != ".lock").map(|(name, path)| (name, fs::read(path).unwrap())).collect()
}

pub fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    files(from).into_iter().for_each(|(name, bytes)| fs::write(to.join(name), bytes).unwrap());
}

/// Largest and mean error of the corrected positions of a map's scans from those of the street, without alignment, metres.
fn errors(dir: &Path, map: &str) -> (f64, f64) {
    let truth = poses::read(dir.join("street/groundtruth.tum")).unwrap().poses;
    let store = MapStore::open(dir.join(map)).unwrap();
    let of_submap = |entry: &SubmapEntry| {
        let scans = if entry.corrected.is_empty() { &entry.scans } else { &entry.corrected };
        let error = |scan: &ScanEntry| (entry.t_map_submap * scan.t_submap_lidar).translation_distance(&truth[scan.node as usize]);
        scans.iter().map(error).collect::<Vec<_>>()
    };
    let errors: Vec<f64> = store.manifest().submaps.iter().flat_map(of_submap).collect();
    (errors.iter().copied().fold(0.0, f64::max), errors.iter().sum::<f64>() / errors.len() as f64)
}

#[test]
fn a_second_drive_is_found_in_the_map_of_the_first_and_taken_out_without_a_trace() {
    let dir = tempfile::tempdir().unwrap();
    let (at, (scans, t_own_map)) = (dir.path(), two_drives(dir.path()));
    works(at, &format!("map first -o map.vox {COARSE}"));
    let before = files(&at.join("map.vox"));
    assert_eq!(json(at, "info map.vox --json")["sessions"].as_array().unwrap().len(), 1);
    let done = json(at, "map second --into map.vox --json");
    let session = &done["session"];
    assert_eq!((&session["numbers"], &session["by"]), (&serde_json::json!([2]), &"places".into()), "{done}");
    assert!(session["loop_edges"].as_u64() >= Some(4), "{session}");
    let (most, mean) = errors(at, "map.vox");
    assert!(most < 0.12 && mean < 0.05, "{most} m, {mean} m");
    let t: Vec<f64> = session["t_map_session"].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect();
    assert!((nalgebra::Vector3::new(t[0], t[1], t[2]) - t_own_map.inverse().translation.vector).norm() < 1.0, "{t:?}");
    // All see both.
    let info = json(at, "info map.vox --json");
    assert_eq!(info["scans"].as_u64(), Some(scans as u64));
    let sessions = info["sessions"].as_array().unwrap();
    assert_eq!(sessions.iter().map(|s| s["number"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 2]);
    assert_eq!((&sessions[0]["input"], &sessions[1]["input"]), (&"first".into(), &"second".into()), "{info}");
    assert_eq!(sessions[0]["scans"].as_u64().unwrap() + sessions[1]["scans"].as_u64().unwrap(), scans as u64);
    let mesh = json(at, "mesh map.vox -o map.ply --json");
    assert!(mesh["fused"]["merged"].as_u64() > Some(1000), "surfaces of both are fused: {mesh}");
    // The files of the first session are as they were; nothing is added twice.
    let both = files(&at.join("map.vox"));
    assert!(before.iter().filter(|(name, _)| *name != "manifest.json").all(|(name, bytes)| both.get(name) == Some(bytes)));
    fails(at, "map second --into map.vox", 1, &["session 2", "already", "voxelastic remove"]);
    let removed = json(at, "remove map.vox --session 2 --json");
    assert_eq!((&removed["sessions"], &removed["joined_to_it"]), (&serde_json::json!([1]), &serde_json::json!([])), "{removed}");
    assert_eq!(removed["scans_removed"].as_u64(), Some((scans - scans / 2) as u64));
    assert!(files(&at.join("map.vox")) == before, "bit for bit as before");
    fails(at, "remove map.vox --session 2", 1, &["no session 2"]);
    fails(at, "remove map.vox --session 1", 1, &["all of the map"]);
    // As a saved map, the same session lies in the same place.
    works(at, &format!("map second -o other.vox {COARSE}"));
    let merged = json(at, "merge other.vox --into map.vox --json");
    assert_eq!((&merged["session"]["t_map_session"], &merged["session"]["by"]), (&session["t_map_session"], &session["by"]));
    let fields = |all: &BTreeMap<String, Vec<u8>>| all.keys().filter(|name| name.ends_with(".vxs")).cloned().collect::<Vec<_>>();
    assert_eq!(fields(&files(&at.join("map.vox"))), fields(&both), "names have the hash of the content");
    // Of a third session that is joined to the second, the poses stay.
    works(at, "map street -o third.vox --voxel-size 0.3 --max-range 30 --poses groundtruth.tum --max-scans 20");
    works(at, "merge third.vox --into map.vox");
    works(at, "remove map.vox --session 1");
    assert_eq!(json(at, "info map.vox --json")["sessions"].as_array().unwrap().len(), 2, "numbers stay");
    works(at, "mesh map.vox -o rest.ply");
}

#[test]
fn a_session_that_drifted_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    let made = json(at, "simulate street -o street --laps 2 --spacing 3 --columns 256 --drift 2 --loop-radius 0 --json -q");
    let scans = made["scans"].as_u64().unwrap() as usize;
    drive(at, "first", 0..scans / 2, "groundtruth.tum", &Pose::identity(), 1.0);
    works(at, &format!("map first -o map.vox {COARSE}"));
    for (name, poses, drifts) in [("true", "groundtruth.tum", false), ("drifting", "poses.tum", true)] {
        drive(at, name, scans / 2..scans, poses, &Pose::identity(), 1.0);
        let done = run(at, &format!("map {name} --into map.vox --json"));
        assert_eq!(done.code, Some(0), "{name}: {}", done.err);
        let bent = serde_json::from_str::<Value>(&done.out).unwrap()["session"]["bent_m"].as_f64().unwrap();
        assert_eq!((bent > 1.0, done.err.contains("it drifted") && done.err.contains("--loops")), (drifts, drifts), "{bent} m: {}", done.err);
        works(at, "remove map.vox --session 2");
    }
}

#[test]
fn drives_in_one_frame_are_joined_by_it_and_those_that_never_meet_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    works(at, "simulate street -o street --laps 2 --spacing 3 --columns 256 -q");
    let all = poses::read(at.join("street/groundtruth.tum")).unwrap().len();
    drive(at, "first", 0..all / 5, "groundtruth.tum", &Pose::identity(), 1.0);
    drive(at, "again", all / 2..all / 2 + all / 8, "groundtruth.tum", &Pose::translation(0.4, -0.3, 0.1), 1.0);
    drive(at, "elsewhere", all / 4 + all / 16..all / 2 - all / 16, "groundtruth.tum", &Pose::translation(40.0, 30.0, 0.0), 1.0);
    works(at, &format!("map first -o map.vox {COARSE}"));
    let before = files(&at.join("map.vox"));
    let done = json(at, "map again --into map.vox --json");
    assert_eq!(done["session"]["by"], "frame", "{done}");
    let t: Vec<f64> = done["session"]["t_map_session"].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect();
    assert!((t[0] + 0.4).abs() < 0.1 && (t[1] - 0.3).abs() < 0.1 && (t[2] + 0.1).abs() < 0.05, "the frame was half a metre off: {t:?}");
    works(at, "remove map.vox --session 2");
    // Nothing is guessed: the session is a map of its own.
    let apart = run(at, "map elsewhere --into map.vox --json");
    assert_eq!(apart.code, Some(3), "{}", apart.err);
    let done: Value = serde_json::from_str(&apart.out).unwrap();
    assert_eq!((&done["output"], &done["session"]), (&"elsewhere.vox".into(), &Value::Null), "{done}");
    assert!(apart.err.contains("not added") && apart.err.contains("voxelastic merge elsewhere.vox --into map.vox"), "{}", apart.err);
    assert!(files(&at.join("map.vox")) == before);
    fails(at, "merge elsewhere.vox --into map.vox", 1, &["not added", "--align"]);
    // Whoever knows better says so.
    let aligned = json(at, "merge elsewhere.vox --into map.vox --align -40,-30,0 --json");
    assert_eq!((&aligned["session"]["by"], &aligned["session"]["numbers"]), (&"align".into(), &serde_json::json!([2])), "{aligned}");
    works(at, "remove map.vox --session 2");
    assert!(files(&at.join("map.vox")) == before);
}

#[test]
fn what_does_not_belong_together_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    room::write(&at.join("room"), 12);
    works(at, "map room -o map.vox --voxel-size 0.1");
    works(at, "map room -o fine.vox --voxel-size 0.05");
    works(at, "map room -o free.vox --voxel-size 0.1 --field both");
    let before = files(&at.join("map.vox"));
    fails(at, "map room --into map.vox --voxel-size 0.05", 2, &["0.1 m", "0.05 m", "leave them out"]);
    fails(at, "merge fine.vox --into map.vox", 2, &["0.1 m", "0.05 m"]);
    fails(at, "merge free.vox --into map.vox", 2, &["--field"]);
    fails(at, "merge map.vox --into map.vox", 2, &["itself"]);
    fails(at, "merge map.vox --into nowhere.vox", 1, &["nowhere.vox"]);
    fails(at, "map room --into nowhere.vox", 1, &["nowhere.vox"]);
    fails(at, "map room -o x.vox --into map.vox", 2, &["--into"]);
    fails(at, "map room --align 0,0,0", 2, &["--into"]);
    fails(at, "map room --into map.vox --align 1,2", 2, &["X,Y,Z"]);
    assert!(files(&at.join("map.vox")) == before);
}

#[test]
fn a_session_is_not_put_where_numbers_have_no_room_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    room::write(&at.join("room"), 12);
    works(at, "map room -o map.vox --voxel-size 0.1");
    works(at, "map room -o more.vox --voxel-size 0.1");
    let before = files(&at.join("map.vox"));
    for beyond in ["1e300,0,0", "0,1e12,0,90", "0 0 -2e8 0 0 0 1"] {
        fails(at, &format!("map room --into map.vox --align={}", beyond.replace(' ', ",")), 2, &["--align", "metres"]);
        fails(at, &format!("merge more.vox --into map.vox --align={}", beyond.replace(' ', ",")), 2, &["--align", "metres"]);
    }
    fails(at, "merge more.vox --into map.vox --align=1e7,0,0", 1, &["from the map's origin", "more than a voxel"]);
    // What was mapped is kept, beside the map.
    let apart = run(at, "map room --into map.vox --align=1e7,0,0");
    assert!(apart.code == Some(3) && apart.err.contains("more than a voxel") && at.join("room.vox").is_dir(), "{}", apart.err);
    fails(at, "map room -o x.vox --t-base-lidar 1e7,0,0,0,0,0,1", 2, &["--t-base-lidar", "metres"]);
    assert!(!at.join("x.vox").exists() && files(&at.join("map.vox")) == before);
    // A map that has one anyway is opened, and what is wrong with it taken out.
    let more = MapStore::open(at.join("more.vox")).unwrap().load_atlas().unwrap();
    let mut writer = MapWriter::open(at.join("map.vox")).unwrap();
    let manifest = writer.store().manifest();
    let (first, node_offset) = (manifest.submaps.last().unwrap().id + 1, manifest.next_node());
    let last_submap = first + more.submaps().last().unwrap().id();
    let far =
        SessionEntry { number: 2, first_submap: first, last_submap, node_offset, scans: more.scan_count(), ..manifest.all_sessions()[0].clone() };
    let sessions = [manifest.all_sessions(), vec![far]].concat();
    let placed = |submap: &Submap| {
        let scans = submap.scans().iter().map(|scan| SubmapScan { node: scan.node + node_offset, ..*scan }).collect();
        let mut placed = submap.clone().with_id(submap.id() + first).with_scans(scans, submap.travelled());
        placed.set_pose(Pose::translation(1e7, 0.0, 0.0));
        placed
    };
    writer.add_session(&more, placed, sessions).unwrap();
    drop(writer);
    fails(at, "mesh map.vox -o map.ply", 1, &["voxelastic remove MAP --session N"]);
    works(at, "info map.vox");
    works(at, "remove map.vox --session 2");
    works(at, "mesh map.vox -o map.ply");
}

#[test]
fn a_drive_in_feet_is_recognised_as_one() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    works(at, "simulate street -o street --laps 0.5 --spacing 3 --columns 256 -q");
    let all = poses::read(at.join("street/groundtruth.tum")).unwrap().len();
    drive(at, "metres", 0..all, "groundtruth.tum", &Pose::identity(), 1.0);
    drive(at, "feet", 0..all, "groundtruth.tum", &Pose::translation(5.0, 7.0, 0.0), 1.0 / 0.3048);
    works(at, &format!("map metres -o map.vox {COARSE}"));
    let apart = run(at, "map feet --into map.vox --max-range 100");
    assert_eq!(apart.code, Some(3), "{}", apart.err);
    assert!(apart.err.contains("it seems to be in feet"), "{}", apart.err);
}
