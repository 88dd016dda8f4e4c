//! Laps of one loop: repeated laps add no submaps and little memory (paper Sec. VI).

use crate::elastic::town::{LAP, Town};
use crate::elastic::{image, settings};
use std::collections::HashSet;
use std::ops::Range;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Edge, Event};
use voxelastic::settings::FieldKind;
use voxelastic::surface::MeshOptions;
use voxelastic::{Mapper, Pose, Settings};

const STEP: f64 = 2.0;
const PER_LAP: usize = (LAP / STEP) as usize;

/// Laps that do not repeat their poses exactly.
fn scans(laps: usize) -> Vec<(Pose, Event)> {
    scans_of(&Town::new(), 0..laps)
}

fn scans_of(town: &Town, laps: Range<usize>) -> Vec<(Pose, Event)> {
    (laps.start * PER_LAP..laps.end * PER_LAP)
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

/// Vertices of all meshes, in the map frame.
fn vertices(atlas: &Atlas) -> Vec<[f64; 3]> {
    let of = |submap: &voxelastic::atlas::Submap| {
        let mesh = submap.mesh(&MeshOptions::default());
        let in_map = |p: &[f32; 3]| (submap.t_map_submap() * nalgebra::Point3::from(p.map(f64::from))).coords.into();
        mesh.positions.iter().map(in_map).collect::<Vec<_>>()
    };
    atlas.submaps().iter().flat_map(of).collect()
}

#[test]
fn a_second_lap_adds_new_structures_and_little_else() {
    // On the empty street next to the path, and against a wall.
    let built = [([23.4, 3.0, 0.0], [24.4, 4.0, 2.0]), ([-4.0, 28.6, 1.0], [-2.0, 30.0, 3.0])];
    let new_town = built.iter().fold(Town::new(), |town, &(low, high)| town.with_box(low, high));
    let scans = [scans_of(&Town::new(), 0..1), scans_of(&new_town, 1..2)].concat();
    let drive = |revisit_radius: f64| drive(Settings { revisit_radius, ..settings() }, &scans, true);
    let [(selective, after), (complete, after_all)] = [2.5, 0.0].map(drive);
    let added = |after: &[(usize, usize)]| after[1].1 as f64 / after[0].1 as f64 - 1.0;
    println!("a second lap adds {:+.3}, or {:+.3} if everything is added", added(&after), added(&after_all));
    assert_eq!(after[0], after_all[0], "the first lap is the same");
    assert!(added(&after) < 0.02 && added(&after_all) > added(&after) + 0.05);
    let meshes = [selective, complete].map(|mapper| vertices(mapper.atlas()));
    for (low, high) in built {
        // The face towards the path: at its x or y that is nearer to 22.
        let axis = usize::from(high[1] > 20.0);
        let face = if (low[axis] - 22.0).abs() < (high[axis] - 22.0).abs() { low[axis] } else { high[axis] };
        let is_on_face = |p: &&[f64; 3]| (p[axis] - face).abs() < 0.1 && (0..3).all(|k| k == axis || (low[k] + 0.1..high[k] - 0.1).contains(&p[k]));
        // Several submaps may show the same face, so parts of it are counted, of 25 cm.
        let part = |p: &[f64; 3]| p.map(|c| (4.0 * c).floor() as i32);
        let [found, of] = meshes.each_ref().map(|mesh| mesh.iter().filter(is_on_face).map(part).collect::<HashSet<_>>().len());
        println!("{found} parts of the face at {face} of {low:?} to {high:?}, {of} if everything is added");
        // Blocks that contain parts of the ground or the wall, and observed octants (80 cm here) in their gaps, are not updated again.
        assert!(of >= 20 && found as f64 >= 0.75 * of as f64, "a new box is in the map");
    }
}

#[test]
fn without_a_closed_loop_everything_is_added() {
    let scans = scans(2);
    let map = |revisit_radius: f64, has_loops: bool| {
        let settings = Settings { revisit_radius, min_overlap: 1.0, ..settings() };
        image(&drive(settings, &scans, has_loops).0.into_atlas())
    };
    assert!(map(2.5, false) == map(0.0, false), "poses alone prove no return");
    assert!(map(2.5, true) != map(0.0, true));
}
