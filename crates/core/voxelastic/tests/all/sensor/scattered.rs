//! Clouds of which no image fits: beams that never repeat, and thinned clouds.

use voxelastic::Cloud;
use voxelastic::geometry::Rigid;
use voxelastic::sensor::{CloudLayout, RangeLimits, ScanPreprocessor, detect};
use voxelastic_sim::sensor::{LidarSettings, Noise};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

/// A simulation of a room, and its first cloud.
fn room(sensor: &str, thin: Option<f64>) -> (Simulation, Cloud, Rigid) {
    let lidar = LidarSettings { noise: Noise { mixed: 0.0, ..Noise::default() }, ..LidarSettings::default() };
    let simulation = Simulation::new(SimOptions { sensor: sensor.into(), thin, scans: Some(2), lidar, ..SimOptions::of("room") }).unwrap();
    let scan = simulation.scan(0, PoseSource::Truth).unwrap();
    (simulation, scan.cloud, Rigid::from(&scan.t_map_lidar))
}

#[test]
fn every_return_is_used_and_lies_on_its_plane() {
    for (sensor, thin) in [("avia", None), ("mid-360", None), ("os1-64", Some(0.2))] {
        let (simulation, cloud, t_map_lidar) = room(sensor, thin);
        let found = detect(&[&cloud]).unwrap();
        println!("{sensor}: {}", found.description);
        assert_eq!((&found.layout, found.layout.name()), (&CloudLayout::Scattered, "scattered"), "{sensor}");
        let mut preprocessor = ScanPreprocessor::new(found.model, found.layout, RangeLimits { near: 0.0, max: 100.0 });
        preprocessor.fill_between(0.05);
        let scan = preprocessor.prepare(&cloud);
        let (returns, measured) = (&scan.returns, scan.returns.measured);
        assert_eq!((scan.counts.usable, scan.counts.outside), (cloud.len(), 0), "{sensor}");
        let mut sources = returns.source[..measured].to_vec();
        sources.sort_unstable();
        assert!(sources.iter().copied().eq(0..cloud.len() as u32), "{sensor}: each return once");
        // Planes agree with the world's, and points between returns lie on its surface.
        let (mut planes, mut right) = (0, 0);
        for (p, n) in returns.points.iter().zip(&returns.normals).take(measured).filter(|(_, n)| **n != [0.0; 3]) {
            let at = t_map_lidar.apply(*p).map(f64::from);
            let step = |k: usize, by: f64| simulation.world().distance(std::array::from_fn(|j| at[j] + if j == k { by } else { 0.0 }));
            let gradient: [f64; 3] = std::array::from_fn(|k| (step(k, 0.02) - step(k, -0.02)) / 0.04);
            let cosine: f64 = t_map_lidar.rotate(*n).iter().zip(gradient).map(|(a, b)| f64::from(*a) * b).sum();
            planes += 1;
            right += usize::from(cosine > 0.95);
        }
        println!("{sensor}: {planes} planes of {measured} returns, {right} right, {} points between", returns.len() - measured);
        assert!(planes * 10 > measured * 8 && right * 100 > planes * 94, "{sensor}");
        let off = |p: &[f32; 3]| simulation.world().distance(t_map_lidar.apply(*p).map(f64::from)).abs();
        let between: Vec<f64> = returns.points[measured..].iter().map(off).collect();
        let near = between.iter().filter(|d| **d < 0.05).count();
        assert!(between.len() > 1000 && near * 1000 > between.len() * 995, "{sensor}: {near} of {} points are on the surface", between.len());
    }
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let (_, cloud, _) = room("avia", Some(0.1));
    let prepared = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let found = detect(&[&cloud]).unwrap();
            let mut preprocessor = ScanPreprocessor::new(found.model, found.layout, RangeLimits::default());
            preprocessor.fill_between(0.05);
            preprocessor.prepare(&cloud).clone()
        })
    };
    assert!(prepared(1) == prepared(5));
}

#[test]
fn a_thinned_cloud_is_told_from_an_image_by_returns_without_neighbours() {
    for (thin, is_scattered) in [(0.1, false), (0.3, true), (0.4, true)] {
        let simulation = Simulation::new(SimOptions { thin: Some(thin), scans: Some(5), spacing: 4.0, ..SimOptions::of("campus") }).unwrap();
        for k in 0..5 {
            let cloud = simulation.scan(k, PoseSource::Truth).unwrap().cloud;
            let found = detect(&[&cloud]).unwrap();
            println!("{thin} m, scan {k}: {}", found.description);
            assert_eq!(found.layout == CloudLayout::Scattered, is_scattered, "{thin} m, scan {k}: {}", found.description);
            assert!(is_scattered || found.fit.alone < 0.15, "{thin} m, scan {k}: {:?}", found.fit);
        }
    }
}
