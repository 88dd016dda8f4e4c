//! The time of preparing a scan and recognising a sensor, on one thread: `cargo bench -p voxelastic --bench sensor`.

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use voxelastic::Cloud;
use voxelastic::sensor::{BeamModel, CloudLayout, RangeLimits, ScanPreprocessor, detect, preset};

#[path = "../tests/all/sensor/scene.rs"]
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
            for (how, layout, cloud) in [("grid", CloudLayout::grid_of(&model), &cloud), ("projected", CloudLayout::Projected, &unorganised)] {
                let mut preprocessor = ScanPreprocessor::new(model.clone(), layout, RangeLimits::default());
                group.bench_function(format!("{name}/{world}/{how}"), |b| {
                    b.iter(|| pool.install(|| black_box(preprocessor.prepare(black_box(cloud)).returns.len())));
                });
            }
        }
    }
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
    targets = prepare, recognise
}
criterion_main!(benches);
