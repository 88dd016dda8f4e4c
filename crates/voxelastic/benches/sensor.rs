//! What it costs to get a scan ready: `cargo bench -p voxelastic --bench sensor`. One thread.

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use voxelastic::Cloud;
use voxelastic::sensor::{BeamModel, Layout, Limits, Preparer, Pyramid, detect, preset};

#[path = "../tests/sensor/scene.rs"]
#[allow(dead_code)]
mod scene;

fn clouds(model: &BeamModel) -> [(&'static str, Cloud); 2] {
    [("room", scene::Scene::room(0.02).scan(model, 1).cloud), ("street", scene::Scene::street(0.02).scan(model, 1).cloud)]
}

fn prepare(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap_or_else(|e| panic!("{e}"));
    let mut group = c.benchmark_group("prepare");
    for name in ["os1-64", "os1-128", "hdl-64e"] {
        let model = preset(name).unwrap_or_else(|e| panic!("{e}"));
        for (world, cloud) in clouds(&model) {
            let unorganised = Cloud::from_points(cloud.points.iter().copied().filter(Cloud::is_return).collect());
            for (how, layout, cloud) in [("grid", Layout::grid_of(&model), &cloud), ("projected", Layout::Projected, &unorganised)] {
                let mut preparer = Preparer::new(model.clone(), layout, Limits::default());
                group.bench_function(format!("{name}/{world}/{how}"), |b| {
                    b.iter(|| pool.install(|| black_box(preparer.prepare(black_box(cloud)).beams.len())));
                });
            }
        }
    }
}

fn pyramid(c: &mut Criterion) {
    let model = preset("os1-64").unwrap_or_else(|e| panic!("{e}"));
    let cloud = scene::Scene::street(0.02).scan(&model, 1).cloud;
    let mut preparer = Preparer::new(model.clone(), Layout::grid_of(&model), Limits::default());
    let image = preparer.prepare(&cloud).image.clone();
    let mut pyramid = Pyramid::default();
    c.bench_function("pyramid/build/os1-64", |b| b.iter(|| pyramid.build(black_box(&image))));
    c.bench_function("pyramid/classify", |b| b.iter(|| pyramid.classify(black_box([10, 25]), black_box([1015, 1040]))));
}

fn recognise(c: &mut Criterion) {
    let model = preset("os1-64").unwrap_or_else(|e| panic!("{e}"));
    let cloud = scene::Scene::street(0.02).scan(&model, 1).cloud;
    let unorganised = Cloud::from_points(cloud.points.iter().copied().filter(Cloud::is_return).collect());
    c.bench_function("detect/grid", |b| b.iter(|| detect(black_box(&[&cloud]))));
    c.bench_function("detect/unorganised", |b| b.iter(|| detect(black_box(&[&unorganised]))));
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(30).measurement_time(std::time::Duration::from_secs(2)).warm_up_time(std::time::Duration::from_millis(500));
    targets = prepare, pyramid, recognise
}
criterion_main!(benches);
