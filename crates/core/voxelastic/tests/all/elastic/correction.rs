//! Drift, a loop and a correction: submaps move, fuse, deform and are rebuilt.

use crate::elastic::settings;
use crate::elastic::town::{LAP, Town};
use std::error::Error;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Edge, Event, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic::mapper::{RebuildError, ScanSource};
use voxelastic::surface::MeshOptions;
use voxelastic::{Cloud, Mapper, Pose, Settings};

const STEP: f64 = 2.0;

/// True poses and drifted ones of one and a half laps.
fn drive() -> Vec<(Pose, Pose)> {
    let truth: Vec<Pose> = (0..(1.5 * LAP / STEP) as usize).map(|i| Town::pose(i as f64 * STEP)).collect();
    // The drift is one in the map frame: over a lap, one in the lidar frame would cancel itself.
    let drifted: Vec<Pose> = truth.iter().enumerate().map(|(i, pose)| Pose::translation(0.03 * i as f64, 0.02 * i as f64, 0.0) * pose).collect();
    truth.into_iter().zip(drifted).collect()
}

struct ReplayedScans<'a>(&'a Town, &'a [(Pose, Pose)]);

impl ScanSource for ReplayedScans<'_> {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        let (truth, _) = self.1.get(node as usize).ok_or("no such scan")?;
        Ok(self.0.cloud(truth, node + 1))
    }
}

fn mean_height_error(atlas: &Atlas) -> f64 {
    // Ground and walls are at whole known places: x or y of +-30 and +-15, z of 0.
    let (mut sum, mut count) = (0.0, 0);
    for submap in atlas.submaps() {
        for p in &submap.mesh(&MeshOptions::default()).positions {
            let p = submap.t_map_submap() * nalgebra::Point3::from(p.map(f64::from));
            let walls = [p.x.abs(), p.y.abs()].into_iter().flat_map(|c| [(c - 30.0).abs(), (c - 15.0).abs()]).fold(p.z.abs(), f64::min);
            if walls < 1.5 {
                sum += walls;
                count += 1;
            }
        }
    }
    sum / f64::from(count)
}

#[test]
fn a_correction_moves_and_fuses_submaps_and_rebuilding_removes_deformation() {
    let (town, poses) = (Town::new(), drive());
    let mut mapper = Mapper::new(Settings { min_overlap: 1.0, ..settings() }).unwrap();
    let (mut loop_nodes, per_lap) = (Vec::new(), (LAP / STEP) as usize);
    for (i, (truth, drifted)) in poses.iter().enumerate() {
        mapper.handle(town.scan(i as NodeId, truth, drifted)).unwrap();
        if i >= per_lap && i % 8 == 0 {
            loop_nodes.push(i);
        }
    }
    for &i in &loop_nodes {
        let t_from_to = poses[i - per_lap].0.inv_mul(&poses[i].0);
        let edge = Edge { from: (i - per_lap) as NodeId, to: i as NodeId, t_from_to, information: None };
        mapper.handle(Event::LoopEdge(edge)).unwrap();
    }
    mapper.finish();
    assert_eq!(mapper.elastic_counts().fusions, 0, "the loops are open: poses are off by {:.2} m", off(&poses));
    assert_eq!(mapper.graph_counts().open_loops, loop_nodes.len());
    let (submaps, bytes, error) = (mapper.atlas().submaps().len(), mapper.atlas().bytes(), mean_height_error(mapper.atlas()));

    mapper.handle(Event::PoseUpdate(poses.iter().enumerate().map(|(i, p)| (i as NodeId, p.0)).collect())).unwrap();
    mapper.finish();
    let counts = mapper.elastic_counts();
    assert!(counts.submap_moves > 5 && counts.fusions > 2, "{counts:?}");
    assert_eq!(mapper.atlas().submaps().len() + counts.fusions, submaps);
    assert_eq!(mapper.atlas().scan_count(), poses.len(), "scans move with their submap");
    assert!((mapper.atlas().bytes() as f64) < 0.9 * bytes as f64, "memory falls: {} of {bytes}", mapper.atlas().bytes());
    let elastic = mean_height_error(mapper.atlas());
    assert!(elastic < 0.6 * error, "{elastic} against {error}");
    for submap in mapper.atlas().submaps() {
        assert!(submap.t_map_submap().translation_distance(&poses[submap.root_node().unwrap() as usize].0) < 1e-9);
    }

    // Each submap knows where its scans are now, those of merged submaps included.
    for submap in mapper.atlas().submaps() {
        for (i, scan) in submap.scans().iter().enumerate() {
            let t_submap_lidar = submap.corrected().get(i).unwrap_or(&scan.t_submap_lidar);
            let (now, expected) = (submap.t_map_submap() * t_submap_lidar, poses[scan.node as usize].0);
            // A submap is told when a scan moved by a quarter of a voxel.
            assert!(
                now.translation_distance(&expected) < 0.26 * f64::from(mapper.atlas().voxel_size()),
                "{}: {now} instead of {expected}",
                scan.node
            );
        }
    }

    let deformed = mapper.deformations();
    assert!(deformed.iter().any(|d| d.distance > 0.1), "{deformed:?}");
    let mut source = ReplayedScans(&town, &poses);
    for d in deformed {
        mapper.rebuild(d.submap, &mut source).unwrap();
    }
    assert!(mapper.deformed().is_empty() && mapper.deformations().iter().all(|d| d.distance < 1e-9));
    assert!(mapper.atlas().submaps().iter().all(|submap| submap.corrected().is_empty()), "what was rebuilt is where it should be");
    let rebuilt = mean_height_error(mapper.atlas());
    println!("error {error:.3} m with drift, {elastic:.3} elastic, {rebuilt:.3} rebuilt; {submaps} -> {} submaps", mapper.atlas().submaps().len());
    assert!(rebuilt <= elastic * 1.02 && mapper.atlas().scan_count() == poses.len());
}

