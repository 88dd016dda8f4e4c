//! Tests of the whole renderer, and pictures for visual inspection.

use super::*;
use crate::colour::Ramp;
use crate::mesh::{MeshView, vertex_normals};
use voxelastic::Pose;

/// A room with floor, walls, a pillar, a step and a sphere, with front faces inside.
fn room() -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let (mut v, mut t) = (Vec::new(), Vec::new());
    quad(&mut v, &mut t, [[0.0, 0.0, 0.0], [12.0, 0.0, 0.0], [12.0, 8.0, 0.0], [0.0, 8.0, 0.0]]);
    quad(&mut v, &mut t, [[0.0, 0.0, 3.0], [0.0, 8.0, 3.0], [12.0, 8.0, 3.0], [12.0, 0.0, 3.0]]);
    quad(&mut v, &mut t, [[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [12.0, 0.0, 3.0], [12.0, 0.0, 0.0]]);
    quad(&mut v, &mut t, [[0.0, 8.0, 0.0], [12.0, 8.0, 0.0], [12.0, 8.0, 3.0], [0.0, 8.0, 3.0]]);
    quad(&mut v, &mut t, [[0.0, 0.0, 0.0], [0.0, 8.0, 0.0], [0.0, 8.0, 3.0], [0.0, 0.0, 3.0]]);
    quad(&mut v, &mut t, [[12.0, 0.0, 0.0], [12.0, 0.0, 3.0], [12.0, 8.0, 3.0], [12.0, 8.0, 0.0]]);
    for (lo, hi) in [([3.0, 3.0, 0.0], [3.6, 3.6, 3.0]), ([8.0, 5.0, 0.0], [11.0, 7.0, 0.4]), ([8.5, 5.5, 0.4], [10.5, 6.5, 0.8])] {
        block(&mut v, &mut t, lo, hi);
    }
    ball(&mut v, &mut t, [6.0, 2.5, 0.9], 0.9);
    (v, t)
}

fn quad(v: &mut Vec<[f32; 3]>, t: &mut Vec<[u32; 3]>, c: [[f32; 3]; 4]) {
    let n = v.len() as u32;
    v.extend(c);
    t.extend([[n, n + 1, n + 2], [n, n + 2, n + 3]]);
}

fn block(v: &mut Vec<[f32; 3]>, t: &mut Vec<[u32; 3]>, l: [f32; 3], h: [f32; 3]) {
    quad(v, t, [[l[0], l[1], h[2]], [h[0], l[1], h[2]], [h[0], h[1], h[2]], [l[0], h[1], h[2]]]);
    quad(v, t, [[l[0], l[1], l[2]], [h[0], l[1], l[2]], [h[0], l[1], h[2]], [l[0], l[1], h[2]]]);
    quad(v, t, [[l[0], h[1], l[2]], [l[0], h[1], h[2]], [h[0], h[1], h[2]], [h[0], h[1], l[2]]]);
    quad(v, t, [[l[0], l[1], l[2]], [l[0], l[1], h[2]], [l[0], h[1], h[2]], [l[0], h[1], l[2]]]);
    quad(v, t, [[h[0], l[1], l[2]], [h[0], h[1], l[2]], [h[0], h[1], h[2]], [h[0], l[1], h[2]]]);
}

fn ball(v: &mut Vec<[f32; 3]>, t: &mut Vec<[u32; 3]>, c: [f32; 3], r: f32) {
    let (n, rows, columns) = (v.len() as u32, 24u32, 48u32);
    for i in 0..=rows {
        for j in 0..=columns {
            let (a, b) = (i as f32 / rows as f32 * std::f32::consts::PI, j as f32 / columns as f32 * std::f32::consts::TAU);
            v.push([c[0] + r * a.sin() * b.cos(), c[1] + r * a.sin() * b.sin(), c[2] + r * a.cos()]);
        }
    }
    for i in 0..rows {
        for j in 0..columns {
            let (p, q) = (n + i * (columns + 1) + j, n + (i + 1) * (columns + 1) + j);
            t.extend([[p, q, q + 1], [p, q + 1, p + 1]]);
        }
    }
}

