//! Closest-point queries on a mesh of a million triangles, and its rendering.

#![allow(missing_docs, reason = "criterion's macros make public items without documentation")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use voxelastic::Pose;
use voxelastic_eval::colour::Ramp;
use voxelastic_eval::render::{Camera, Colouring, MeshItem, Scene, Size, render};
use voxelastic_eval::{MeshIndex, MeshView};

/// Cells along an edge of the surface; each has two triangles.
const CELLS: usize = 708;
const QUERIES: usize = 1_000_000;

fn height(x: f32, y: f32) -> f32 {
    (x * 0.3).sin() * (y * 0.2).cos() * 3.0 + 0.05 * (x * 7.0).sin()
}

/// A hilly surface of 71 x 71 m.
fn surface() -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let n = CELLS;
    let at = |i: usize| ((i % (n + 1)) as f32 * 0.1, (i / (n + 1)) as f32 * 0.1);
    let vertices = (0..(n + 1) * (n + 1)).map(at).map(|(x, y)| [x, y, height(x, y)]).collect();
    let corners = (0..n * n).map(|i| (i / n * (n + 1) + i % n) as u32);
    let triangles = corners.flat_map(|p| [[p, p + 1, p + n as u32 + 2], [p, p + n as u32 + 2, p + n as u32 + 1]]).collect();
    (vertices, triangles)
}

/// Points up to half of `spread` metres above and below the surface.
fn queries(spread: f32) -> Vec<[f32; 3]> {
    let mut seed = 1u64;
    let mut random = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f32 / (1u64 << 24) as f32
    };
    (0..QUERIES).map(|_| [random() * 70.0, random() * 70.0, (random() - 0.5) * spread]).map(|[x, y, z]| [x, y, height(x, y) + z]).collect()
}

fn distances(criterion: &mut Criterion) {
    let (vertices, triangles) = surface();
    let Ok(mesh) = MeshView::new(&vertices, &triangles) else { return };
    let mut group = criterion.benchmark_group("mesh_distance");
    group.sample_size(10);
    group.bench_function("build", |b| b.iter(|| black_box(MeshIndex::new(&mesh).is_ok())));
    let Ok(index) = MeshIndex::new(&mesh) else { return };
    for (name, spread) in [("within_5_cm", 0.1), ("within_2_m", 4.0)] {
        let points = queries(spread);
        group.throughput(Throughput::Elements(QUERIES as u64));
        group.bench_function(name, |b| b.iter(|| black_box(index.distances(&points, f32::INFINITY))));
    }
    group.finish();
}

fn rendering(criterion: &mut Criterion) {
    let (vertices, triangles) = surface();
    let Ok(mesh) = MeshView::new(&vertices, &triangles) else { return };
    let mut scene = Scene::default();
    let colouring = Colouring::Height { ramp: Ramp::Land, low: -3.0, high: 3.0 };
    scene.meshes.push(MeshItem { mesh, t_map_mesh: Pose::identity(), colouring });
    let camera = Camera::perspective_orbit(&scene.bounds(), 30.0, 35.0, 45.0, 4.0 / 3.0);
    let mut group = criterion.benchmark_group("render");
    group.sample_size(10);
    group.bench_function("1600x1200", |b| b.iter(|| black_box(render(&scene, &camera, Size { width: 1600, height: 1200 }).is_ok())));
    group.finish();
}

criterion_group!(benches, distances, rendering);
criterion_main!(benches);
