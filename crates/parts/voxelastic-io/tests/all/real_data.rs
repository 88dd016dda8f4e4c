//! The real folders, where they are (`VOXELASTIC_DATA`). They never enter the repository.

use std::path::PathBuf;
use std::time::Instant;
use voxelastic::event::Event;
use voxelastic::geometry::PoseExt;
use voxelastic_io::dataset::{self, MatchedBy, OpenOptions, PoseKind};
use voxelastic_io::{Error, clouds, g2o};
use voxelastic_testing::data;

fn with_poses(poses: &str) -> OpenOptions {
    OpenOptions { poses: Some(poses.into()), ..OpenOptions::default() }
}

/// Median milliseconds and megabytes per second of decoding up to 50 clouds.
fn measure(name: &str, paths: &[PathBuf]) {
    let (mut times, mut bytes, mut points) = (Vec::new(), 0, 0);
    for path in paths.iter().take(50) {
        bytes += std::fs::metadata(path).unwrap().len();
        let start = Instant::now();
        points += clouds::read(path).unwrap().cloud.len();
        times.push(start.elapsed().as_secs_f64());
    }
    let total: f64 = times.iter().sum();
    times.sort_by(f64::total_cmp);
    let (ms, mb_s, mp_s) = (times[times.len() / 2] * 1e3, bytes as f64 / total / 1e6, points as f64 / total / 1e6);
    eprintln!("{name}: {ms:.2} ms per scan (median), {mb_s:.0} MB/s, {mp_s:.0} M points/s");
}

#[test]
fn hall_opens_without_flags() {
    let Some(path) = data("hall") else { return };
    let dataset = dataset::open(&path, &OpenOptions { strict: true, ..OpenOptions::default() }).unwrap();
    eprintln!("{}", dataset.description());
    assert_eq!(dataset.scans().len(), 89);
    assert_eq!(dataset.description().poses.as_ref().unwrap().matched_by, MatchedBy::Order);
    assert!((dataset.scans()[88].time - 87.999_066).abs() < 1e-9);
    let travelled: f64 = dataset.scans().windows(2).map(|w| w[0].t_map_lidar.translation_distance(&w[1].t_map_lidar)).sum();
    assert!((travelled - 73.885).abs() < 0.001, "{travelled} m");

    let start = Instant::now();
    let (mut scans, mut odometry, mut points) = (0, 0, 0);
    for event in dataset.events() {
        match event.unwrap() {
            Event::Scan(scan) => (scans, points) = (scans + 1, points + scan.cloud.len()),
            Event::OdometryEdge(_) => odometry += 1,
            other => panic!("{other:?}"),
        }
    }
    eprintln!("hall: {scans} scans of {} points in {:.0} ms through events", points / scans, start.elapsed().as_secs_f64() * 1e3);
    assert_eq!((scans, odometry), (89, 88));
    measure("hall, binary PCD", &dataset.scans().iter().map(|s| s.path.clone()).collect::<Vec<_>>());
}

#[test]
fn kitti_street_asks_which_poses() {
    let Some(path) = data("kitti00-street") else { return };
    let Err(Error::Ambiguous { choices, flag, .. }) = dataset::open(&path, &OpenOptions::default()) else { panic!("guessed") };
    assert_eq!((choices, flag), (vec!["poses_groundtruth.txt".to_owned(), "poses_odometry.txt".to_owned()], "--poses"));

    let truth = dataset::open(&path, &with_poses("groundtruth")).unwrap();
    let drifted = dataset::open(&path, &with_poses("odometry")).unwrap();
    eprintln!("{}", drifted.description());
    assert_eq!((truth.scans().len(), drifted.scans().len()), (50, 50));
    // The odometry dataset shows the ground truth apart, and it is the other dataset's poses.
    let apart = &drifted.ground_truth().unwrap().t_map_lidar;
    for (scan, pose) in truth.scans().iter().zip(apart) {
        assert_eq!(Some(scan.t_map_lidar), *pose);
    }
    let end = drifted.scans()[49].t_map_lidar.translation_distance(&truth.scans()[49].t_map_lidar);
    assert!((0.5..1.5).contains(&end), "about 1 m of drift, but {end}");
    measure("kitti00-street, KITTI bin", &truth.scans().iter().map(|s| s.path.clone()).collect::<Vec<_>>());
}

#[test]
fn kitti_loops_brings_its_graph() {
    let Some(path) = data("kitti00-loops") else { return };
    let dataset = dataset::open(&path, &OpenOptions { strict: true, ..OpenOptions::default() }).unwrap();
    eprintln!("{}", dataset.description());
    assert_eq!(dataset.scans(), dataset::open(&path, &with_poses("optimized")).unwrap().scans());
    let started = dataset::open(&path, &OpenOptions { pose_kind: PoseKind::Odometry, ..OpenOptions::default() }).unwrap();
    assert_eq!(started.scans(), dataset::open(&path, &with_poses("odom")).unwrap().scans());
    assert_eq!((dataset.scans().len(), dataset.loop_edges().len()), (952, 35));
    assert!((dataset.scans()[951].time - 464.647_798).abs() < 1e-9);

    let poses = |name: &str| dataset::open(&path, &with_poses(name)).unwrap().scans().iter().map(|s| s.t_map_lidar).collect::<Vec<_>>();
    let (odometry, graph) = (poses("odom"), poses("singlesession"));
    for (a, b) in odometry.iter().zip(&graph) {
        assert!(a.translation_distance(b) < 1e-4 && a.rotation_distance(b) < 1e-4, "the graph starts at the odometry");
    }

    let (mut seen, mut loops, mut previous) = (std::collections::HashSet::new(), 0, f64::NEG_INFINITY);
    for event in dataset.events() {
        match event.unwrap() {
            Event::Scan(scan) => {
                assert!(scan.time > previous);
                previous = scan.time;
                seen.insert(scan.node);
            }
            Event::OdometryEdge(edge) => assert!(seen.contains(&edge.from) && seen.contains(&edge.to) && edge.information.is_some()),
            Event::LoopEdge(edge) => {
                assert!(seen.contains(&edge.from) && seen.contains(&edge.to));
                // A revisit: the measured pose agrees with the optimised ones.
                let (from, to) = (&dataset.scans()[edge.from as usize].t_map_lidar, &dataset.scans()[edge.to as usize].t_map_lidar);
                assert!(from.inv_mul(to).translation_distance(&edge.t_from_to) < 0.5);
                loops += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((seen.len(), loops), (952, 35));
    measure("kitti00-loops, binary PCD", &dataset.scans().iter().map(|s| s.path.clone()).collect::<Vec<_>>());
}

#[test]
fn public_pose_graphs_read_and_write_back() {
    let Some(path) = data("posegraphs") else { return };
    for (name, nodes, edges) in [("parking-garage", 1661, 6275), ("cubicle", 5750, 16869), ("sphere2500", 2500, 4949), ("tinyGrid3D", 9, 11)] {
        let start = Instant::now();
        let graph = g2o::read(path.join(name).with_extension("g2o")).unwrap();
        eprintln!("{name}: {} nodes, {} edges in {:.1} ms", graph.nodes.len(), graph.edges.len(), start.elapsed().as_secs_f64() * 1e3);
        assert_eq!((graph.nodes.len(), graph.edges.len()), (nodes, edges));
        let dir = tempfile::tempdir().unwrap();
        g2o::write(dir.path().join("g.g2o"), &graph).unwrap();
        assert_eq!(g2o::read(dir.path().join("g.g2o")).unwrap(), graph);
    }
}
