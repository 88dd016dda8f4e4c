//! Geometry stage: transforms, clips and projects the scene, and sorts the screen primitives into tiles.

use super::camera::{Camera, Lens};
use super::scene::{Faces, PointSize, Scene};
use super::tiles::{SUPERSAMPLING, TILE, TileGrid};
use crate::vec3;
use nalgebra::Point3;
use rayon::prelude::*;
use voxelastic::Pose;
use voxelastic::geometry::Rigid;

/// Primitives per task.
const CHUNK: usize = 1 << 14;

/// A screen primitive, in samples. `id` counts triangles, then points, then line segments over the whole scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Primitive {
    pub id: u32,
    pub shape: Shape,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    /// Corners as x, y, q.
    Triangle([[f32; 3]; 3]),
    /// Centre x, y, q and radius.
    Disc([f32; 3], f32),
    /// Ends x, y, q, radius, and whether it is drawn over everything.
    Segment([[f32; 3]; 2], f32, bool),
}

/// Screen primitives of one chunk, with those of each tile listed in order.
pub(super) struct Bin {
    pub primitives: Vec<Primitive>,
    /// `list[starts[t]..starts[t + 1]]` are the primitives of tile `t`.
    pub starts: Vec<u32>,
    pub list: Vec<u32>,
}

/// Vertices of the scene in view coordinates, and the ranges of primitive numbers.
pub(super) struct ViewSpace {
    /// Per mesh, its vertices.
    pub meshes: Vec<Vec<[f32; 3]>>,
    /// Per cloud, its points.
    pub clouds: Vec<Vec<[f32; 3]>>,
    /// Line segments: ends, radius in samples, line number, on top.
    pub segments: Vec<([[f32; 3]; 2], f32, u32, bool)>,
    /// First primitive number of each mesh, cloud and of the segments.
    pub mesh_first: Vec<u32>,
    pub cloud_first: Vec<u32>,
    pub segment_first: u32,
    /// The cutting plane: keep view points v with dot(normal, v) <= offset.
    pub cut: Option<([f32; 3], f32)>,
}

/// The part of the scene that a primitive belongs to.
pub(super) enum Part {
    Triangle { mesh: usize, triangle: usize },
    Point { cloud: usize, point: usize },
    Segment(usize),
}

impl ViewSpace {
    pub fn new(scene: &Scene<'_>, camera: &Camera) -> Self {
        let moved = |points: &[[f32; 3]], t: &Pose| {
            let rigid = Rigid::from(&(camera.t_view_map * t));
            points.par_iter().map(|p| rigid.apply(*p)).collect::<Vec<_>>()
        };
        let meshes = scene.meshes.iter().map(|m| moved(m.mesh.vertices(), &m.t_map_mesh)).collect();
        let clouds = scene.clouds.iter().map(|c| moved(c.points, &c.t_map_cloud)).collect();
        let mut next = 0u32;
        let mut first = |n: usize| {
            let first = next;
            next = next.saturating_add(n as u32);
            first
        };
        let mesh_first = scene.meshes.iter().map(|m| first(m.mesh.triangles().len())).collect();
        let cloud_first = scene.clouds.iter().map(|c| first(c.points.len())).collect();
        let segment_first = next;
        let cut = scene.style.cut_above.map(|z| {
            let rigid = Rigid::from(&camera.t_view_map);
            let up = rigid.rotate([0.0, 0.0, 1.0]);
            (up, (z + f64::from(vec3::dot(up, rigid.translation))) as f32)
        });
        Self { meshes, clouds, segments: segments(scene, camera), mesh_first, cloud_first, segment_first, cut }
    }

    /// The part of the scene that primitive `id` belongs to.
    pub fn part(&self, id: u32) -> Part {
        if id >= self.segment_first {
            return Part::Segment((id - self.segment_first) as usize);
        }
        if let Some(&f) = self.cloud_first.first().filter(|f| id >= **f) {
            let cloud = self.cloud_first.partition_point(|&f| f <= id).max(1) - 1;
            return Part::Point { cloud, point: (id - self.cloud_first.get(cloud).copied().unwrap_or(f)) as usize };
        }
        let mesh = self.mesh_first.partition_point(|&f| f <= id).max(1) - 1;
        Part::Triangle { mesh, triangle: (id - self.mesh_first[mesh]) as usize }
    }

