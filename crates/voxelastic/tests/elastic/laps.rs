//! Laps of one loop: what is explored already adds no submaps and next to no memory (paper Sec. VI).

use crate::town::{LAP, Town};
use crate::{image, settings};
use voxelastic::event::{Edge, Event};
use voxelastic::settings::FieldKind;
use voxelastic::{Mapper, Pose, Settings};

const STEP: f64 = 2.0;
const PER_LAP: usize = (LAP / STEP) as usize;

/// Laps that do not repeat their poses exactly.
fn scans(laps: usize) -> Vec<(Pose, Event)> {
    let town = Town::new();
    (0..laps * PER_LAP)
        .map(|node| {
            let lap = (node / PER_LAP) as f64;
            let pose = Town::pose(node as f64 * STEP + 0.37 * lap) * Pose::translation(0.0, 0.3 * lap, 0.0);
            (pose, town.scan(node as u64, &pose, &pose))
        })
        .collect()
}

/// Drives the laps; returns submaps and bytes after each.
fn drive(settings: Settings, scans: &[(Pose, Event)], has_loops: bool) -> (Mapper, Vec<(usize, usize)>) {
    let mut mapper = Mapper::new(settings).unwrap();
    let mut after = Vec::new();
    let edge = |from: usize, to: usize| {
        let t_from_to = scans[from].0.inv_mul(&scans[to].0);
        Edge { from: from as u64, to: to as u64, t_from_to, information: None }
    };
    for (node, (_, scan)) in scans.iter().enumerate() {
        if node > 0 {
            mapper.handle(Event::OdometryEdge(edge(node - 1, node))).unwrap();
        }
        mapper.handle(scan.clone()).unwrap();
        if has_loops && node >= PER_LAP && node % 10 == 5 {
            mapper.handle(Event::LoopEdge(edge(node % PER_LAP, node))).unwrap();
        }
        if (node + 1) % PER_LAP == 0 {
            mapper.finish();
            after.push((mapper.atlas().submaps().len(), mapper.atlas().bytes()));
        }
    }
    (mapper, after)
}

#[test]
fn laps_add_no_submaps_and_little_memory() {
    let scans = scans(5);
    for (field, has_loops) in [(FieldKind::Tsdf, true), (FieldKind::Tsdf, false), (FieldKind::Occupancy, false)] {
        let (mapper, after) = drive(Settings { field, ..settings() }, &scans, has_loops);
        println!("{field:?}, loops {has_loops}: submaps and bytes after each lap {after:?}, {:?}", mapper.elastic_counts());
        assert!(after[0].0 >= 5, "a lap has several submaps");
        for lap in 2..after.len() {
            assert!(after[lap].0 <= after[lap - 1].0, "no new submaps: {after:?}");
            let most = after[1..lap].iter().map(|a| a.1).max().unwrap();
            assert!(after[lap].1 as f64 <= 1.05 * most as f64, "memory: {after:?}");
        }
        assert_eq!(mapper.atlas().scan_count(), scans.len());
    }
}

#[test]
fn the_map_does_not_depend_on_the_number_of_threads() {
    let scans = scans(2);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| image(&drive(settings(), &scans, true).0.into_atlas()))
    };
    let one = with(1);
    assert!(one == with(3), "maps differ");
}
