//! The time of a scan by phase, and of scale changes, fusion and meshing, on one thread: `cargo bench -p voxelastic --bench integrate`.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::Duration;
use voxelastic::atlas::fusion::{FusionSettings, Merge, Resampled, Sampling};
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::event::{Event, Scan};
use voxelastic::field::occupancy::OccupancyField;
use voxelastic::field::tsdf::propagate::{Interpolation, propagate_delta_down, propagate_down, propagate_up};
use voxelastic::field::tsdf::{TsdfField, Voxel, WEIGHT_ONE};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::{OccupancyIntegrator, OccupancySettings, ReturnsView, TsdfIntegrator, TsdfSettings};
use voxelastic::sensor::{CloudLayout, PreparedScan, RangeLimits, ScanPreprocessor, preset};
use voxelastic::settings::{FieldKind, Settings};
use voxelastic::surface::{MeshOptions, OccupancySurface, extract, extract_occupancy};
use voxelastic::{Mapper, Pose};

#[path = "../tests/all/sensor/scene.rs"]
#[allow(dead_code)]
mod scene;

/// Scans with different noise, taken at one place: all but the first find their blocks in the map.
const SCANS: u64 = 6;

fn one_thread() -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap_or_else(|e| panic!("{e}"))
}

fn prepared() -> Vec<PreparedScan> {
    let model = preset("os1-64").unwrap_or_else(|e| panic!("{e}"));
    let mut preprocessor = ScanPreprocessor::new(model.clone(), CloudLayout::grid_of(&model), RangeLimits::default());
    (0..SCANS).map(|seed| preprocessor.prepare(&scene::Scene::street(0.02).scan(&model, seed).cloud).clone()).collect()
}

fn returns(scan: &PreparedScan) -> ReturnsView<'_> {
    ReturnsView::new(&scan.returns)
}

fn here() -> Rigid {
    Rigid::from(&Pose::translation(0.01, 0.02, 0.03))
}

/// Benchmarks one phase after the other. `round` integrates a scan into an empty map, or one more into a map of the same place, and returns the time of each
/// phase.
fn phases(c: &mut Criterion, field: &str, names: &[&str], mut round: impl FnMut(bool) -> Vec<Duration>) {
    let mut group = c.benchmark_group(field);
    for (which, is_new) in [("new place", true), ("known place", false)] {
        for (number, name) in names.iter().enumerate() {
            group.bench_function(BenchmarkId::new(*name, which), |b| {
                b.iter_custom(|iterations| (0..iterations).map(|_| round(is_new)[number]).sum());
            });
        }
    }
    group.finish();
}

fn tsdf(c: &mut Criterion) {
    let (pool, scans) = (one_thread(), prepared());
    let mut integrator = TsdfIntegrator::new(TsdfSettings::default());
    let mut known = TsdfField::default();
    let mut turn = 0;
    phases(c, "tsdf", &["transform", "select", "allocate", "update"], |is_new| {
        let mut fresh = TsdfField::default();
        turn = (turn + 1) % scans.len();
        let field = if is_new { &mut fresh } else { &mut known };
        let done = pool.install(|| integrator.integrate(field, &here(), &returns(&scans[turn]))).phases;
        vec![done.transform, done.select, done.allocate, done.update]
    });
}

fn occupancy(c: &mut Criterion) {
    let (pool, scans) = (one_thread(), prepared());
    let model = preset("os1-64").unwrap_or_else(|e| panic!("{e}"));
    let mut integrator = OccupancyIntegrator::new(OccupancySettings::default(), &model);
    let mut known = OccupancyField::default();
    let mut turn = 0;
    phases(c, "occupancy", &["see", "descend", "select", "allocate", "update", "propagate"], |is_new| {
        let mut fresh = OccupancyField::default();
        turn = (turn + 1) % scans.len();
        let (field, scan) = (if is_new { &mut fresh } else { &mut known }, &scans[turn]);
        let done = pool.install(|| integrator.integrate(field, &here(), &scan.image, &returns(scan), false)).phases;
        vec![done.see, done.descend, done.select, done.allocate, done.update, done.propagate]
    });
}

