//! Two sensors in one recording, mapped together: a simulated room, whose surfaces are known.

use crate::{fails, json, works};
use std::collections::BTreeMap;
use std::path::Path;
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::{MapStore, SubmapEntry};

const COMMON: &str = "--poses room/groundtruth.tum --every scan --hold-out 5";
/// Where the second sensor is on the first: 0.6 m behind and 0.3 m below it, turned back and 40 degrees down.
const MOUNTED: &str = "-0.6,0,-0.3,-0.3420201433,0,0.9396926208,0";

/// Shares of the held-out points of both sensors and of the truth within 5 cm of a map, and the 90 % quantile of its exact error, metres.
fn figures(dir: &Path, map: &str) -> [f64; 3] {
    let heldout = json(dir, &format!("heldout {map} room/recording.mcap {COMMON} --cloud-topic /points --cloud-topic /points_2 --json -q"));
    let eval = json(dir, &format!("eval {map} --truth room --json -q"));
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let surface = &eval["surface"];
    let figures =
        [&heldout["distances"]["fraction_under_5cm"], &surface["completeness"]["fraction_under_5cm"], &surface["accuracy_exact"]["p90"]].map(number);
    println!("{map}: {figures:?}");
    figures
}

#[test]
fn a_map_of_both_is_more_complete_and_as_accurate() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    works(dir, "simulate room -o room --bag --sensor vlp-16 --second-lidar vlp-16 --columns 450 --scans 60 --rate 5 --moving -q");
    let map = |arguments: &str| works(dir, &format!("map room/recording.mcap {COMMON} -q {arguments}"));
    map("--cloud-topic /points -o first.vox");
    map(&format!("--cloud-topic /points_2 --t-base-lidar {MOUNTED} -o second.vox"));
    map("--cloud-topic /points --cloud-topic /points_2 -o both.vox");
    map("--cloud-topic /points --cloud-topic /points_2 --threads 1 -o one_thread.vox");
    let [first, second, both] = ["first.vox", "second.vox", "both.vox"].map(|name| figures(dir, name));
    for alone in [first, second] {
        assert!(both[0] > alone[0] && both[1] > alone[1], "{both:?} {alone:?}");
    }
    assert!(both[1] > 0.97, "{both:?}");
    // The floor between rings that never move is as good as the first sensor alone sees it.
    assert!(both[2] <= first[2].max(second[2]), "{both:?} {first:?} {second:?}");
    let mesh = |name: &str| {
        works(dir, &format!("mesh {name} -o {name}.ply -q"));
        std::fs::read(dir.join(format!("{name}.ply"))).unwrap()
    };
    assert!(mesh("both.vox") == mesh("one_thread.vox"), "the same for any number of threads");
    // By the transforms of the recording and by the user's poses: the same.
    map(&format!("--cloud-topic /points --cloud-topic /points_2 --t-base-lidar 0,0,0,0,0,0,1 --t-base-lidar {MOUNTED} -o given.vox"));
    assert!(figures(dir, "given.vox").iter().zip(both).all(|(a, b)| (a - b).abs() < 2e-3));
    let info = json(dir, "info both.vox --json");
    assert!(info.to_string().contains("sensor 2: 16 rows"), "{info}");
}

#[test]
fn what_is_missing_for_two_sensors_is_said() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    works(dir, "simulate room -o room --bag --sensor vlp-16 --second-lidar avia --scans 4 --columns 64 -q");
    let bag = "room/recording.mcap";
    fails(dir, &format!("map {bag}"), 1, &["/points", "/points_2", "--cloud-topic"]);
    fails(dir, &format!("map {bag} --slam --cloud-topic /points --cloud-topic points"), 1, &["named twice"]);
    let poses = format!("map {bag} --poses room/groundtruth.tum --cloud-topic /points");
    fails(dir, &format!("{poses} --cloud-topic points"), 1, &["named twice"]);
    fails(dir, &format!("{poses} --t-base-lidar 0,0,0,0,0,0,1 --t-base-lidar 0,0,0,0,0,0,1"), 2, &["2 x --t-base-lidar", "1 x --cloud-topic"]);
    // Sensors of two kinds.
    let made = json(dir, &format!("{poses} --cloud-topic points_2 --every scan -o map.vox --json"));
    assert!(made["sensor"].as_str().unwrap().contains("sensor 2"), "{made}");
    fails(dir, "simulate room -o other --second-lidar vlp-16", 2, &["--bag"]);
}