/// A hilly surface of `n` x `n` cells, two triangles each.
fn land(n: usize, edge: f32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let h = |x: f32, y: f32| 2.0 * (x * 0.11).sin() * (y * 0.07).cos() + 0.5 * (x * 0.5 + y * 0.3).sin() + 0.06 * (x * 4.1).sin() * (y * 3.7).cos();
    let step = edge / n as f32;
    let v = (0..=n * n + 2 * n).map(|i| ((i % (n + 1)) as f32 * step, (i / (n + 1)) as f32 * step)).map(|(x, y)| [x, y, h(x, y)]).collect();
    let t = (0..n * n).flat_map(|i| {
        let p = (i / n * (n + 1) + i % n) as u32;
        let q = p + n as u32 + 1;
        [[p, p + 1, q + 1], [p, q + 1, q]]
    });
    (v, t.collect())
}

fn room_scene<'a>(mesh: MeshView<'a>) -> Scene<'a> {
    let mut scene = Scene::default();
    scene.meshes.push(MeshItem { mesh, t_map_mesh: Pose::identity(), colouring: Colouring::Height { ramp: Ramp::Land, low: 0.0, high: 3.0 } });
    scene.polylines.push(Polyline {
        points: (0..60).map(|i| f64::from(i) * 0.15).map(|s| [1.5 + s, 4.0 + (s * 0.8).sin(), 1.0]).collect(),
        colour: [214, 60, 50],
        width: 3.0,
        on_top: false,
    });
    scene
}

#[test]
fn depth_test_and_culling() {
    let (v, t) = room();
    let mesh = MeshView::new(&v, &t).unwrap();
    let mut scene =
        Scene { meshes: vec![MeshItem { mesh, t_map_mesh: Pose::identity(), colouring: Colouring::Flat([200, 60, 60]) }], ..Scene::default() };
    scene.style = Style { scale_bar: false, occlusion: 0.0, ..Style::default() };
    let camera = Camera::top(&scene.bounds());
    let size = Size { width: 120, height: 90 };
    let closed = render(&scene, &camera, size).unwrap();
    scene.style.faces = Faces::Front;
    let open = render(&scene, &camera, size).unwrap();
    scene.style.faces = Faces::Both;
    scene.style.cut_above = Some(2.5);
    let cut = render(&scene, &camera, size).unwrap();
    let at = 45 * 120 + 30;
    assert_ne!(closed.pixels[at], open.pixels[at], "the ceiling's back is darker than the floor");
    assert_eq!(open.pixels[at], cut.pixels[at], "culling and cutting the ceiling show the same floor");
    assert_eq!(closed.pixels[0], [255; 3], "background");
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    let (v, t) = land(60, 30.0);
    let mesh = MeshView::new(&v, &t).unwrap();
    let scene = room_scene(mesh);
    let camera = Camera::perspective_orbit(&scene.bounds(), 30.0, 35.0, 45.0, 1.5);
    let draw = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&scene, &camera, Size { width: 150, height: 100 }).unwrap())
    };
    assert_eq!(draw(1), draw(3));
}

#[test]
fn main_bounds_ignore_outliers_and_contain_lines() {
    let mut points: Vec<[f32; 3]> = (0..10_000).map(|i| [(i % 100) as f32 * 0.1, (i / 100) as f32 * 0.2, (i % 7) as f32 * 0.1]).collect();
    points.extend([[500.0, -900.0, 80.0], [f32::NAN; 3]]);
    let mut scene = Scene::default();
    scene.clouds.push(CloudItem { points: &points, t_map_cloud: Pose::identity(), colouring: Colouring::Flat([0; 3]), size: PointSize::Pixels(1.0) });
    let b = scene.main_bounds(0.005);
    assert!(b.max[0] < 12.0 && b.max[1] < 23.0 && b.min[1] > -3.0 && b.max[2] < 1.0, "{b:?}");
    assert_eq!(scene.bounds().max[0], 500.0);
    scene.polylines.push(Polyline { points: vec![[30.0, 0.0, 0.0]], colour: [0; 3], width: 1.0, on_top: false });
    assert_eq!(scene.main_bounds(0.005).max[0], 30.0);
}

