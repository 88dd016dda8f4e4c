//! Maps whose coordinates are those of a survey (UTM): what goes in and out has them, and keeps millimetres.

use crate::{fails, json, room, run, works};
use std::fs;
use std::path::Path;
use voxelastic::Pose;
use voxelastic_io::survey::{SurveyCloud, e57, las};
use voxelastic_io::{Origin, poses};

/// Where the room is: as UTM has it.
const THERE: [f64; 3] = [448_123.25, 5_411_987.5, 312.0];
/// Smaller than what single precision can tell apart there.
const CLOSE: f64 = 0.04;

/// The room, with its poses moved by `offset`.
fn write(dir: &Path, name: &str, count: usize, offset: [f64; 3]) {
    let folder = dir.join(name);
    room::write(&folder, count);
    let there = Pose::translation(offset[0], offset[1], offset[2]);
    let poses: Vec<(f64, Pose)> = (0..count).map(|i| (0.1 * i as f64, there * room::pose(i))).collect();
    poses::write_tum(folder.join("poses.tum"), &poses).unwrap();
}

/// Numbers at a key of a JSON object.
fn numbers(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().unwrap_or_else(|| panic!("{value}")).iter().map(|n| n.as_f64().unwrap()).collect()
}

/// Checks that points are on the walls of the room where it is, to within a voxel; `offset` is added to them.
fn check(what: &str, points: impl Iterator<Item = [f64; 3]>) {
    let (mut count, mut low, mut high) = (0, [f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in points {
        count += 1;
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(p[k] - THERE[k]), high[k].max(p[k] - THERE[k]));
        }
    }
    assert!(count > 1000, "{what}: {count} points");
    for k in 0..3 {
        assert!((low[k] - room::MIN[k]).abs() < 2.0 * CLOSE && (high[k] - room::MAX[k]).abs() < 2.0 * CLOSE, "{what}: {low:?} to {high:?}");
    }
}

fn survey(cloud: SurveyCloud) -> impl Iterator<Item = [f64; 3]> {
    cloud.cloud.points.into_iter().map(move |p| std::array::from_fn(|k| f64::from(p[k]) + cloud.offset[k]))
}

/// Positions of a binary PLY or PCD whose records begin with three doubles.
fn doubles(file: &Path, count: &str, end: &str, record: usize) -> Vec<[f64; 3]> {
    let bytes = fs::read(file).unwrap();
    let at = bytes.windows(end.len()).position(|w| w == end.as_bytes()).unwrap() + end.len();
    let head = String::from_utf8(bytes[..at].to_vec()).unwrap();
    let count: usize = head.lines().find_map(|line| line.strip_prefix(count)).unwrap().trim().parse().unwrap();
    let number = |k: usize| f64::from_le_bytes(bytes[k..k + 8].try_into().unwrap());
    (0..count).map(|i| std::array::from_fn(|k| number(at + i * record + 8 * k))).collect()
}

#[test]
fn every_writer_adds_the_origin() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write(dir, "room", 12, THERE);
    let done = run(dir, "map room --field both --voxel-size 0.04 -o utm.vox");
    assert!(done.code == Some(0) && done.err.contains("448000 5412000 0"), "{}", done.err);
    let info = json(dir, "info utm.vox --check --json");
    assert_eq!(numbers(&info["origin_m"]), [448_000.0, 5_412_000.0, 0.0]);
    let root = numbers(&info["submaps"][0]["root_m"]);
    assert!((0..3).all(|k| (root[k] - THERE[k] - room::pose(0).translation.vector[k]).abs() < 1e-6), "{root:?}");
    assert!(works(dir, "info utm.vox").contains("origin"));

    for file in ["a.las", "a.laz", "a.e57", "a.ply", "a.pcd"] {
        works(dir, &format!("export utm.vox -o {file}"));
    }
    works(dir, "mesh utm.vox -o m.ply");
    works(dir, "mesh utm.vox -o m.glb");
    ["a.las", "a.laz"].into_iter().for_each(|file| check(file, survey(las::read(dir.join(file)).unwrap())));
    let scans = e57::read(dir.join("a.e57")).unwrap();
    check("a.e57", survey(e57::merge(&scans, Path::new("a.e57")).unwrap()));
    assert!((scans[0].t_map_scan.translation.vector[1] - THERE[1]).abs() < 10.0, "the pose of the scan has it");
    // x y z as doubles, normals and intensity as floats.
    check("a.ply", doubles(&dir.join("a.ply"), "element vertex", "end_header\n", 40).into_iter());
    check("m.ply", doubles(&dir.join("m.ply"), "element vertex", "end_header\n", 43).into_iter());
    check("a.pcd", doubles(&dir.join("a.pcd"), "POINTS", "DATA binary\n", 40).into_iter());
    let ply = fs::read(dir.join("m.ply")).unwrap();
    assert!(String::from_utf8_lossy(&ply[..300]).contains("comment origin of the map 448000 5412000 0"));
    // Our own reader, too.
    let cloud = voxelastic_io::ply::read_mesh(dir.join("m.ply")).unwrap();
    assert!(!cloud.positions.is_empty());
    let glb = fs::read(dir.join("m.glb")).unwrap();
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let scene: serde_json::Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    assert_eq!(numbers(&scene["nodes"][0]["translation"]), [448_000.0, 0.0, -5_412_000.0], "y is up");
    // An OctoMap cannot reach so far: it counts from the origin, and says so.
    let done = run(dir, "export utm.vox -o a.bt");
    assert!(done.code == Some(0) && done.err.contains("add 448000 5412000 0 m"), "{}", done.err);
}

