//! A wall with a thing in front of it, of known colours.

#![allow(clippy::print_stdout)]

use super::*;
use crate::{Distortion, TextureLayout};
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// A wall at 6 m in front of the origin (x ahead, z up) with vertices 0.05 m apart, and a plate of 1 x 1 m at 3 m; the plate's vertices come last.
struct Scene {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Vertices of the wall.
    wall: usize,
}

impl Scene {
    fn new() -> Self {
        let mut scene = Self { positions: Vec::new(), triangles: Vec::new(), wall: 0 };
        scene.plate(6.0, 3.0);
        scene.wall = scene.positions.len();
        scene.plate(3.0, 0.5);
        scene
    }

    fn plate(&mut self, x: f32, half: f32) {
        let count = (half / 0.025) as u32 + 1;
        let first = self.positions.len() as u32;
        for i in 0..count * count {
            self.positions.push([x, half - 0.05 * (i % count) as f32, half - 0.05 * (i / count) as f32]);
        }
        for (row, column) in (0..count - 1).flat_map(|row| (0..count - 1).map(move |column| (row, column))) {
            let a = first + row * count + column;
            self.triangles.extend([[a, a + count, a + 1], [a + 1, a + count, a + count + 1]]);
        }
    }

    fn normals(&self) -> Vec<[f32; 3]> {
        vec![[-1.0, 0.0, 0.0]; self.positions.len()]
    }
}

fn camera() -> CameraModel {
    CameraModel::new([320, 240], [200.0; 2], [160.0, 120.0], Distortion::PlumbBob([-0.1, 0.02, 1e-3, -1e-3, 0.0, 0.0, 0.0, 0.0])).unwrap()
}

/// A camera at `place` that looks along x.
fn looking(place: [f64; 3]) -> Pose {
    let axes = nalgebra::Matrix3::from_columns(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
    Pose::from_parts(place.into(), UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(axes)))
}

const BLUE: [f64; 3] = [0.1, 0.2, 0.6];

/// Linear light of the wall: smooth, between 0.1 and 0.5.
fn wall_light(y: f64, z: f64) -> [f64; 3] {
    [0.3 + 0.2 * (1.1 * y).sin(), 0.3 + 0.2 * (0.9 * z).cos(), 0.3 + 0.2 * (y + z).sin()]
}

/// What the camera sees: the plate is blue.
fn picture(camera: &CameraModel, pose: &Pose, exposure: [f64; 3]) -> Picture {
    let light = |pixel: [f64; 2]| {
        let ray = pose.rotation * Vector3::from(camera.unproject(pixel).unwrap());
        let at = |x: f64| Point3::from(pose.translation.vector) + ray * ((x - pose.translation.x) / ray.x);
        let plate = at(3.0);
        if plate.y.abs() < 0.5 && plate.z.abs() < 0.5 { BLUE } else { wall_light(at(6.0).y, at(6.0).z) }
    };
    let srgb = |pixel| {
        let shown = light(pixel);
        std::array::from_fn(|k| to_srgb((shown[k] * exposure[k]) as f32))
    };
    let pixels = (0..240).flat_map(|v| (0..320).map(move |u| (u, v))).map(|(u, v)| srgb([f64::from(u), f64::from(v)])).collect();
    Picture { width: 320, height: 240, pixels }
}

const PLACES: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [0.0, 1.5, 0.3], [0.5, -1.5, -0.4], [0.0, 0.4, 1.2]];
const EXPOSURES: [[f64; 3]; 4] = [[1.3, 1.2, 1.2], [0.7, 0.75, 0.7], [1.0, 1.0, 1.1], [0.9, 1.1, 1.0]];

/// Largest and mean difference to the truth, sRGB, of known vertices of the wall; and the numbers of those known.
fn paint(scene: &Scene, options: PaintOptions) -> (Painted, f64, f64) {
    let normals = scene.normals();
    let surface = Surface { positions: &scene.positions, normals: &normals, triangles: &scene.triangles };
    let mut painter = Painter::new(surface, options);
    for (place, exposure) in PLACES.iter().zip(EXPOSURES) {
        let (camera, pose) = (camera(), looking(*place));
        assert!(painter.add(&camera, &pose, &picture(&camera, &pose, exposure)).unwrap() > 1000);
    }
    let painted = painter.finish();
    let (mut most, mut sum, mut count) = (0.0f64, 0.0, 0.0);
    for (v, p) in scene.positions[..scene.wall].iter().enumerate().filter(|(v, _)| painted.known[*v]) {
        let truth = wall_light(p[1].into(), p[2].into()).map(|c| to_srgb(c as f32));
        let off = (0..3).map(|k| f64::from(truth[k].abs_diff(painted.colours[v][k]))).fold(0.0, f64::max);
        (most, sum, count) = (most.max(off), sum + off, count + 1.0);
    }
    (painted, most, sum / count)
}

