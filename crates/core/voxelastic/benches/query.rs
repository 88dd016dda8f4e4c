//! Queries a second on the map of a real hall (6.5 cm): `cargo bench -p voxelastic --bench query`. One thread, processor time.
#![allow(clippy::print_stderr)]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use std::hint::black_box;
use voxelastic::Settings;
use voxelastic::field::occupancy::State;
use voxelastic::query::{Capsule, DistanceQuery, FieldQuery, OrientedBox, Ray, Shape, Sphere, UnknownAs};
use voxelastic::settings::FieldKind;
use voxelastic::surface::MeshOptions;

#[path = "support/cpu_time.rs"]
mod cpu_time;
#[path = "../tests/all/query/hall.rs"]
mod hall;

use cpu_time::CpuTime;

const COUNT: usize = 20_000;
const RADIUS: f64 = 0.3;

/// Query points, in the frame of the query.
struct Places {
    /// Anywhere in the box of 36 x 36 x 5 m around the hall.
    anywhere: Vec<[f64; 3]>,
    /// Where a sphere is free: every voxel of it has to be known.
    free: Vec<[f64; 3]>,
    /// In free space, but with something within the sphere's radius.
    tight: Vec<[f64; 3]>,
}

fn places(map: &FieldQuery<'_>) -> Places {
    let mut rng = StdRng::seed_from_u64(7);
    let mut places = Places { anywhere: Vec::new(), free: Vec::new(), tight: Vec::new() };
    while places.free.len() < COUNT || places.tight.len() < COUNT {
        let p = [rng.random_range(-18.0..18.0), rng.random_range(-18.0..18.0), rng.random_range(-1.5..3.5)];
        places.anywhere.push(p);
        if map.is_free(&sphere(p), UnknownAs::Blocked) {
            places.free.push(p);
        } else if map.state(p) == State::Free {
            places.tight.push(p);
        }
    }
    [&mut places.anywhere, &mut places.free, &mut places.tight].into_iter().for_each(|list| list.truncate(COUNT));
    places
}

fn sphere(centre: [f64; 3]) -> Shape {
    Sphere { centre, radius: RADIUS }.into()
}

fn queries(c: &mut Criterion<CpuTime>) {
    // The sensor that the hall was scanned with: its columns leave the fewest pixels without a return.
    let settings = Settings { lambda_odom: 1000.0, sensor: "os0-64".to_owned(), ..Settings::default() };
    let Some(atlas) = hall::map(settings, 1) else { return };
    let submap = &atlas.submaps()[0];
    let field = submap.query();
    let map = atlas.query().unwrap();
    let places = places(&field);
    let mut group = c.benchmark_group("query");
    group.throughput(Throughput::Elements(COUNT as u64));
    for (name, list) in [("anywhere", &places.anywhere), ("free", &places.free), ("tight", &places.tight)] {
        let spheres: Vec<Shape> = list.iter().map(|&p| sphere(p)).collect();
        let count = |map: &dyn Fn(&Shape) -> bool| spheres.iter().filter(|s| map(black_box(s))).count();
        group.bench_function(BenchmarkId::new("sphere", name), |b| b.iter(|| count(&|s| field.is_free(s, UnknownAs::Blocked))));
        group.bench_function(BenchmarkId::new("sphere, atlas", name), |b| b.iter(|| count(&|s| map.is_free(s, UnknownAs::Blocked))));
    }
    let mut rng = StdRng::seed_from_u64(8);
    let mut direction = || std::array::from_fn(|k| rng.random_range(-1.0..1.0) * if k == 2 { 0.3 } else { 1.0 });
    let free = &places.free;
    let rays: Vec<Ray> = free.iter().map(|&origin| Ray { origin, direction: direction(), length: 20.0 }).collect();
    for (name, unknown) in [("to occupied or unknown", UnknownAs::Blocked), ("to occupied", UnknownAs::Free)] {
        let sum = |cast: &dyn Fn(&Ray) -> Option<f64>| rays.iter().filter_map(|r| cast(black_box(r))).sum::<f64>();
        group.bench_function(BenchmarkId::new("ray of 20 m", name), |b| b.iter(|| sum(&|r| field.ray_cast(r, unknown).map(|h| h.distance))));
        group.bench_function(BenchmarkId::new("ray of 20 m, atlas", name), |b| b.iter(|| sum(&|r| map.ray_cast(r, unknown).map(|h| h.distance))));
    }
    let shapes = |make: &mut dyn FnMut([f64; 3]) -> Shape| free.iter().map(|&p| make(p)).collect::<Vec<Shape>>();
    let capsules = shapes(&mut |from| {
        let d: [f64; 3] = direction();
        Capsule { from, to: std::array::from_fn(|k| from[k] + d[k]), radius: RADIUS }.into()
    });
    let boxes = shapes(&mut |p| {
        let t = voxelastic::Pose::from_parts(p.into(), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, direction()[0]));
        OrientedBox { t_frame_box: t, half: [0.4, 0.3, 0.2] }.into()
    });
    for (name, shapes) in [("capsule of 1 m", &capsules), ("box", &boxes)] {
        group.bench_function(name, |b| b.iter(|| shapes.iter().filter(|s| field.is_free(black_box(s), UnknownAs::Blocked)).count()));
    }
    let points: Vec<[f64; 3]> = places.anywhere.clone();
    group.bench_function("point", |b| b.iter(|| points.iter().filter(|p| field.state(black_box(**p)) == State::Free).count()));
    group.finish();
    eprintln!("frontier: {} points of 0.52 m, bounds {:?}", map.frontier(3).len(), map.bounds());
}

