//! Every format, packing, layout and kind of pose.

use crate::bags::drive::{Has, SCANS, check, every_scan, play, t_map_lidar};
use crate::bags::fixture;
use std::path::Path;
use voxelastic::event::Event;
use voxelastic::geometry::PoseExt;
use voxelastic_io::bag::{self, BagFormat, Recording};
use voxelastic_io::dataset::Keyframing;
use voxelastic_io::ouster::{Capture, find_metadata};
use voxelastic_io::{Error, OpenOptions, PoseGraph, clouds, g2o, poses, source};
use voxelastic_testing::run_python;

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
    if run_python("rosbags, mcap", include_str!("write.py"), &[dir.path()]).is_none() {
        return;
    }
    let at = |name: &str| dir.path().join(name);
    for name in ["none.bag", "bz2.bag", "lz4.bag", "none.mcap", "lz4.mcap", "zstd.mcap", "flat.mcap", "plain", "packed", "tf.bag", "tf"] {
        check(&at(&format!("ouster_{name}")), &OUSTER, 1.5);
    }
    for name in ["split_db3", "split_mcap"] {
        check(&at(name), &OUSTER, 1.5);
        let d = bag::describe(at(name), &OpenOptions::default()).unwrap();
        let clouds = d.topics.iter().find(|t| t.name == "/points").unwrap().messages;
        assert_eq!((d.files.len(), clouds, d.times.map(|[a, b]| (10.0 * (b - a)).round())), (2, Some(12), Some(15.0)), "{name}");
    }
    // These do not say whose poses they are: taken as those of the lidar.
    for name in ["pose_stamped.bag", "path.bag", "pose_stamped", "path"] {
        check(&at(&format!("ouster_{name}")), &OUSTER, 0.0);
    }
    for (layout, has) in [("velodyne", LINES), ("hesai", LINES), ("livox", LINES), ("big", Has { ring: false, time: false, rows: 4 })] {
        check(&at(&format!("{layout}_layout.bag")), &has, 1.5);
        check(&at(&format!("{layout}_layout.mcap")), &has, 1.5);
    }
    let (scans, _) = play(&at("shares.mcap"), &every_scan());
    assert_eq!(scans.len(), SCANS);
    for scan in &scans {
        let last = scan.cloud.time.as_ref().unwrap().last().unwrap();
        assert!((last - 0.1).abs() < 1e-6, "scan {} comes 0.1 s before the next, and its last point {last} s after its first", scan.node);
    }
    let apart = Recording::open(at("apart.mcap"), &every_scan()).unwrap_err().to_string();
    assert!(apart.contains("nothing in /tf leads from lidar") && apart.contains("odom > ~base_link; rack > lidar"), "{apart}");
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
    let every = |every: &str| OpenOptions { keyframing: Some(every.parse().unwrap()), ..OpenOptions::default() };
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
    let source = source::open(fixture("ouster_bz2.bag"), &options).unwrap();
    let looked = source.preview().count();
    assert_eq!(source.without_pose(), 0, "a look is not counted");
    assert_eq!((source.events().count(), source.without_pose()), (looked, 6));

    let options = OpenOptions { graph: Some(graph), poses: Some(trajectory), ..OpenOptions::default() };
    let recording = Recording::open(fixture("ouster_bz2.bag"), &options).unwrap();
    assert_eq!(recording.description().graph, Some([4, 1]));
    let mut described = Vec::new();
    for event in recording.events() {
        match event {
            Ok(Event::Scan(s)) => described.push(format!("scan {}", s.node)),
            Ok(Event::OdometryEdge(e)) => described.push(format!("{} to {}, {} m", e.from, e.to, e.t_from_to.translation.x)),
            Ok(Event::LoopEdge(e)) => described.push(format!("loop {} {}", e.from, e.to)),
            _ => {}
        }
    }
    let expected = ["scan 0", "scan 10", "0 to 10, 2 m", "scan 20", "10 to 20, 2 m", "scan 30", "20 to 30, 2 m", "loop 0 30"];
    assert_eq!(described, expected);
}

#[test]
fn corrected_trajectories_beside_a_recording_come_when_they_were_known() {
    let dir = tempfile::tempdir().unwrap();
    // As of scan 5 the poses of the vehicle are 1 m higher, as of the end 2 m.
    for (time, height) in [("100.55", 1.0), ("200", 2.0)] {
        let stamped: Vec<(f64, _)> = (0..SCANS).map(|k| (100.0 + 0.1 * k as f64, t_map_lidar(k, height))).collect();
        poses::write_tum(dir.path().join(format!("poses@{time}.tum")), &stamped).unwrap();
    }
    let options = OpenOptions { graph: Some(dir.path().into()), ..every_scan() };
    let recording = Recording::open(fixture("ouster_bz2.bag"), &options).unwrap();
    assert!(recording.description().to_string().contains("corrected 2 times"), "{}", recording.description());
    let (mut scans, mut updates) = (0, Vec::new());
    for event in recording.events() {
        match event.unwrap() {
            Event::Scan(_) => scans += 1,
            Event::PoseUpdate(poses) => {
                let last = poses.last().unwrap();
                let expected = t_map_lidar(last.0 as usize, updates.len() as f64 + 1.0 + 1.5);
                assert!(last.1.translation_distance(&expected) < 1e-6, "the lidar is 1.5 m above the vehicle: {last:?}");
                updates.push((scans, poses.len()));
            }
            _ => {}
        }
    }
    assert_eq!((scans, updates), (SCANS, vec![(6, 6), (12, 12)]));
    let empty = tempfile::tempdir().unwrap();
    let none = Recording::open(fixture("ouster_bz2.bag"), &OpenOptions { graph: Some(empty.path().into()), ..every_scan() }).unwrap_err();
    assert!(none.to_string().contains("no corrected poses"), "{none}");
}

