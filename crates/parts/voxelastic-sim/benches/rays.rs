//! Ray casting and distance queries in the worlds: scans of an OS1-64 without noise, on one thread.

#![allow(missing_docs, reason = "criterion's macros make public items without documentation")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use voxelastic_sim::solid::Vec3;
use voxelastic_sim::{Ray, Scene};

/// The rays of a scan of 64 x 1024 beams at a time of the scene's trajectory, column by column.
fn rays(scene: &Scene, time: f64) -> Vec<Ray> {
    let pose = scene.trajectory.pose(time);
    let origin = pose.translation.vector;
    let beam = |column: u32, row: u32| {
        let (azimuth, elevation) = (f64::from(column) * std::f64::consts::TAU / 1024.0, (16.611 - f64::from(row) * 0.5273f64).to_radians());
        pose * Vec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin())
    };
    (0..1024).flat_map(|column| (0..64).map(move |row| (column, row))).map(|(column, row)| (origin, beam(column, row))).collect()
}

fn cast(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("cast_64x1024");
    group.throughput(Throughput::Elements(65_536)).sample_size(10);
    for name in ["campus", "mine", "street", "room"] {
        let Ok(scene) = Scene::named(name, 1) else { continue };
        let scans: Vec<Vec<Ray>> = (0..8).map(|k| rays(&scene, f64::from(k) * 30.0)).collect();
        let mut hits = vec![None; 65_536];
        let mut next = 0;
        group.bench_function(name, |b| {
            b.iter(|| {
                next = (next + 1) % scans.len();
                scene.world.cast_all(&scans[next], 120.0, &mut hits);
                black_box(hits[100])
            });
        });
    }
    group.finish();
}

fn distance(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("distance");
    group.sample_size(10);
    for name in ["campus", "mine"] {
        let Ok(scene) = Scene::named(name, 1) else { continue };
        // Near the surface on both sides, like the vertices of a mesh.
        let mut points = scene.world.sample_surface(0.3, 1);
        points.truncate(5000);
        for (k, s) in points.iter_mut().enumerate() {
            let off = 0.03 * ((k % 7) as f64 - 3.0) / 3.0;
            s.point = std::array::from_fn(|i| s.point[i] + off * s.normal[i]);
        }
        group.throughput(Throughput::Elements(points.len() as u64));
        group.bench_function(name, |b| b.iter(|| points.iter().map(|s| scene.world.distance(s.point)).sum::<f64>()));
    }
    group.finish();
}

criterion_group!(benches, cast, distance);
criterion_main!(benches);