#[test]
fn degenerate_scenes_do_not_panic() {
    let vertices = [[f32::NAN, 0.0, 0.0], [1e30, 0.0, 0.0], [0.0, 1e30, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let triangles = [[0, 1, 2], [1, 2, 3], [3, 4, 5], [3, 3, 3]];
    let mesh = MeshView::new(&vertices, &triangles).unwrap();
    let mut scene = room_scene(mesh);
    scene.clouds.push(CloudItem {
        points: &vertices,
        t_map_cloud: Pose::identity(),
        colouring: Colouring::Flat([0; 3]),
        size: PointSize::Metres(1.0),
    });
    for camera in
        [Camera::look_at([0.2, 0.2, 0.1], [5.0, 5.0, 0.0], 90.0), Camera::look_at([0.0; 3], [0.0; 3], 1e9), Camera::top(&Default::default())]
    {
        render(&scene, &camera, Size { width: 33, height: 21 }).unwrap();
    }
    let camera = Camera::top(&scene.bounds());
    assert!(matches!(render(&scene, &camera, Size { width: 0, height: 5 }), Err(EvalError::Picture { .. })));
    scene.meshes[0].colouring = Colouring::Vertex(&[]);
    assert!(matches!(render(&scene, &camera, Size { width: 8, height: 8 }), Err(EvalError::Length { expected: 6, .. })));
}

/// Pictures for visual inspection: `cargo test -p voxelastic-eval --release -- --ignored pictures --nocapture` writes them to the temporary directory.
#[test]
#[ignore = "writes pictures for visual inspection"]
fn pictures_to_look_at() {
    let folder = std::env::temp_dir().join("voxelastic-pictures");
    std::fs::create_dir_all(&folder).unwrap();
    let (v, t) = room();
    let mesh = MeshView::new(&v, &t).unwrap();
    let mut scene = room_scene(mesh);
    scene.style = Style { faces: Faces::Front, title: "Room from above, 12.5 x 8 m".into(), ..Style::default() };
    scene.style.legend = Some(Legend { ramp: Ramp::Land, low: 0.0, high: 3.0, label: "height (m)".into() });
    let size = Size { width: 1200, height: 900 };
    render_png(&folder.join("room_top.png"), &scene, &Camera::top(&scene.bounds()), size).unwrap();
    render_png(&folder.join("room_orbit.png"), &scene, &Camera::orbit(&scene.bounds(), 35.0, 40.0), size).unwrap();
    scene.style = Style { faces: Faces::Front, title: "Inside".into(), ..Style::dark() };
    render_png(&folder.join("room_inside.png"), &scene, &Camera::look_at([1.0, 1.0, 1.7], [8.0, 5.0, 1.0], 75.0), size).unwrap();

    let (v, t) = land(708, 60.0);
    let mesh = MeshView::new(&v, &t).unwrap();
    let normals = vertex_normals(&mesh);
    let scene = room_scene(mesh.with_normals(&normals).unwrap());
    let camera = Camera::perspective_orbit(&scene.bounds(), 30.0, 35.0, 45.0, 4.0 / 3.0);
    let picture = render(&scene, &camera, Size { width: 1600, height: 1200 }).unwrap();
    picture.write_png(&folder.join("land.png")).unwrap();
    let mut cloud = Scene { style: Style::dark(), ..Scene::default() };
    let colouring = Colouring::Height { ramp: Ramp::Rainbow, low: -2.5, high: 2.5 };
    cloud.clouds.push(CloudItem { points: &v, t_map_cloud: Pose::identity(), colouring, size: PointSize::Pixels(2.0) });
    render_png(&folder.join("cloud.png"), &cloud, &camera, size).unwrap();
}