#[test]
fn a_submap_is_rebuilt_a_scan_at_a_time_while_others_come() {
    let (town, poses) = (Town::new(), drive());
    let (poses, mut source) = (&poses[..9], ReplayedScans(&town, &poses[..9]));
    let settings = || Settings { min_overlap: 0.0, deform_tolerance: 0.5, ..settings() };
    let [mut mapper, mut right] = [(); 2].map(|()| Mapper::new(settings()).unwrap());
    for (i, (truth, drifted)) in poses.iter().enumerate() {
        right.handle(town.scan(i as NodeId, truth, truth)).unwrap();
        if i < 6 {
            mapper.handle(town.scan(i as NodeId, truth, drifted)).unwrap();
        }
    }
    let correction = |to: usize| Event::PoseUpdate(poses[..to].iter().enumerate().map(|(i, p)| (i as NodeId, p.0)).collect());
    mapper.handle(correction(6)).unwrap();
    let id = mapper.deformed()[0].submap;
    let old = mapper.atlas().submap(id).unwrap().revision();
    let mut rebuilding = mapper.begin_rebuild(id).unwrap();
    assert_eq!((rebuilding.submap(), rebuilding.remaining()), (id, 6));
    let mut next = 6;
    let report = loop {
        if let Some(report) = mapper.step_rebuild(&mut rebuilding, &mut source).unwrap() {
            break report;
        }
        if next < poses.len() && rebuilding.remaining() % 2 == 0 {
            mapper.handle(town.scan(next as NodeId, &poses[next].0, &poses[next].0)).unwrap();
            next += 1;
        }
    };
    let submap = mapper.atlas().submap(id).unwrap();
    assert_eq!((next, report.scans, submap.scans().len()), (9, 9, 9));
    assert!(submap.revision() > old + 100 && mapper.deformed().is_empty());
    mapper.finish();
    right.finish();
    // As if the poses had been right from the beginning.
    let meshes = [&mapper, &right].map(|mapper| mapper.atlas().submap(id).unwrap().mesh(&MeshOptions::default()).positions);
    assert!(meshes[0].len() > 1000 && meshes[0] == meshes[1], "{} and {} vertices", meshes[0].len(), meshes[1].len());
    assert!(matches!(mapper.begin_rebuild(999), Err(RebuildError::NoSuchSubmap { submap: 999 })));
}

fn off(poses: &[(Pose, Pose)]) -> f64 {
    poses.last().map_or(0.0, |(a, b)| a.translation_distance(b))
}