#[test]
fn folders_of_two_sensors_are_mapped_as_one() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    let simulate = "simulate room --drift 0 --scans 24 --columns 450 -q";
    works(dir, &format!("{simulate} -o front --sensor vlp-16"));
    works(dir, &format!("{simulate} -o rear --sensor os1-32"));
    // The poses of the second folder become those of a base that is half a metre beside its lidar, and turned.
    let (t_base_lidar, given) = (second_mount(), "0.1,0.5,-0.2,0,0,0.6,0.8");
    let path = dir.join("rear/groundtruth.tum");
    let trajectory = voxelastic_io::poses::read(&path).unwrap();
    let base: Vec<_> =
        trajectory.times.unwrap().into_iter().zip(trajectory.poses).map(|(time, pose)| (time, pose * t_base_lidar.inverse())).collect();
    voxelastic_io::poses::write_tum(dir.join("rear/groundtruth_base.tum"), &base).unwrap();
    for file in ["groundtruth.tum", "poses.tum", "graph.g2o"] {
        std::fs::remove_file(dir.join("rear").join(file)).unwrap();
    }
    for file in ["poses.tum", "graph.g2o"] {
        std::fs::remove_file(dir.join("front").join(file)).unwrap();
    }
    let also = format!("--also rear --t-base-lidar 0,0,0,0,0,0,1 --t-base-lidar {given} --poses groundtruth --hold-out 6");
    let made = json(dir, &format!("map front -o both.vox {also} --json"));
    assert_eq!((made["scans"].as_u64(), made["scans_held_out"].as_u64()), (Some(40), Some(8)), "{made}");
    let sensors = made["sensor"].as_str().unwrap();
    assert!(sensors.contains("sensor 1: 16 rows") && sensors.contains("sensor 2: 32 rows"), "{sensors}");
    works(dir, "map front -o front.vox --poses groundtruth --hold-out 6");
    let within = |map: &str| {
        let heldout = json(dir, &format!("heldout {map} front {also} --json -q"));
        heldout["distances"]["fraction_under_5cm"].as_f64().unwrap()
    };
    let (front, both) = (within("front.vox"), within("both.vox"));
    println!("within 5 cm of the map of one {front}, of both {both}");
    assert!(both > front && both > 0.97, "{front} {both}");
    // The same from the other side, and on one thread.
    works(dir, &format!("map front -o again.vox {also} --threads 1"));
    let mesh = |name: &str| {
        works(dir, &format!("mesh {name} -o {name}.ply -q"));
        std::fs::read(dir.join(format!("{name}.ply"))).unwrap()
    };
    assert!(mesh("both.vox") == mesh("again.vox"));
    fails(dir, &format!("map front -o x.vox --also rear --t-base-lidar {given}"), 2, &["1 x --t-base-lidar", "2 folders"]);
    // Their poses estimated: those of the first folder, which the second follows. Both sensors are in one place.
    fails(dir, "map front -o x.vox --also rear --slam", 1, &["rear", "--t-base-lidar"]);
    let own = "--also rear --t-base-lidar 0,0,0,0,0,0,1 --t-base-lidar 0,0,0,0,0,0,1 --slam";
    fails(dir, &format!("map front -o x.vox {own}"), 1, &["front", "times.txt"]);
    let times: String = (0..24).map(|k| format!("{}\n", 0.1 * f64::from(k))).collect();
    ["front", "rear"].iter().for_each(|name| std::fs::write(dir.join(name).join("times.txt"), &times).unwrap());
    let made = json(dir, &format!("map front -o own.vox {own} --json -q"));
    assert_eq!((made["scans"].as_u64(), made["odometry"]["registered_of"].as_u64()), (Some(48), Some(24)), "{made}");
    works(dir, "map front -o alone.vox --slam -q");
    let [own, alone] = ["own.vox", "alone.vox"].map(|map| complete(dir, map, "front"));
    assert!(own > alone && own > 0.95, "{own} {alone}");
    fails(dir, "map front -o x.vox --poses groundtruth --also nowhere", 1, &["nowhere"]);
    let information = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
    let graph = format!("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {information}\n");
    std::fs::write(dir.join("rear/graph.g2o"), graph).unwrap();
    fails(dir, "map front -o x.vox --poses groundtruth --also rear", 1, &["rear", "one sensor"]);
}