#[test]
fn scans_after_a_correction_go_on_from_it() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, height: fn(usize) -> f64| {
        let stamped: Vec<(f64, _)> = (0..SCANS).map(|k| (100.0 + 0.1 * k as f64, t_map_lidar(k, height(k)))).collect();
        poses::write_tum(dir.path().join(name), &stamped).unwrap();
    };
    write("poses@100.55.tum", |_| 1.0);
    write("poses@100.85.tum", |_| 3.0);
    write("as_it_went.tum", |k| [0.0, 1.0, 3.0][usize::from(k > 5) + usize::from(k > 8)]);
    let heights = |options: OpenOptions, lidar: f64| -> Vec<i64> {
        let recording = Recording::open(fixture("ouster_bz2.bag"), &OpenOptions { graph: Some(dir.path().into()), ..options }).unwrap();
        let scans = recording.events().filter_map(|e| if let Event::Scan(scan) = e.unwrap() { Some(scan) } else { None });
        scans.map(|scan| ((scan.t_map_lidar.translation.z - lidar) * 1000.0).round() as i64).collect()
    };
    let expected = [[0; 6].as_slice(), &[1000; 3], &[3000; 3]].concat();
    assert_eq!(heights(every_scan(), 1.5), expected, "the odometry of the recording has no corrections");
    let as_it_went = OpenOptions { poses: Some(dir.path().join("as_it_went.tum")), ..every_scan() };
    assert_eq!(heights(as_it_went, 0.0), expected, "these poses have the corrections in them");
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
    let none = Recording::open(Path::new(file!()).file_name().map(|_| fixture("../mod.rs")).unwrap(), &OpenOptions::default()).unwrap_err();
    assert!(matches!(&none, Error::Content { .. }) && none.to_string().contains("not a recording"), "{none}");
    // A name without its slash will do.
    let chosen = OpenOptions {
        cloud_topic: Some("points".into()),
        pose_topic: Some("odometry".into()),
        keyframing: Some(Keyframing::Nth(4)),
        ..OpenOptions::default()
    };
    let (scans, _) = play(&fixture("ouster_bz2.bag"), &chosen);
    assert_eq!(scans.len(), SCANS / 4);
    assert!(scans[1].t_map_lidar.translation_distance(&t_map_lidar(4, 1.5)) < 1e-9);
}

/// A line of the table of [`figures_of_a_real_street`]: what `read` takes for the files in `path`, which returns the number of scans.
fn figure(path: &Path, by: &str, read: impl FnOnce() -> usize) {
    let files = if path.is_dir() { std::fs::read_dir(path).unwrap().map(|e| e.unwrap().path()).collect() } else { vec![path.to_owned()] };
    let mb = files.iter().map(|f| std::fs::metadata(f).unwrap().len()).sum::<u64>() as f64 / 1e6;
    let clock = std::time::Instant::now();
    let scans = read();
    let seconds = clock.elapsed().as_secs_f64();
    let (name, ms) = (path.file_name().unwrap().to_string_lossy().into_owned(), 1e3 * seconds / scans as f64);
    eprintln!("| {name} | {by} | {scans} | {mb:.1} | {ms:.2} | {:.0} |", mb / seconds);
}

/// Not a check but a table. `cargo test --release -p voxelastic-io --test all bags -- --ignored --nocapture`
#[test]
#[ignore = "figures: minutes of writing"]
fn figures_of_a_real_street() {
    let Some(street) = voxelastic_testing::data("kitti00-street") else { return };
    let dir = tempfile::tempdir().unwrap();
    let script = [include_str!("write.py"), include_str!("street.py")].concat();
    if run_python("rosbags, mcap", &script, &[&street, dir.path()]).is_none() {
        return;
    }
    let sorted = |folder: &Path| {
        let mut all: Vec<_> = std::fs::read_dir(folder).into_iter().flatten().map(|e| e.unwrap().path()).collect();
        all.sort();
        all
    };
    eprintln!("| format | written by | scans | MB | ms a scan | MB/s |\n| --- | --- | --- | --- | --- | --- |");
    for path in sorted(&dir.path().join("recordings")) {
        let by = if path.extension().is_some_and(|e| e == "mcap") { "mcap" } else { "rosbags" };
        let play = || Recording::open(&path, &every_scan()).unwrap().events().filter(|e| matches!(e, Ok(Event::Scan(_)))).count();
        figure(&path, by, play);
    }
    for folder in sorted(&dir.path().join("clouds")) {
        let by = match folder.file_name().and_then(|n| n.to_str()) {
            Some("las" | "laz") => "laspy",
            Some("e57") => "pye57",
            Some("bin") => "KITTI",
            _ => "Open3D",
        };
        figure(&folder, by, || sorted(&folder).iter().filter(|f| clouds::read(f).is_ok()).count());
    }
    for capture in sorted(&voxelastic_testing::data_folder().join("ouster")).iter().filter(|p| p.extension().is_some_and(|e| e == "pcap")) {
        let metadata = find_metadata(capture).unwrap();
        let read = || {
            let mut capture = Capture::open(capture, &metadata).unwrap();
            std::iter::from_fn(|| capture.next_scan()).filter(Result::is_ok).count()
        };
        figure(capture, "Ouster sensor", read);
    }
}