#[test]
fn small_corrections_are_ignored() {
    let town = Town::new();
    let mut mapper = Mapper::new(settings()).unwrap();
    let pose = Town::pose(0.0);
    mapper.handle(town.scan(5, &pose, &pose)).unwrap();
    let moved = |t: f64, yaw: f64| pose * Pose::new(nalgebra::Vector3::new(t, 0.0, 0.0), nalgebra::Vector3::new(0.0, 0.0, yaw));
    for (correction, follows) in [(moved(0.09, 0.0), false), (moved(0.0, 0.04), false), (moved(0.11, 0.0), true), (moved(0.11, 0.05), true)] {
        mapper.handle(Event::PoseUpdate(vec![(5, correction)])).unwrap();
        assert_eq!(mapper.atlas().submaps()[0].t_map_submap() == correction, follows);
    }
    assert_eq!(mapper.elastic_counts().submap_moves, 2);
}

#[test]
fn refused_fusions_are_done_when_another_loop_shortens_the_path() {
    // Out along y = 0, back along y = 2, then up, across, and down next to the start.
    let mut path: Vec<[f64; 2]> = (0..6).map(|i| [2.0 * f64::from(i), 0.0]).collect();
    path.extend((0..3).map(|i| [10.0 - 2.0 * f64::from(i), 2.0]));
    path.extend((2..8).map(|i| [6.0, 2.0 * f64::from(i)]));
    path.push([4.5, 15.5]);
    path.extend((0..8).map(|i| [3.0, 15.2 - 2.0 * f64::from(i)]));
    let poses: Vec<Pose> = path.iter().map(|[x, y]| Pose::translation(*x, *y, 0.0)).collect();
    let mut mapper = Mapper::new(Settings { lambda_odom: 10.1, lambda_cluster: 3.0, min_overlap: 1.0, ..settings() }).unwrap();
    for (node, pose) in poses.iter().enumerate() {
        let cloud = Cloud::from_points((0..50).map(|i| [2.0, 0.01 * i as f32, 0.0]).collect());
        let scan = voxelastic::event::Scan { node: node as NodeId, time: 0.0, t_map_lidar: *pose, cloud };
        mapper.handle(Event::Scan(scan)).unwrap();
    }
    let mut close = |from: usize, to: usize| {
        let t_from_to = poses[from].inv_mul(&poses[to]);
        mapper.handle(Event::LoopEdge(Edge { from: from as NodeId, to: to as NodeId, t_from_to, information: None })).unwrap();
        mapper.finish();
        (mapper.atlas().submaps().len(), mapper.elastic_counts().fusions, mapper.elastic_counts().size_limited_groups)
    };
    assert_eq!(close(4, 7), (4, 0, 1), "the end of the second submap is 18 m from the root of the first");
    assert_eq!(close(0, 23), (4, 0, 2));
    assert_eq!(close(8, 23), (3, 1, 1), "now it is 12.3 m: the first loop's fusion is done, although this loop connects two others");
}

#[test]
fn a_correction_of_a_thousand_submaps_touches_root_poses_only() {
    let point = || Cloud::from_points((0..50).map(|i| [2.0, 0.01 * i as f32, 0.0]).collect());
    let mut mapper = Mapper::new(Settings { lambda_odom: 1.0, lambda_cluster: 0.0, min_overlap: 1.0, ..settings() }).unwrap();
    for node in 0..1000 {
        let scan = voxelastic::event::Scan { node, time: 0.0, t_map_lidar: Pose::translation(3.0 * node as f64, 0.0, 0.0), cloud: point() };
        mapper.handle(Event::Scan(scan)).unwrap();
    }
    assert_eq!(mapper.atlas().submaps().len(), 1000);
    // A revision counts changes of a submap's content: a correction that touched voxels would raise it.
    let revisions = |mapper: &Mapper| mapper.atlas().submaps().iter().map(|submap| submap.revision()).collect::<Vec<_>>();
    let before = revisions(&mapper);
    for i in 0..20 {
        let poses = (0..1000).map(|node| (node, Pose::translation(3.0 * node as f64, 1.0 + f64::from(i), 0.0))).collect();
        mapper.handle(Event::PoseUpdate(poses)).unwrap();
    }
    assert_eq!(mapper.elastic_counts().submap_moves, 20_000);
    assert_eq!(revisions(&mapper), before);
}