#[test]
fn coordinates_on_the_command_line_are_those_of_the_poses() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write(dir, "near", 30, [0.0; 3]);
    write(dir, "room", 30, THERE);
    for (data, map) in [("near", "near.vox"), ("room", "utm.vox")] {
        works(dir, &format!("map {data} --field both --voxel-size 0.05 --hold-out 10 -o {map}"));
    }
    let at = |p: [f64; 3]| (0..3).map(|k| (THERE[k] + p[k]).to_string()).collect::<Vec<_>>().join(",");
    let ends = format!("--start {} --goal {}", at([0.0, 0.0, 1.2]), at([6.0, 0.5, 1.2]));
    works(dir, &format!("plan utm.vox {ends} --radius 0.15 --samples 300 --time 20 -o path.json --picture path.png"));
    let path: serde_json::Value = serde_json::from_slice(&fs::read(dir.join("path.json")).unwrap()).unwrap();
    let last = numbers(path["path"].as_array().unwrap().last().unwrap());
    assert!((last[1] - THERE[1] - 0.5).abs() < 1e-6 && numbers(&path["goal"]) == last, "{last:?}");
    let checked = json(dir, "plan utm.vox --recheck path.json --json");
    assert!(checked["holds"] == true && checked["moved_m"].as_f64().unwrap() < 1e-6, "{checked}");
    works(dir, &format!("slice utm.vox --z {} --bounds {},{} -o slice.png", THERE[2] + 1.0, at([0.0, -2.0, 0.0]), at([8.0, 2.0, 2.0])));
    works(dir, &format!("render utm.vox --eye {} --target {} -o view.png", at([0.0, 0.0, 1.2]), at([6.0, 0.0, 1.2])));
    // The same map as where it was near zero, up to rounding.
    let median = |map: &str, data: &str| json(dir, &format!("heldout {map} {data} --hold-out 10 --json"))["distances"]["median"].as_f64().unwrap();
    let (near, far) = (median("near.vox", "near"), median("utm.vox", "room"));
    assert!((near - far).abs() < 1e-3 && far < 0.01, "{near} {far}");
    fails(dir, "eval utm.vox --truth room", 1, &["has an origin (448000 5412000 0 m)", "heldout"]);
    // Its manifest can be made again.
    fs::remove_file(dir.join("utm.vox/manifest.json")).unwrap();
    works(dir, "repair utm.vox");
    assert_eq!(numbers(&json(dir, "info utm.vox --json")["origin_m"]), Origin::near(&Pose::translation(THERE[0], THERE[1], THERE[2])).coordinates());
}

#[test]
fn poses_far_from_the_first_are_refused_by_what_needs_single_precision() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write(dir, "room", 3, THERE);
    // The first pose near zero, the others in UTM.
    let mut all: Vec<(f64, Pose)> = (0..3).map(|i| (0.1 * i as f64, Pose::translation(THERE[0], THERE[1], 0.0) * room::pose(i))).collect();
    all[0].1 = room::pose(0);
    poses::write_tum(dir.join("room/poses.tum"), &all).unwrap();
    works(dir, "map room -o a.vox");
    fails(dir, "mesh a.vox -o a.glb", 1, &["steps of 0.5 m", "an origin near its first pose"]);
    works(dir, "map room --field occupancy -o b.vox");
    fails(dir, "export b.vox -o b.bt", 1, &["scans were taken 5411988 m from the origin", "--voxel-size 165.17"]);
}
