//! Two sensors in one recording, mapped together: a simulated room, whose surfaces are known.

use crate::{fails, json, works};
use std::path::Path;

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
    fails(dir, &format!("map {bag} --cloud-topic /points --cloud-topic /points_2"), 1, &["/points_2", "voxelastic odometry", "--poses"]);
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
    fails(dir, "map front -o x.vox --also rear --slam", 2, &["--also", "voxelastic odometry"]);
    fails(dir, "map front -o x.vox --poses groundtruth --also nowhere", 1, &["nowhere"]);
    let information = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
    let graph = format!("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {information}\n");
    std::fs::write(dir.join("rear/graph.g2o"), graph).unwrap();
    fails(dir, "map front -o x.vox --poses groundtruth --also rear", 1, &["rear", "one sensor"]);
}

/// The lidar in the base frame of the second folder.
fn second_mount() -> voxelastic::Pose {
    voxelastic::Pose::from_parts(
        nalgebra::Translation3::new(0.1, 0.5, -0.2),
        nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(0.8, 0.0, 0.0, 0.6)),
    )
}
