//! Distance fields of a simulated mine at 20 cm: `cargo bench -p voxelastic-esdf`. One thread; slices with all.

use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use voxelastic::query::UnknownAs;
use voxelastic::settings::FieldKind;
use voxelastic::{Settings, event::Event, mapper::Mapper};
use voxelastic_esdf::{Esdf, EsdfSettings, LocalEsdf};
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
        let bounds = atlas.query().unwrap().bounds();
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

/// A slice of 20 m x 20 m around the robot, of a field that is made where it is asked for: the first, and after one more scan.
fn slices(c: &mut Criterion) {
    let simulation = Simulation::new(SimOptions { scans: Some(9), ..SimOptions::of("mine") }).expect("a world");
    let mut mapper = Mapper::new(Settings { voxel_size: VOXEL, field: FieldKind::Both, ..Settings::default() }).expect("settings");
    let mut scans: Vec<_> = simulation.scans(PoseSource::Truth).collect();
    let last = scans.pop().expect("scans");
    scans.into_iter().for_each(|scan| assert!(mapper.handle(Event::Scan(scan)).expect("a scan").is_some()));
    let here = last.t_map_lidar.translation;
    let step = |k: i32| 20.0 / 128.0 * f64::from(k);
    let points: Vec<[f64; 3]> = (-64..=64).flat_map(|y| (-64..=64).map(move |x| [here.x + step(x), here.y + step(y), here.z])).collect();
    let new = || LocalEsdf::new(EsdfSettings::default(), VOXEL).expect("settings");
    let mut group = c.benchmark_group("slice");
    group.sample_size(10);
    group.bench_function("the first", |b| b.iter_batched(new, |mut esdf| esdf.sample_many(mapper.atlas(), &points), BatchSize::LargeInput));
    let mut before = new();
    before.sample_many(mapper.atlas(), &points);
    mapper.handle(Event::Scan(last)).expect("a scan");
    let again = || before.clone();
    group.bench_function("after a scan", |b| b.iter_batched(again, |mut esdf| esdf.sample_many(mapper.atlas(), &points), BatchSize::LargeInput));
}

criterion_group!(benches, fields, slices);
criterion_main!(benches);
