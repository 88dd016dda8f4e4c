//! Known ground costs less: where surfaces are known, scans take turns, and the map is as good.

use std::collections::HashMap;
use voxelastic::Cloud;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, Scan};
use voxelastic::geometry::{Pose, Rigid};
use voxelastic::mapper::Mapper;
use voxelastic::query::DistanceQuery;
use voxelastic::settings::Settings;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

/// A robot that walks.
fn walk(scans: usize) -> Simulation {
    Simulation::new(SimOptions { spacing: 0.13, scans: Some(scans), drift: 0.0, ..SimOptions::of("campus") }).unwrap()
}

/// The map of a simulation, and the number of rays of each scan.
fn mapped(simulation: &Simulation, known_after: f32, threads: usize) -> (Atlas, Vec<usize>) {
    mapped_with(simulation, known_after, threads, |_| None)
}

/// As [`mapped`], with a box in some scans.
fn mapped_with(simulation: &Simulation, known_after: f32, threads: usize, built: impl Fn(usize) -> Option<Cuboid>) -> (Atlas, Vec<usize>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut mapper = Mapper::new(Settings { voxel_size: 0.1, max_range: 40.0, known_after, ..Settings::default() }).unwrap();
    let poses = simulation.poses(PoseSource::Truth);
    let rays = (0..simulation.len()).map(|k| {
        let mut cloud = simulation.cloud(k).unwrap();
        built(k).into_iter().for_each(|cuboid| cuboid.add_to(&mut cloud, &poses[k]));
        let scan = Scan { node: k as u64, time: 0.1 * k as f64, t_map_lidar: poses[k], cloud };
        pool.install(|| mapper.handle(Event::Scan(scan))).unwrap().unwrap().tsdf.unwrap().rays
    });
    let rays = rays.collect();
    pool.install(|| mapper.finish());
    (mapper.into_atlas(), rays)
}

/// Share of `points` at which the map has a surface, and the mean distance between both there, metres.
fn agreement(atlas: &Atlas, points: &[[f64; 3]]) -> (f64, f64) {
    let samples = DistanceQuery::new(atlas).sample_many(points);
    let distances: Vec<f64> = samples.into_iter().flatten().map(|sample| f64::from(sample.distance).abs()).filter(|d| *d < 0.1).collect();
    (distances.len() as f64 / points.len() as f64, distances.iter().sum::<f64>() / distances.len() as f64)
}

/// A box in the map frame.
#[derive(Clone, Copy)]
struct Cuboid {
    low: [f64; 3],
    high: [f64; 3],
}

impl Cuboid {
    /// Moves the points of a scan that are behind it to its surface.
    fn add_to(&self, cloud: &mut Cloud, t_map_lidar: &Pose) {
        let (to_map, to_lidar) = (Rigid::from(t_map_lidar), Rigid::from(&t_map_lidar.inverse()));
        for point in &mut cloud.points {
            let (end, start) = (to_map.apply(*point), to_map.translation);
            let (mut enter, mut leave) = (0.0, 1.0);
            for k in 0..3 {
                let way = f64::from(end[k] - start[k]);
                let [a, b] = [self.low[k], self.high[k]].map(|face| (face - f64::from(start[k])) / way);
                (enter, leave) = (f64::max(enter, a.min(b)), f64::min(leave, a.max(b)));
            }
            if enter > 0.0 && enter < leave {
                *point = to_lidar.apply([0, 1, 2].map(|k| start[k] + enter as f32 * (end[k] - start[k])));
            }
        }
    }
}

#[test]
fn known_ground_takes_fewer_rays_and_the_map_is_as_good() {
    let simulation = walk(60);
    let points: Vec<[f64; 3]> = simulation.visible_surface(0.3, 20.0).into_iter().map(|p| p.point).collect();
    let [(every, all), (turns, some)] = [0.0, 10.0].map(|known_after| mapped(&simulation, known_after, 2));
    let last = |rays: &[usize]| rays[50..].iter().sum::<usize>() as f64;
    let [(share_every, error_every), (share_turns, error_turns)] = [&every, &turns].map(|atlas| agreement(atlas, &points));
    println!(
        "{:.2} of the rays; {share_turns:.4} and {error_turns:.4} m, with all {share_every:.4} and {error_every:.4} m",
        last(&some) / last(&all)
    );
    assert_eq!(all[0], some[0], "nothing is known before the first scan");
    assert!(last(&some) < 0.5 * last(&all));
    assert!(share_turns > share_every - 0.002 && error_turns < error_every + 0.001);
}