fn fine() -> PaintOptions {
    PaintOptions { accuracy: 0.03, ..PaintOptions::default() }
}

#[test]
fn colours_are_those_of_the_surface_whatever_hides_it_and_however_it_was_exposed() {
    let scene = Scene::new();
    let (painted, most, mean) = paint(&scene, fine());
    println!("evened out, with occlusion: mean {mean:.2}, most {most:.1} of 255; exposures {:?}", painted.exposures);
    assert!(mean < 4.0 && most < 12.0, "{mean} {most}");
    // Against their mean, as the truth is known up to a common factor.
    for k in 0..3 {
        let mean = EXPOSURES.iter().map(|e| e[k].ln()).sum::<f64>() / 4.0;
        for (found, exposure) in painted.exposures.iter().zip(EXPOSURES) {
            assert!((f64::from(found[k]).ln() - (exposure[k].ln() - mean)).abs() < 0.03, "{found:?} {exposure:?}");
        }
    }
    let blue = scene.positions[scene.wall..].iter().zip(&painted.colours[scene.wall..]).filter(|(p, _)| p[1].abs() < 0.4 && p[2].abs() < 0.4);
    for (p, colour) in blue {
        let truth = BLUE.map(|c| to_srgb(c as f32));
        assert!((0..3).all(|k| colour[k].abs_diff(truth[k]) < 12), "{p:?}: {colour:?}");
    }
    let (_, unevened, mean_unevened) = paint(&scene, PaintOptions { even_exposure: false, ..fine() });
    let (_, through, mean_through) = paint(&scene, PaintOptions { occlusion: false, ..fine() });
    println!("exposures left: mean {mean_unevened:.2}, most {unevened:.1}; without occlusion: mean {mean_through:.2}, most {through:.1}");
    assert!(mean_unevened > 2.0 * mean && through > 40.0);
}

#[test]
fn what_is_hidden_is_not_seen() {
    let scene = Scene::new();
    let normals = scene.normals();
    let surface = Surface { positions: &scene.positions, normals: &normals, triangles: &scene.triangles };
    let mut painter = Painter::new(surface, fine());
    let (camera, pose) = (camera(), looking(PLACES[0]));
    let visible = painter.add(&camera, &pose, &picture(&camera, &pose, [1.0; 3])).unwrap();
    // A slow reference: a vertex of the wall is hidden if the ray to it passes through the plate, or closer than its thickness.
    for (v, p) in scene.positions[..scene.wall].iter().enumerate() {
        let is_seen = !painter.vertices[v].all().is_empty();
        let on_plate = [0.5 * p[1], 0.5 * p[2]].map(f32::abs);
        let (hidden, clear) = (on_plate.iter().all(|c| *c < 0.499), on_plate.iter().any(|c| *c > 0.56));
        let inside = camera.project((pose.inverse() * Point3::from(p.map(f64::from))).coords.into()).is_some_and(|pixel| camera.contains(pixel));
        assert!(!(is_seen && hidden) && (is_seen || !(clear && inside)), "{p:?} {is_seen}");
    }
    assert!(visible > 1000);
    let painted = painter.finish();
    assert_eq!((painted.visible, painted.exposures.len()), (visible, 1));
    assert!(painted.filled > 0 && painted.known.iter().any(|known| !known), "a margin around the plate is filled in, its shadow is not");
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let scene = Scene::new();
    let on = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| paint(&scene, fine()).0);
    assert_eq!(on(1), on(5));
}