/// One block that changes its scale.
fn propagation(c: &mut Criterion) {
    let voxel = |i: usize| Voxel { distance: (i * 37 % 4001) as i16 - 2000, weight: if i.is_multiple_of(5) { 0 } else { WEIGHT_ONE } };
    let (fine, coarse): (Vec<Voxel>, Vec<Voxel>) = ((0..512).map(voxel).collect(), (0..64).map(voxel).collect());
    let past: Vec<Voxel> = (1..65).map(voxel).collect();
    let mut group = c.benchmark_group("propagation of a block");
    let (mut up, mut down) = (coarse.clone(), fine.clone());
    group.bench_function("up", |b| b.iter(|| propagate_up(black_box(&fine), &mut up, 0)));
    group.bench_function("down, new", |b| b.iter(|| propagate_down(black_box(&coarse), &mut down, 0, &Interpolation::NEAR)));
    group.bench_function("down, difference", |b| {
        b.iter(|| propagate_delta_down(black_box(&coarse), &past, &mut down, 0, 100 * WEIGHT_ONE, &Interpolation::NEAR))
    });
    group.finish();
}

/// Two submaps of the street, 20 cm apart and turned a little.
fn two_submaps(field: FieldKind) -> Atlas {
    let model = preset("os1-64").unwrap_or_else(|e| panic!("{e}"));
    let mut atlas = Atlas::new(Settings::default().voxel_size);
    for seed in 0..2 {
        let settings = Settings { field, sensor: "os1-64".to_owned(), ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap_or_else(|e| panic!("{e}"));
        let t_map_lidar = Pose::new(nalgebra::Vector3::new(0.2, 0.1, 0.0) * seed as f64, nalgebra::Vector3::new(0.0, 0.0, 0.02) * seed as f64);
        let cloud = scene::Scene::street(0.02).scan(&model, seed).cloud;
        mapper.handle(Event::Scan(Scan { node: seed, time: 0.0, t_map_lidar, cloud })).unwrap_or_else(|e| panic!("{e}"));
        let submap = mapper.into_atlas().submaps()[0].clone();
        atlas = Atlas::from_submaps(atlas.voxel_size(), atlas.submaps().iter().cloned().chain([submap.with_id(seed as u32)]).collect());
    }
    atlas
}

fn fusion(c: &mut Criterion) {
    let pool = one_thread();
    let settings = FusionSettings::from(&Settings::default());
    let mut group = c.benchmark_group("fusion");
    for (name, field) in [("tsdf", FieldKind::Tsdf), ("occupancy", FieldKind::Occupancy)] {
        let atlas = two_submaps(field);
        let (target, source) = (&atlas.submaps()[0], &atlas.submaps()[1]);
        let t_target_source = target.t_map_submap().inverse() * source.t_map_submap();
        let sample = || {
            pool.install(|| {
                let sampling = Sampling::new(source, &t_target_source);
                (0..sampling.parts()).map(|number| sampling.part(number)).collect::<Vec<_>>()
            })
        };
        group.bench_function(BenchmarkId::new("resample", name), |b| b.iter(sample));
        group.bench_function(BenchmarkId::new("merge", name), |b| {
            let make = || (sample(), target.clone());
            let merge = |(parts, mut target): (Vec<Resampled>, Submap)| {
                parts.into_iter().for_each(|part| {
                    Merge::new(part, settings).step(&mut target, usize::MAX);
                });
                target
            };
            b.iter_batched(make, merge, criterion::BatchSize::LargeInput);
        });
    }
    group.finish();
}

fn meshing(c: &mut Criterion) {
    let pool = one_thread();
    let (tsdf, occupancy) = (two_submaps(FieldKind::Tsdf), two_submaps(FieldKind::Occupancy));
    let voxel = Settings::default().voxel_size;
    let mut group = c.benchmark_group("meshing");
    for lod in [0, 2] {
        let options = MeshOptions { lod, ..MeshOptions::default() };
        let field = tsdf.submaps()[0].tsdf();
        group.bench_function(BenchmarkId::new("tsdf, level of detail", lod), |b| b.iter(|| pool.install(|| extract(field, voxel, &options))));
    }
    let field = occupancy.submaps()[0].occupancy();
    let occupied = || pool.install(|| extract_occupancy(field, voxel, OccupancySurface::Occupied, 0));
    group.bench_function("occupancy", |b| b.iter(occupied));
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(Duration::from_secs(1)).warm_up_time(Duration::from_millis(300));
    targets = tsdf, occupancy, propagation, fusion, meshing
}
criterion_main!(benches);