    fn is_cut(&self, v: [f32; 3]) -> bool {
        self.cut.is_some_and(|(n, d)| vec3::dot(n, v) > d)
    }
}

fn segments(scene: &Scene<'_>, camera: &Camera) -> Vec<([[f32; 3]; 2], f32, u32, bool)> {
    let view = |p: &[f64; 3]| {
        let v = camera.t_view_map * Point3::from(*p);
        [v.x as f32, v.y as f32, v.z as f32]
    };
    let lines = scene.polylines.iter().enumerate();
    let radius = |w: f32| 0.5 * w.clamp(0.1, 1000.0) * SUPERSAMPLING as f32;
    lines.flat_map(|(i, l)| l.points.windows(2).map(move |w| ([view(&w[0]), view(&w[1])], radius(l.width), i as u32, l.on_top))).collect()
}

/// Projects the scene and sorts it into tiles, in chunks in the order of the scene.
pub(super) fn bin(scene: &Scene<'_>, view: &ViewSpace, lens: &Lens, grid: TileGrid) -> Vec<Bin> {
    let mut tasks: Vec<(usize, usize, std::ops::Range<usize>)> = Vec::new();
    let mut add = |kind: usize, item: usize, n: usize| {
        tasks.extend((0..n).step_by(CHUNK).map(|s| (kind, item, s..n.min(s + CHUNK))));
    };
    scene.meshes.iter().enumerate().for_each(|(i, m)| add(0, i, m.mesh.triangles().len()));
    scene.clouds.iter().enumerate().for_each(|(i, c)| add(1, i, c.points.len()));
    add(2, 0, view.segments.len());
    let chunk = |(kind, item, range): &(usize, usize, std::ops::Range<usize>)| {
        let mut out = Vec::with_capacity(range.len());
        for i in range.clone() {
            match kind {
                0 => triangle(scene, view, lens, (*item, i), &mut out),
                1 => disc(scene, view, lens, (*item, i), &mut out),
                _ => segment(view, lens, i, &mut out),
            }
        }
        sort_into_tiles(out, grid)
    };
    tasks.par_iter().map(chunk).collect()
}

fn triangle(scene: &Scene<'_>, view: &ViewSpace, lens: &Lens, (mesh, i): (usize, usize), out: &mut Vec<Primitive>) {
    let v = scene.meshes[mesh].mesh.triangles()[i].map(|k| view.meshes[mesh][k as usize]);
    if !v.iter().flatten().all(|c| c.is_finite()) {
        return;
    }
    if scene.style.faces == Faces::Front && vec3::dot(vec3::cross(vec3::sub(v[1], v[0]), vec3::sub(v[2], v[0])), lens.viewer_direction(v[0])) <= 0.0 {
        return;
    }
    let id = view.mesh_first[mesh] + i as u32;
    let whole = v.iter().all(|p| lens.near.is_none_or(|n| p[2] >= n) && !view.is_cut(*p));
    if whole {
        out.push(Primitive { id, shape: Shape::Triangle(v.map(|p| lens.project(p))) });
        return;
    }
    let mut polygon = v.to_vec();
    if let Some(near) = lens.near {
        polygon = clip(&polygon, |p| p[2] - near);
    }
    if let Some((n, d)) = view.cut {
        polygon = clip(&polygon, |p| d - vec3::dot(n, p));
    }
    for k in 2..polygon.len() {
        let fan = [polygon[0], polygon[k - 1], polygon[k]];
        out.push(Primitive { id, shape: Shape::Triangle(fan.map(|p| lens.project(p))) });
    }
}

/// The part of a convex polygon where `side` is not negative (Sutherland and Hodgman).
fn clip(polygon: &[[f32; 3]], side: impl Fn([f32; 3]) -> f32) -> Vec<[f32; 3]> {
    let mut out = Vec::with_capacity(polygon.len() + 1);
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (da, db) = (side(a), side(b));
        if da >= 0.0 {
            out.push(a);
        }
        if (da >= 0.0) != (db >= 0.0) {
            let t = da / (da - db);
            out.push(std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t));
        }
    }
    out
}

