//! Gaps between rows on one plane: what is interpolated is right, marked, and never stands in the way of a measurement.

use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, Scan};
use voxelastic::mapper::Mapper;
use voxelastic::settings::Settings;
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

fn street() -> Simulation {
    Simulation::new(SimOptions { spacing: 1.0, scans: Some(12), drift: 0.0, ..SimOptions::of("street") }).unwrap()
}

fn mapped(simulation: &Simulation, interpolate: f32, threads: usize) -> Atlas {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut mapper = Mapper::new(Settings { voxel_size: 0.1, max_range: 40.0, interpolate, ..Settings::default() }).unwrap();
    for (k, &t_map_lidar) in simulation.poses(PoseSource::Truth).iter().enumerate() {
        let scan = Scan { node: k as u64, time: k as f64, t_map_lidar, cloud: simulation.cloud(k).unwrap() };
        pool.install(|| mapper.handle(Event::Scan(scan))).unwrap();
    }
    pool.install(|| mapper.finish());
    mapper.into_atlas()
}

/// Area of the triangles without a marked vertex, and of those with one, square metres.
fn areas(mesh: &Mesh) -> [f64; 2] {
    let mut areas = [0.0; 2];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| nalgebra::Vector3::from(mesh.positions[v as usize].map(f64::from)));
        let is_marked = t.iter().any(|v| mesh.interpolated.get(*v as usize).is_some_and(|is| *is));
        areas[usize::from(is_marked)] += 0.5 * (b - a).cross(&(c - a)).norm();
    }
    areas
}

#[test]
fn gaps_between_rings_are_closed_marked_and_right() {
    let simulation = street();
    let [without, with] = [0.0, 3.0].map(|interpolate| mapped(&simulation, interpolate, 2));
    let marked = MeshOptions { interpolated: true, ..MeshOptions::default() };
    let [before, measured, all, none] =
        [(&without, MeshOptions::default()), (&with, MeshOptions::default()), (&with, marked.clone()), (&without, marked)]
            .map(|(atlas, o)| atlas.mesh(&o));
    let [[area, _], [kept, _], [certain, closed], [_, of_none]] = [&before, &measured, &all, &none].map(areas);
    println!(
        "{area:.0} m2 without; {kept:.0} m2 measured; with --interpolated {certain:.0} + {closed:.0} m2; {of_none:.0} m2 if nothing is interpolated"
    );
    assert!(before.interpolated.is_empty() && measured.interpolated.is_empty() && all.interpolated.len() == all.positions.len());
    assert!(closed > 0.2 * area, "gaps are a large part of a far street");
    assert!(kept > 0.95 * area, "what is measured stays");
    // Voxels at the end of the band behind a surface have less than an observation, too.
    assert!(of_none < 0.05 * area);
    let off = |v: usize| simulation.world().distance(all.positions[v].map(f64::from)).abs();
    let marks: Vec<f64> = (0..all.positions.len()).filter(|&v| all.interpolated[v]).map(off).collect();
    let within = |limit: f64| marks.iter().filter(|d| **d < limit).count() as f64 / marks.len() as f64;
    println!("of {} marked vertices, {:.4} are within 5 cm of the world and {:.4} within 10", marks.len(), within(0.05), within(0.1));
    assert!(within(0.05) > 0.92 && within(0.1) > 0.97);
}

#[test]
fn the_map_does_not_depend_on_threads() {
    let simulation = street();
    let [one, three] = [1, 3].map(|threads| mapped(&simulation, 3.0, threads));
    assert!(crate::image(&one) == crate::image(&three));
}