/// Many points at once: within some centimetres of the surfaces, and anywhere.
fn many_points(c: &mut Criterion<CpuTime>) {
    const MANY: usize = 1_000_000;
    // Work in this thread, whose time is measured.
    let _pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global();
    let settings = Settings { sensor: "os0-64".to_owned(), field: FieldKind::Both, ..Settings::default() };
    let Some(atlas) = hall::map_with(settings, 1) else { return };
    let (distances, space) = (DistanceQuery::new(&atlas), atlas.query().unwrap());
    let mut rng = StdRng::seed_from_u64(9);
    let vertices = atlas.mesh(&MeshOptions::default()).positions;
    let mut near = |_| {
        let v = vertices[rng.random_range(0..vertices.len())];
        v.map(|c| f64::from(c) + rng.random_range(-0.05..0.05))
    };
    let near: Vec<[f64; 3]> = (0..MANY).map(&mut near).collect();
    let anywhere = |_| [rng.random_range(-18.0..18.0), rng.random_range(-18.0..18.0), rng.random_range(-1.5..3.5)];
    let anywhere: Vec<[f64; 3]> = (0..MANY).map(anywhere).collect();
    let mut group = c.benchmark_group("1 M points");
    group.throughput(Throughput::Elements(MANY as u64)).sample_size(10);
    for (name, points) in [("near surfaces", &near), ("anywhere", &anywhere)] {
        group.bench_function(BenchmarkId::new("distance", name), |b| b.iter(|| distances.sample_distances(black_box(points))));
        group.bench_function(BenchmarkId::new("distance and gradient", name), |b| b.iter(|| distances.sample_many(black_box(points))));
        group.bench_function(BenchmarkId::new("distance and gradient, one by one", name), |b| {
            b.iter(|| points.iter().filter_map(|p| distances.sample(black_box(*p))).count());
        });
        group.bench_function(BenchmarkId::new("state", name), |b| b.iter(|| space.states(black_box(points))));
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(CpuTime).sample_size(20).measurement_time(std::time::Duration::from_secs(1)).warm_up_time(std::time::Duration::from_millis(300));
    targets = queries, many_points
}
criterion_main!(benches);
