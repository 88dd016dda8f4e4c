//! Every format, packing, layout and kind of pose.

use crate::drive::{Has, SCANS, check, every_scan, play, t_map_lidar};
use crate::{fixture, python};
use std::path::Path;
use voxelastic::event::Event;
use voxelastic::geometry::PoseExt;
use voxelastic_io::bag::{self, BagFormat, Recording};
use voxelastic_io::dataset::Every;
use voxelastic_io::{Error, OpenOptions, PoseGraph, g2o, poses};

const OUSTER: Has = Has { ring: true, time: true, rows: 16 };
const LINES: Has = Has { ring: true, time: true, rows: 1 };

#[test]
fn fixtures_of_every_container() {
    check(&fixture("ouster_bz2.bag"), &OUSTER, 1.5);
    check(&fixture("ouster_packed.db3"), &OUSTER, 1.5);
    check(&fixture("velodyne_layout.mcap"), &LINES, 1.5);
    check(&fixture("livox_layout.mcap"), &LINES, 1.5);
}

#[test]
fn everything_that_other_software_writes() {
    let dir = tempfile::tempdir().unwrap();
    if !python("rosbags, mcap", include_str!("write.py"), &[dir.path()]) {
        return;
    }
    let at = |name: &str| dir.path().join(name);
    for name in ["none.bag", "bz2.bag", "lz4.bag", "none.mcap", "lz4.mcap", "zstd.mcap", "flat.mcap", "plain", "packed", "tf.bag", "tf"] {
        check(&at(&format!("ouster_{name}")), &OUSTER, 1.5);
    }
    // These do not say whose poses they are: taken as those of the lidar.
    for name in ["pose_stamped.bag", "path.bag", "pose_stamped", "path"] {
        check(&at(&format!("ouster_{name}")), &OUSTER, 0.0);
    }
    for (layout, has) in [("velodyne", LINES), ("hesai", LINES), ("livox", LINES), ("big", Has { ring: false, time: false, rows: 4 })] {
        check(&at(&format!("{layout}_layout.bag")), &has, 1.5);
        check(&at(&format!("{layout}_layout.mcap")), &has, 1.5);
    }
}

#[test]
fn what_is_in_a_recording() {
    let formats = [("ouster_bz2.bag", BagFormat::Ros1), ("velodyne_layout.mcap", BagFormat::Mcap), ("ouster_packed.db3", BagFormat::Sqlite)];
    for (name, format) in formats {
        let d = bag::describe(fixture(name), &OpenOptions::default()).unwrap();
        assert_eq!((d.format, d.cloud_topic.as_deref(), d.poses.as_deref()), (format, Some("/points"), Some("/odometry")), "{name}");
        let topics: Vec<(&str, &str, Option<u64>)> = d.topics.iter().map(|t| (t.name.as_str(), t.kind.as_str(), t.messages)).collect();
        let clouds = ("/points", "sensor_msgs/PointCloud2", Some(12));
        assert_eq!(topics, [("/odometry", "nav_msgs/Odometry", Some(12)), clouds, ("/tf_static", "tf2_msgs/TFMessage", Some(1))], "{name}");
        let [first, last] = d.times.unwrap();
        assert!((first - 99.9).abs() < 1e-6 && (last - 101.35).abs() < 1e-6, "{name}: {first} {last}");
        assert!(d.problem.is_none() && d.to_string().contains("keyframes: every 2 m"), "{d}");
    }
}

#[test]
fn keyframes_and_selections() {
    let nodes = |options: &OpenOptions| play(&fixture("ouster_bz2.bag"), options).0.iter().map(|s| s.node).collect::<Vec<_>>();
    let every = |every: &str| OpenOptions { every: Some(every.parse().unwrap()), ..OpenOptions::default() };
    assert_eq!(nodes(&OpenOptions::default()), [0, 4, 8], "2 m of travel");
    assert_eq!(nodes(&every("0.3s")), [0, 3, 6, 9]);
    assert_eq!(nodes(&every("5")), [0, 5, 10]);
    let mut recording = Recording::open(fixture("ouster_bz2.bag"), &every_scan()).unwrap();
    recording.limit(7);
    recording.retain(|place| place % 3 != 2);
    let kept: Vec<u64> = recording.events().filter_map(|e| if let Ok(Event::Scan(s)) = e { Some(s.node) } else { None }).collect();
    assert_eq!((kept, recording.left_out()), (vec![0, 1, 3, 4, 6], 2));
}

