//! Things that move leave no trace: a simulated street with cars and walkers, whose points are labelled.

use std::collections::HashSet;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, Scan};
use voxelastic::geometry::Rigid;
use voxelastic::mapper::Mapper;
use voxelastic::settings::Settings;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

/// Counts of returns, by label, and those of them that were set aside.
#[derive(Debug, Default, PartialEq)]
struct Counts {
    all: [usize; 4],
    set_aside: [usize; 4],
}

fn street() -> Simulation {
    let options = SimOptions { traffic: 24, rate: Some(10.0), scans: Some(32), drift: 0.0, ..SimOptions::of("street") };
    Simulation::new(options).unwrap()
}

fn settings(dynamic: &str) -> Settings {
    let mut settings = Settings { voxel_size: 0.15, max_range: 40.0, lambda_odom: 12.0, ..Settings::default() };
    settings.set("dynamic", dynamic).unwrap();
    settings
}

/// The map, and what was set aside after the first scans, before which nothing is known.
fn mapped(simulation: &Simulation, dynamic: &str, threads: usize) -> (Atlas, Counts) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let (mut mapper, mut counts) = (Mapper::new(settings(dynamic)).unwrap(), Counts::default());
    for k in 0..simulation.len() {
        let (cloud, labels) = simulation.labelled_cloud(k).unwrap();
        let t_map_lidar = simulation.poses(PoseSource::Truth)[k];
        let to_map = Rigid::from(&t_map_lidar);
        let points = cloud.points.clone();
        pool.install(|| mapper.handle(Event::Scan(Scan { node: k as u64, time: 0.1 * k as f64, t_map_lidar, cloud }))).unwrap();
        let bits = |p: &[f32; 3]| p.map(f32::to_bits);
        let set_aside: HashSet<[u32; 3]> = mapper.moving_points().iter().map(bits).collect();
        for (p, &label) in points.iter().zip(&labels).filter(|(p, _)| k > 15 && p.iter().map(|c| c * c).sum::<f32>().sqrt() < 39.9) {
            counts.all[usize::from(label)] += 1;
            counts.set_aside[usize::from(label)] += usize::from(set_aside.contains(&bits(&to_map.apply(*p))));
        }
    }
    pool.install(|| mapper.finish());
    (mapper.into_atlas(), counts)
}

#[test]
fn points_on_what_moves_are_set_aside_and_the_others_stay() {
    let simulation = street();
    let (_, counts) = mapped(&simulation, "remove", 2);
    let share = |label: usize| counts.set_aside[label] as f64 / counts.all[label] as f64;
    println!("{counts:?}: {:.4} of the world, {:.4} of what moves", share(0), share(1));
    assert!(share(0) < 0.002 && share(1) > 0.9);
}

#[test]
fn what_moves_leaves_the_map_and_nothing_depends_on_threads() {
    let simulation = street();
    let (kept, counts) = mapped(&simulation, "keep", 2);
    assert_eq!(counts.set_aside, [0; 4]);
    let (clean, one) = mapped(&simulation, "remove", 1);
    let (again, three) = mapped(&simulation, "remove", 3);
    assert_eq!(one, three);
    assert!(crate::elastic::image(&clean) == crate::elastic::image(&again));
    let observed =
        |atlas: &Atlas| crate::elastic::image(atlas).iter().flat_map(|(_, _, blocks)| blocks).flatten().filter(|v| v.is_observed()).count();
    println!("{} observed voxels, {} without what moves", observed(&kept), observed(&clean));
    assert!(observed(&clean) < observed(&kept) && observed(&clean) * 10 > observed(&kept) * 9);
}