#[test]
fn each_of_two_sensors_that_alternate_comes_to_all_of_its_patches() {
    let simulation = walk(1);
    let t_map_lidar = simulation.poses(PoseSource::Truth)[0];
    // The second sensor sees little, so that nearly all observations are of the first, which stands still.
    let weights = |known_after: f32| {
        let settings = Settings { voxel_size: 0.1, max_range: 40.0, known_after, sensor: "os1-64".into(), ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        for k in 0..64 {
            let mut cloud = simulation.cloud(0).unwrap();
            cloud.sensor = k % 2;
            if k % 2 == 1 {
                cloud.points.iter_mut().skip(200).for_each(|point| *point = [0.0; 3]);
                cloud.points[..200].fill([2.0, 0.0, 0.0]);
            }
            mapper.handle(Event::Scan(Scan { node: k.into(), time: 0.1 * f64::from(k), t_map_lidar, cloud })).unwrap();
        }
        let atlas = mapper.into_atlas();
        let field = atlas.submaps()[0].tsdf();
        let of_block = |id| field.stored_voxels(id).iter().map(|voxel| u64::from(voxel.weight)).sum::<u64>();
        field.ids().map(|id| (field.block(id).key, of_block(id))).collect::<HashMap<u64, u64>>()
    };
    let [every, turns] = [0.0, 3.0].map(weights);
    let of_half = every.iter().filter(|(key, weight)| turns.get(key).is_some_and(|turns| 2 * turns >= **weight)).count();
    println!("{of_half} of {} blocks have half of the weight or more", every.len());
    assert!(of_half * 100 > every.len() * 97);
}

#[test]
fn a_surface_that_moves_on_known_ground_is_followed_as_fast() {
    let simulation = walk(60);
    let at = simulation.poses(PoseSource::Truth)[40].translation.vector;
    let low = [at.x + 3.0, at.y - 0.6, at.z - 0.6];
    let cuboid = |nearer: f64| Cuboid { low: [low[0] - nearer, low[1], low[2]], high: [low[0] + 0.8, low[1] + 1.2, low[2] + 1.0] };
    let face: Vec<[f64; 3]> =
        (0..110).map(|i| [low[0] - 0.05, low[1] + 0.1 + 0.1 * (i % 10) as f64, low[2] + 0.1 + 0.06 * (i / 10) as f64]).collect();
    // Half a voxel nearer from the fortieth scan on.
    let [every, turns] = [0.0, 10.0]
        .map(|known_after| agreement(&mapped_with(&simulation, known_after, 2, |k| Some(cuboid(if k < 40 { 0.0 } else { 0.05 }))).0, &face));
    println!("{turns:?}, with all rays {every:?}");
    assert!(every.0 > 0.9 && turns.0 >= every.0 - 0.01 && turns.1 < every.1 + 0.005);
}

#[test]
fn the_map_does_not_depend_on_threads() {
    let simulation = walk(25);
    let [(one, rays_one), (three, rays_three)] = [1, 3].map(|threads| mapped(&simulation, 3.0, threads));
    assert_eq!(rays_one, rays_three);
    assert!(crate::image(&one) == crate::image(&three));
}

#[test]
fn what_is_built_on_known_ground_is_mapped_at_once() {
    let simulation = walk(43);
    let at = simulation.poses(PoseSource::Truth)[40].translation.vector;
    let low = [at.x + 3.0, at.y - 0.4, at.z - 0.6];
    let cuboid = Cuboid { low, high: [low[0] + 0.8, low[1] + 0.8, low[2] + 1.0] };
    // The face towards the sensor, without its edges.
    let step = |i: usize| 0.1 + 0.06 * i as f64;
    let face: Vec<[f64; 3]> = (0..110).map(|i| [low[0], low[1] + step(i % 10), low[2] + step(i / 10)]).collect();
    let [every, turns] =
        [0.0, 10.0].map(|known_after| agreement(&mapped_with(&simulation, known_after, 2, |k| (k >= 40).then_some(cuboid)).0, &face));
    println!("{turns:?}, with all rays {every:?}");
    assert!(every.0 > 0.9 && turns.0 >= every.0 - 0.01 && turns.1 < every.1 + 0.002);
}