fn disc(scene: &Scene<'_>, view: &ViewSpace, lens: &Lens, (cloud, i): (usize, usize), out: &mut Vec<Primitive>) {
    let v = view.clouds[cloud][i];
    if !v.iter().all(|c| c.is_finite()) || lens.near.is_some_and(|n| v[2] < n) || view.is_cut(v) {
        return;
    }
    let radius = 0.5
        * match scene.clouds[cloud].size {
            PointSize::Pixels(d) => d * SUPERSAMPLING as f32,
            PointSize::Metres(d) => d * lens.pixels_per_metre(v[2]),
        };
    let radius = if radius.is_finite() { radius.clamp(0.71, 2000.0) } else { 1.0 };
    out.push(Primitive { id: view.cloud_first[cloud] + i as u32, shape: Shape::Disc(lens.project(v), radius) });
}

fn segment(view: &ViewSpace, lens: &Lens, i: usize, out: &mut Vec<Primitive>) {
    let (mut ends, radius, _, on_top) = view.segments[i];
    if !ends.iter().flatten().all(|c| c.is_finite()) {
        return;
    }
    if let Some(near) = lens.near {
        let clipped = |a: [f32; 3], b: [f32; 3]| {
            let t = ((near - a[2]) / (b[2] - a[2])).clamp(0.0, 1.0);
            std::array::from_fn(|k| if k == 2 { near } else { a[k] + (b[k] - a[k]) * t })
        };
        match (ends[0][2] < near, ends[1][2] < near) {
            (true, true) => return,
            (true, false) => ends[0] = clipped(ends[0], ends[1]),
            (false, true) => ends[1] = clipped(ends[1], ends[0]),
            _ => {}
        }
    }
    out.push(Primitive { id: view.segment_first + i as u32, shape: Shape::Segment(ends.map(|p| lens.project(p)), radius, on_top) });
}

/// First and last tile that a primitive overlaps, in x and y; none when it is outside of the picture.
fn tiles(shape: &Shape, grid: TileGrid) -> Option<[usize; 4]> {
    let (mut lo, mut hi) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    let (points, radius): (&[[f32; 3]], f32) = match shape {
        Shape::Triangle(c) => (c, 0.0),
        Shape::Disc(c, r) => (std::slice::from_ref(c), *r),
        Shape::Segment(e, r, _) => (e, *r),
    };
    for p in points {
        for k in 0..2 {
            (lo[k], hi[k]) = (lo[k].min(p[k] - radius), hi[k].max(p[k] + radius));
        }
    }
    if !(hi[0] >= 0.0 && hi[1] >= 0.0 && lo[0] < grid.width as f32 && lo[1] < grid.height as f32) {
        return None;
    }
    let tile = |c: f32, n: usize| ((c.max(0.0) as usize) / TILE).min(n - 1);
    Some([tile(lo[0], grid.across), tile(lo[1], grid.down), tile(hi[0], grid.across), tile(hi[1], grid.down)])
}

fn sort_into_tiles(primitives: Vec<Primitive>, grid: TileGrid) -> Bin {
    let boxes: Vec<Option<[usize; 4]>> = primitives.iter().map(|p| tiles(&p.shape, grid)).collect();
    let each = |f: &mut dyn FnMut(usize, usize)| {
        for (i, b) in boxes.iter().enumerate() {
            if let Some([x0, y0, x1, y1]) = *b {
                (y0..=y1).for_each(|y| (x0..=x1).for_each(|x| f(i, y * grid.across + x)));
            }
        }
    };
    let mut starts = vec![0u32; grid.across * grid.down + 1];
    each(&mut |_, tile| starts[tile + 1] += 1);
    (1..starts.len()).for_each(|t| starts[t] += starts[t - 1]);
    let mut list = vec![0u32; starts[starts.len() - 1] as usize];
    let mut next = starts.clone();
    each(&mut |i, tile| {
        list[next[tile] as usize] = i as u32;
        next[tile] += 1;
    });
    Bin { primitives, starts, list }
}