#[test]
fn a_texture_is_sharper_than_the_vertices() {
    // A wall of triangles that are two metres wide.
    let positions: Vec<[f32; 3]> = (0..16).map(|k| [6.0, 3.0 - 2.0 * (k % 4) as f32, 3.0 - 2.0 * (k / 4) as f32]).collect();
    let cells = (0..12u32).filter(|k| k % 4 < 3);
    let triangles: Vec<[u32; 3]> = cells.flat_map(|k| [[k, k + 4, k + 1], [k + 1, k + 4, k + 5]]).collect();
    let normals = vec![[-1.0, 0.0, 0.0]; 16];
    let surface = Surface { positions: &positions, normals: &normals, triangles: &triangles };
    let layout = TextureLayout::new(&surface, 0.2).unwrap();
    let texels: Vec<_> = (0..triangles.len()).flat_map(|t| layout.of(t).map(move |texel| (t, texel))).collect();
    let at = |(t, texel): &(usize, crate::Texel)| -> [f32; 3] {
        std::array::from_fn(|axis| (0..3).map(|c| texel.shares[c] * positions[triangles[*t][c] as usize][axis]).sum())
    };
    let (places, facing): (Vec<[f32; 3]>, Vec<[f32; 3]>) = (texels.iter().map(at).collect(), vec![[-1.0, 0.0, 0.0]; texels.len()]);
    let places = Places { positions: &places, normals: &facing, spacing: 0.2 };
    let add = |painter: &mut Painter<'_>| {
        for (place, exposure) in PLACES.iter().zip(EXPOSURES) {
            let (camera, pose) = (camera(), looking(*place));
            // Beside the plate, which is not part of this surface.
            painter.add(&camera, &pose, &picture(&camera, &pose, exposure)).unwrap();
        }
    };
    let mut dense = Painter::new(Surface { positions: places.positions, normals: places.normals, triangles: &[] }, fine());
    add(&mut dense);
    let exposures = dense.finish().exposures;
    let mut painter = Painter::of_places(surface, places, fine());
    add(&mut painter);
    let found = painter.finish_with(&exposures);
    let off = |p: [f32; 3], colour: [f32; 3]| {
        let truth = wall_light(p[1].into(), p[2].into()).map(|c| f64::from(to_srgb(c as f32)));
        (0..3).map(|k| (truth[k] - f64::from(colour[k])).abs()).fold(0.0, f64::max)
    };
    let (mut texture, mut vertices, mut count) = (0.0, 0.0, 0.0);
    for (k, colour) in found.iter().enumerate() {
        // What the plate hides in any of the images is beside the point.
        let p = places.positions[k];
        let Some(colour) = colour.filter(|_| p[1].abs() > 2.2 || p[2].abs() > 2.2) else { continue };
        let (t, texel) = texels[k];
        let of_vertices: [f32; 3] = std::array::from_fn(|channel| {
            let light = |c: usize| positions[triangles[t][c] as usize];
            (0..3).map(|c| texel.shares[c] * f32::from(to_srgb(wall_light(light(c)[1].into(), light(c)[2].into())[channel] as f32))).sum()
        });
        texture += off(p, colour.map(f32::from));
        vertices += off(p, of_vertices);
        count += 1.0;
    }
    println!(
        "{count} of {} texels: the texture is off by {:.2} of 255, exact colours of vertices by {:.2} (means)",
        found.len(),
        texture / count,
        vertices / count
    );
    assert!(count > 500.0 && texture / count < 4.0 && vertices > 3.0 * texture);
}

#[test]
fn an_image_of_another_size_is_refused() {
    let scene = Scene::new();
    let normals = scene.normals();
    let mut painter = Painter::new(Surface { positions: &scene.positions, normals: &normals, triangles: &scene.triangles }, fine());
    let small = Picture { width: 160, height: 120, pixels: vec![[0; 3]; 160 * 120] };
    let error = painter.add(&camera(), &Pose::identity(), &small).unwrap_err().to_string();
    assert_eq!(error, "the image has 160 x 120 pixels, but the intrinsics are for 320 x 240");
    assert!(painter.finish().exposures.is_empty());
}

#[test]
fn cameras_out_of_reach_are_skipped_without_a_trace() {
    let scene = Scene::new();
    let normals = scene.normals();
    let surface = Surface { positions: &scene.positions, normals: &normals, triangles: &scene.triangles };
    let places = Places { positions: &scene.positions[scene.wall..], normals: &normals[scene.wall..], spacing: 0.05 };
    let (near, far) = ([0.0; 3], [-30.0, 0.0, 0.0]);
    let options = PaintOptions { reach: 10.0, ..fine() };
    let exposures = [[2.0; 3], [0.5; 3], [1.0; 3]];
    let of = |skips: bool| {
        let mut painter = Painter::of_places(surface, places, options);
        for place in [far, near, far] {
            let (camera, pose) = (camera(), looking(place));
            assert_eq!(painter.sees_none(&pose), place == far);
            if skips && place == far {
                painter.skip();
            } else {
                let seen = painter.add(&camera, &pose, &picture(&camera, &pose, [1.0; 3])).unwrap();
                assert_eq!(seen == 0, place == far);
            }
        }
        painter.finish_with(&exposures)
    };
    let all = of(false);
    assert!(all == of(true) && all.iter().flatten().count() > 100);
}