#[test]
fn without_poses_the_second_sensor_follows_the_first() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    works(dir, "simulate street -o street --bag --sensor vlp-16 --second-lidar vlp-16 --columns 450 --scans 80 --rate 10 --moving -q");
    let map = |arguments: &str| json(dir, &format!("map street/recording.mcap --voxel-size 0.1 --max-range 40 --every scan --json -q {arguments}"));
    let both = "--cloud-topic /points --cloud-topic /points_2";
    let alone = map("--cloud-topic /points -o first.vox");
    let made = map(&format!("{both} -o both.vox"));
    assert_eq!((alone["scans"].as_u64(), made["odometry"]["registered_of"].as_u64()), (Some(80), Some(80)), "{made}");
    // One may be before the first pose, or after the last.
    assert!(made["scans"].as_u64() >= Some(158), "{made}");
    map(&format!("{both} -o one_thread.vox --threads 1"));
    let mesh = |name: &str| {
        works(dir, &format!("mesh {name} -o {name}.ply -q"));
        std::fs::read(dir.join(format!("{name}.ply"))).unwrap()
    };
    assert!(mesh("both.vox") == mesh("one_thread.vox"), "the same for any number of threads");
    let [first, both] = ["first.vox", "both.vox"].map(|map| complete(dir, map, "street"));
    assert!(both > first, "{both} {first}");
    // Half a period after each scan of the first, the second is where the first is between two scans, but for its mounting.
    let poses = poses_of(&dir.join("both.vox"));
    let quaternion = nalgebra::Quaternion::new(0.0, -0.342_020_143_3, 0.0, 0.939_692_620_8);
    let mounted = voxelastic::Pose::from_parts(nalgebra::Translation3::new(-0.6, 0.0, -0.3), nalgebra::UnitQuaternion::from_quaternion(quaternion));
    let mut followed = 0;
    for k in 0..79 {
        let Some(second) = poses.get(&(1_000_000_000 + k)) else { continue };
        let expected = poses[&k].lerp_slerp(&poses[&(k + 1)], 0.5) * mounted;
        let (off, turned) = (second.translation_distance(&expected), second.rotation_distance(&expected));
        assert!(off < 0.05 && turned < 0.01, "scan {k}: {off} m, {turned}");
        followed += 1;
    }
    assert!(followed >= 78, "{followed}");
}

/// Poses of the scans of a map by their nodes.
fn poses_of(map: &Path) -> BTreeMap<u64, voxelastic::Pose> {
    let store = MapStore::open(map).unwrap();
    let of_submap = |entry: &SubmapEntry| {
        // What was corrected takes the place of what was not.
        entry.scans.iter().chain(&entry.corrected).map(|scan| (scan.node, entry.t_map_submap * scan.t_submap_lidar)).collect::<Vec<_>>()
    };
    store.manifest().submaps.iter().flat_map(of_submap).collect()
}

fn complete(dir: &Path, map: &str, truth: &str) -> f64 {
    let eval = json(dir, &format!("eval {map} --truth {truth} --align --json -q"));
    eval["surface"]["completeness"]["fraction_under_5cm"].as_f64().unwrap()
}

/// The lidar in the base frame of the second folder.
fn second_mount() -> voxelastic::Pose {
    voxelastic::Pose::from_parts(
        nalgebra::Translation3::new(0.1, 0.5, -0.2),
        nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(0.8, 0.0, 0.0, 0.6)),
    )
}
