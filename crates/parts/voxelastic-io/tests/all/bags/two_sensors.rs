//! Two sensors in one recording.

use crate::bags::drive::{SCANS, every_scan, play, t_map_lidar};
use nalgebra::{Translation3, UnitQuaternion};
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::{Event, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic::mapper::ScanSource;
use voxelastic_io::bag::{Recording, describe};
use voxelastic_io::{Error, OpenOptions, SensorTopic, raw};
use voxelastic_testing::run_python;

/// Pose of the rear lidar in the frame of the first.
fn rear() -> Pose {
    Pose::from_parts(Translation3::new(-2.0, 0.0, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::PI))
}

/// True pose of the first lidar at scan k and a part of the way to the next.
fn between(k: usize, part: f64) -> Pose {
    let (a, b) = (t_map_lidar(k, 1.5), t_map_lidar(k + 1, 1.5));
    Pose::from_parts(a.translation.vector.lerp(&b.translation.vector, part).into(), a.rotation.slerp(&b.rotation, part))
}

fn with_rear(t_base_lidar: Option<Pose>) -> OpenOptions {
    OpenOptions { cloud_topic: Some("/points".into()), more_sensors: vec![SensorTopic { topic: "rear".into(), t_base_lidar }], ..every_scan() }
}

/// Checks the scans of both lidars, where `t_lidar_rear` is the pose of the second in the first.
fn check(scans: &[Scan], t_lidar_rear: &Pose, name: &str) {
    let (first, second): (Vec<&Scan>, Vec<&Scan>) = scans.iter().partition(|scan| scan.cloud.sensor == 0);
    assert_eq!((first.len(), second.len()), (SCANS, SCANS - 1), "{name}");
    for (k, scan) in first.iter().enumerate() {
        assert!(scan.node == k as u64 && scan.t_map_lidar.translation_distance(&t_map_lidar(k, 1.5)) < 1e-9, "{name}, {k}");
        assert_eq!((scan.cloud.height, scan.cloud.points[8]), (16, [2.0 + k as f32, -0.5, 4.0 - k as f32]), "{name}");
    }
    for (k, scan) in second.iter().enumerate() {
        let expected = between(k, 0.4) * t_lidar_rear;
        assert_eq!(scan.node, 1_000_000_000 + k as u64, "{name}");
        assert!((scan.time - (100.04 + 0.1 * k as f64)).abs() < 1e-6, "{name}: {}", scan.time);
        let off = scan.t_map_lidar.translation_distance(&expected);
        assert!(off < 1e-5 && scan.t_map_lidar.rotation_distance(&expected) < 1e-6, "{name}, {k}: {off}");
        assert_eq!(scan.cloud.height, 1, "{name}");
    }
    assert!(scans.windows(2).all(|w| w[0].time < w[1].time), "{name}: in the order of time");
}

#[test]
fn both_are_played_each_with_its_own_pose() {
    let dir = tempfile::tempdir().unwrap();
    if run_python("rosbags, mcap", include_str!("write.py"), &[dir.path()]).is_none() {
        return;
    }
    let at = |name: &str| dir.path().join(name);
    // Without a choice and with one; poses of a topic and of the transform tree.
    for name in ["two.bag", "two.mcap", "two_tf"] {
        for options in [every_scan(), with_rear(None)] {
            let (scans, errors) = play(&at(name), &options);
            assert!(errors.is_empty(), "{name}: {errors:?}");
            check(&scans, &rear(), name);
        }
    }
    let d = describe(at("two.mcap"), &OpenOptions::default()).unwrap();
    assert_eq!((d.cloud_topic.as_deref(), d.more_cloud_topics.as_slice()), (Some("/points"), &["/rear".to_owned()][..]), "by name");
    assert!(d.to_string().contains("2 sensors are mapped together") && d.to_string().contains("--cloud-topic"), "{d}");

    on_one_topic_they_are_told_apart_by_their_frames(dir.path());
    odometry_follows_the_first(&at("two.mcap"));
    one_of_them_is_as_before(&at("two.mcap"));
    what_is_not_known_is_asked_for(dir.path());
}

fn on_one_topic_they_are_told_apart_by_their_frames(folder: &Path) {
    for poses in ["odometry", "tf"] {
        let path = folder.join(format!("two_on_one_{poses}.mcap"));
        let (scans, errors) = play(&path, &every_scan());
        assert!(errors.is_empty(), "{poses}: {errors:?}");
        check(&scans, &rear(), poses);
        let said = describe(&path, &OpenOptions::default()).unwrap().to_string();
        assert!(said.contains("clouds of /points in rear are of a sensor of their own"), "{said}");
        // Also without poses, where each is placed by its mount.
        let raw = raw::open(&path, &OpenOptions::default()).unwrap();
        assert!(raw.t_first_sensor().len() == 1 && raw.t_first_sensor()[0].translation_distance(&rear()) < 1e-9, "{}", raw.description());
        assert_eq!(raw.iter().filter(|scan| scan.as_ref().unwrap().cloud.sensor == 1).count(), SCANS - 1);
    }
    let apart = folder.join("two_on_one_apart.mcap");
    let refused = [Recording::open(&apart, &every_scan()).unwrap_err(), raw::open(&apart, &OpenOptions::default()).unwrap_err()];
    assert!(refused.iter().all(|error| error.to_string().contains("no fixed transform leads from lidar to rear")), "{refused:?}");
}

fn odometry_follows_the_first(path: &Path) {
    let recording = Recording::open(path, &every_scan()).unwrap();
    let mut poses = std::collections::HashMap::new();
    for event in recording.events().map(Result::unwrap) {
        match event {
            Event::Scan(scan) => drop(poses.insert(scan.node, scan.t_map_lidar)),
            Event::OdometryEdge(edge) => {
                assert!(edge.from < SCANS as u64, "{} hangs on {}", edge.to, edge.from);
                assert!(edge.t_from_to.translation_distance(&poses[&edge.from].inv_mul(&poses[&edge.to])) < 1e-9);
            }
            _ => panic!("neither loops nor corrections"),
        }
    }
    // Clouds that are read again know their sensor, too.
    let mut again = recording.clouds();
    assert_eq!((again.cloud(3).unwrap().sensor, again.cloud(1_000_000_004).unwrap().sensor), (0, 1));
}

/// The scans of one sensor that are taken, and held out, do not depend on whether the other is mapped.
fn one_of_them_is_as_before(path: &Path) {
    let nodes = |options: &OpenOptions, sensor: u16| -> Vec<u64> {
        let mut recording = Recording::open(path, options).unwrap();
        recording.retain(|place| place % 3 != 2);
        let scans = recording.events().filter_map(|e| if let Ok(Event::Scan(s)) = e { Some(s) } else { None });
        scans.filter(|scan| scan.cloud.sensor == sensor).map(|scan| scan.node % 1_000_000_000).collect()
    };
    let alone = |topic: &str| OpenOptions { cloud_topic: Some(topic.into()), ..every_scan() };
    assert_eq!(nodes(&alone("/points"), 0), nodes(&every_scan(), 0));
    assert_eq!(nodes(&alone("/rear"), 0), nodes(&every_scan(), 1));
    let metres = |options: &OpenOptions| play(path, options).0.iter().filter(|s| s.cloud.sensor == 0).map(|s| s.node).collect::<Vec<_>>();
    let every_2_m = OpenOptions { cloud_topic: Some("/points".into()), ..OpenOptions::default() };
    assert_eq!(metres(&every_2_m), [0, 4, 8]);
    assert_eq!(metres(&OpenOptions::default()), [0, 4, 8], "the distance between the lidars is not travelled");
}

fn what_is_not_known_is_asked_for(folder: &Path) {
    let open = |name: &str, options: &OpenOptions| Recording::open(folder.join(name), options);
    // Without a transform between them there is no choice, and both together need their places.
    assert!(matches!(open("two_apart.mcap", &every_scan()), Err(Error::Ambiguous { .. })));
    let apart = open("two_apart.mcap", &with_rear(None)).unwrap_err().to_string();
    assert!(apart.contains("no fixed transform leads from lidar") && apart.contains("--t-base-lidar"), "{apart}");
    let mounted = Pose::translation(0.0, 0.0, 1.5);
    let given = OpenOptions { t_base_lidar: Some(mounted), ..with_rear(Some(mounted * rear())) };
    check(&play(&folder.join("two_apart.mcap"), &given).0, &rear(), "as the user says");
    // Poses that do not say whose they are are those of the first one that is named.
    assert!(matches!(open("two_path", &every_scan()), Err(Error::Ambiguous { .. })));
    let path = play(&folder.join("two_path"), &with_rear(None)).0;
    let second = path.iter().find(|scan| scan.cloud.sensor == 1).unwrap();
    assert!(second.t_map_lidar.translation_distance(&(Pose::translation(0.0, 0.0, -1.5) * between(0, 0.4) * rear())) < 1e-5);
    let twice = OpenOptions { more_sensors: vec![SensorTopic { topic: "points".into(), t_base_lidar: None }], ..with_rear(None) };
    assert!(open("two.mcap", &twice).unwrap_err().to_string().contains("named twice"));
    let graph = folder.join("graph.g2o");
    std::fs::write(&graph, "").unwrap();
    let refused = open("two.mcap", &OpenOptions { graph: Some(graph), ..with_rear(None) }).unwrap_err().to_string();
    assert!(refused.contains("nodes of one sensor"), "{refused}");
}
