//! Distance fields of a simulated mine at 20 cm: `cargo bench -p voxelastic-esdf`. One thread.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use voxelastic::query::UnknownAs;
use voxelastic::settings::FieldKind;
use voxelastic::{Settings, event::Event, mapper::Mapper};
use voxelastic_esdf::{Esdf, EsdfSettings};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

const VOXEL: f32 = 0.2;
const POINTS: usize = 1 << 18;

fn fields(c: &mut Criterion) {
    let simulation = Simulation::new(SimOptions { scans: Some(8), ..SimOptions::of("mine") }).expect("a world");
    let mut mapper = Mapper::new(Settings { voxel_size: VOXEL, field: FieldKind::Both, ..Settings::default() }).expect("settings");
    simulation.scans(PoseSource::Truth).for_each(|scan| assert!(mapper.handle(Event::Scan(scan)).expect("a scan").is_some()));
    let atlas = mapper.into_atlas();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let mut group = c.benchmark_group("esdf");
    group.sample_size(10);
    for (name, unknown) in [("to obstacles", UnknownAs::Free), ("to what is not free", UnknownAs::Blocked)] {
        let made = || {
            let mut esdf = Esdf::new(EsdfSettings { max_distance: 2.0, unknown }, VOXEL).expect("settings");
            esdf.update(black_box(&atlas));
            esdf
        };
        group.throughput(Throughput::Elements(pool.install(made).blocks() as u64));
        group.bench_function(BenchmarkId::new("rebuild, blocks", name), |b| b.iter(|| pool.install(made)));
        let esdf = pool.install(made);
        let query = esdf.query(&atlas);
        let bounds = atlas.query().bounds();
        let points: Vec<[f32; 3]> = (0..POINTS)
            .map(|i| {
                let share = |step: f64| ((i as f64 * step).fract()) as f32;
                let at = [share(0.754_877_666), share(0.569_840_29), share(0.430_159_71)];
                std::array::from_fn(|k| bounds.min[k] + at[k] * bounds.size()[k])
            })
            .collect();
        group.throughput(Throughput::Elements(POINTS as u64));
        group.bench_function(BenchmarkId::new("sample", name), |b| b.iter(|| pool.install(|| query.sample_many(black_box(&points)))));
    }
}

criterion_group!(benches, fields);
criterion_main!(benches);