#[test]
fn poses_and_a_graph_from_files_beside() {
    let dir = tempfile::tempdir().unwrap();
    let (trajectory, graph) = (dir.path().join("kf.tum"), dir.path().join("graph.g2o"));
    let keyframes = [0usize, 4, 8, 11];
    let stamped: Vec<(f64, _)> = keyframes.iter().map(|k| (100.0 + 0.1 * *k as f64, t_map_lidar(*k, 3.0))).collect();
    poses::write_tum(&trajectory, &stamped).unwrap();
    let edge = |from, to| voxelastic::event::Edge { from, to, t_from_to: voxelastic::Pose::translation(2.0, 0.0, 0.0), information: None };
    let nodes = (0..4).map(|k| (10 * k as u64, stamped[k].1)).collect();
    g2o::write(&graph, &PoseGraph { nodes, edges: vec![edge(0, 10), edge(10, 20), edge(20, 30), edge(0, 30)], ..PoseGraph::default() }).unwrap();

    let options = OpenOptions { poses: Some(trajectory.clone()), ..every_scan() };
    let (scans, errors) = play(&fixture("ouster_bz2.bag"), &options);
    assert_eq!(scans.iter().map(|s| s.node).collect::<Vec<_>>(), [0, 4, 8, 9, 10, 11], "0.4 s between poses is too far to guess, 0.3 s is not");
    assert!(errors.len() == 1 && errors[0].to_string().contains("6 of 12 clouds have no pose"), "{errors:?}");
    assert!((scans[1].t_map_lidar.translation.z - 3.0).abs() < 1e-12, "the transforms of the bag do not move poses of the lidar");

    let options = OpenOptions { graph: Some(graph), poses: Some(trajectory), ..OpenOptions::default() };
    let recording = Recording::open(fixture("ouster_bz2.bag"), &options).unwrap();
    assert_eq!(recording.description().graph, Some([4, 1]));
    let mut told = Vec::new();
    for event in recording.events() {
        match event {
            Ok(Event::Scan(s)) => told.push(format!("scan {}", s.node)),
            Ok(Event::OdometryEdge(e)) => told.push(format!("{} to {}, {} m", e.from, e.to, e.t_from_to.translation.x)),
            Ok(Event::LoopEdge(e)) => told.push(format!("loop {} {}", e.from, e.to)),
            _ => {}
        }
    }
    let expected = ["scan 0", "scan 10", "0 to 10, 2 m", "scan 20", "10 to 20, 2 m", "scan 30", "20 to 30, 2 m", "loop 0 30"];
    assert_eq!(told, expected);
}

#[test]
fn what_cannot_be_meant_is_said() {
    let open = |options: OpenOptions| Recording::open(fixture("ouster_bz2.bag"), &options).unwrap_err();
    let topic = open(OpenOptions { cloud_topic: Some("/velodyne".into()), ..OpenOptions::default() });
    assert!(topic.to_string().contains("no such topic: /velodyne; it has /points"), "{topic}");
    let topic = open(OpenOptions { pose_topic: Some("points".into()), ..OpenOptions::default() });
    assert!(topic.to_string().contains("/odometry"), "{topic}");
    let lonely = open(OpenOptions { graph: Some("graph.g2o".into()), ..OpenOptions::default() });
    assert!(lonely.to_string().contains("--poses"), "{lonely}");
    let none = Recording::open(Path::new(file!()).file_name().map(|_| fixture("../main.rs")).unwrap(), &OpenOptions::default()).unwrap_err();
    assert!(matches!(&none, Error::Content { .. }) && none.to_string().contains("not a recording"), "{none}");
    // A name without its slash will do.
    let chosen =
        OpenOptions { cloud_topic: Some("points".into()), pose_topic: Some("odometry".into()), every: Some(Every::Nth(4)), ..OpenOptions::default() };
    let (scans, _) = play(&fixture("ouster_bz2.bag"), &chosen);
    assert_eq!(scans.len(), SCANS / 4);
    assert!(scans[1].t_map_lidar.translation_distance(&t_map_lidar(4, 1.5)) < 1e-9);
}

/// Not a check but a table: format, size, time to read a scan. `cargo test --release -p voxelastic-io --test bags -- --ignored --nocapture`
#[test]
#[ignore = "figures: minutes of writing"]
fn figures_of_a_real_street() {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    let street = Path::new(&std::env::var("VOXELASTIC_DATA").unwrap_or_else(|_| default.into())).join("kitti00-street");
    let dir = tempfile::tempdir().unwrap();
    let script = [include_str!("write.py"), include_str!("street.py")].concat();
    if !street.is_dir() || !python("rosbags, mcap", &script, &[&street, dir.path()]) {
        eprintln!("skipped: needs kitti00-street (VOXELASTIC_DATA)");
        return;
    }
    let mut recordings: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().path()).collect();
    recordings.sort();
    for path in recordings {
        let files = if path.is_dir() { std::fs::read_dir(&path).unwrap().map(|e| e.unwrap().path()).collect() } else { vec![path.clone()] };
        let bytes: u64 = files.iter().map(|f| std::fs::metadata(f).unwrap().len()).sum();
        let clock = std::time::Instant::now();
        let recording = Recording::open(&path, &every_scan()).unwrap();
        let opened = clock.elapsed().as_secs_f64();
        let scans = recording.events().filter(|e| matches!(e, Ok(Event::Scan(_)))).count();
        let seconds = clock.elapsed().as_secs_f64() - opened;
        let (name, mb) = (path.file_name().unwrap().to_string_lossy().into_owned(), bytes as f64 / 1e6);
        let ms = 1e3 * seconds / scans as f64;
        eprintln!("{name:<20} {scans} scans, {mb:6.1} MB, opened in {:5.1} ms, {ms:6.2} ms a scan, {:6.0} MB/s", 1e3 * opened, mb / seconds);
    }
}
