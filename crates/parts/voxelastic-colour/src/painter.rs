//! Takes images one after the other and colours the vertices of a mesh.

use crate::blend::blend;
use crate::camera::CameraModel;
use crate::depth_image::{Corner, DepthImage};
use crate::exposure::exposures;
use crate::light::to_srgb;
use crate::observations::{Observation, Observations};
use crate::picture::{Picture, Pyramid};
use crate::spread::spread;
use crate::{ColourError, Result};
use rayon::prelude::*;
use voxelastic::Pose;
use voxelastic::geometry::Rigid;

/// A triangle mesh in the map frame, metres.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Vertices.
    pub positions: &'a [[f32; 3]],
    /// Unit normals of the vertices, towards the side that is seen.
    pub normals: &'a [[f32; 3]],
    /// Vertices of each triangle.
    pub triangles: &'a [[u32; 3]],
}

/// Places on a mesh that get colours.
#[derive(Clone, Copy, Debug)]
pub struct Places<'a> {
    /// Where they are, map frame, metres.
    pub positions: &'a [[f32; 3]],
    /// Unit normals of the surface there, towards the side that is seen.
    pub normals: &'a [[f32; 3]],
    /// Typical distance between neighbours, metres: each has the mean colour of a patch so wide.
    pub spacing: f32,
}

/// How a mesh is coloured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaintOptions {
    /// Images colour what is no farther away than this, metres.
    pub reach: f32,
    /// How far the surface may be off, metres: of a map, an edge of a voxel. What a thing in front may hide within this margin is not coloured.
    pub accuracy: f32,
    /// Whether exposures of images are evened out.
    pub even_exposure: bool,
    /// Whether surfaces hide what is behind them. Without it, images also colour what they cannot see: to measure what it is worth.
    pub occlusion: bool,
}

impl Default for PaintOptions {
    fn default() -> Self {
        Self { reach: 40.0, accuracy: 0.1, even_exposure: true, occlusion: true }
    }
}

/// The colours of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Painted {
    /// A colour for each vertex, sRGB; mid grey where [`known`](Self::known) is not set.
    pub colours: Vec<[u8; 3]>,
    /// Whether a vertex, or another a few edges away, is seen in an image.
    pub known: Vec<bool>,
    /// Vertices that are seen in an image.
    pub visible: usize,
    /// Vertices whose colour is that of neighbours.
    pub filled: usize,
    /// Exposure of each image that was added, red green blue: what its light was divided by. Their geometric mean is one.
    pub exposures: Vec<[f32; 3]>,
}

/// Surfaces that are seen at a flatter angle than this are left out: cosine to the normal.
const FLATTEST: f32 = 0.17;
/// Images count less within this share of their width and height from the border, where lenses are worst.
const BORDER: f64 = 0.06;
/// Nearer than this, images do not count more, metres.
const NEAR: f32 = 1.0;
/// Vertices per task, and per test whether an image can see any of them.
const CHUNK: usize = 4096;

/// Colours the vertices of a mesh, image by image.
pub struct Painter<'a> {
    surface: Surface<'a>,
    places: Places<'a>,
    options: PaintOptions,
    /// Centre and radius of each [`CHUNK`] of vertices, and of places.
    spheres: [Vec<([f32; 3], f32)>; 2],
    /// Typical distance between neighbouring vertices, metres.
    spacing: f32,
    vertices: Vec<Observations>,
    images: u32,
}

impl<'a> Painter<'a> {
    /// Colours `surface`, which has a normal for each vertex.
    ///
    /// # Panics
    /// If it has not, or triangles name vertices that do not exist.
    pub fn new(surface: Surface<'a>, options: PaintOptions) -> Self {
        Self::of_places(surface, Places { positions: surface.positions, normals: surface.normals, spacing: spacing(&surface) }, options)
    }

    /// Colours `places` on `surface`, each of them with a normal.
    ///
    /// # Panics
    /// If one has none, or triangles name vertices that do not exist.
    pub fn of_places(surface: Surface<'a>, places: Places<'a>, options: PaintOptions) -> Self {
        assert_eq!(places.positions.len(), places.normals.len(), "normals");
        let count = surface.positions.len();
        assert!(surface.triangles.par_iter().flatten().all(|v| (*v as usize) < count), "a triangle names a missing vertex");
        let spheres = [surface.positions, places.positions].map(|all| all.par_chunks(CHUNK).map(sphere).collect());
        let vertices = vec![Observations::default(); places.positions.len()];
        Self { surface, places, options, spheres, spacing: spacing(&surface), vertices, images: 0 }
    }

    /// Adds an image that `camera` took at `t_map_camera`; returns the number of vertices, or places, that are seen in it.
    ///
    /// # Errors
    /// [`ColourError::Size`] if the image has another size than those of the camera.
    pub fn add(&mut self, camera: &CameraModel, t_map_camera: &Pose, picture: &Picture) -> Result<usize> {
        let (width, height) = (camera.width(), camera.height());
        if [picture.width, picture.height] != [width, height] || picture.pixels.len() != width * height {
            return Err(ColourError::Size { found_width: picture.width, found_height: picture.height, width, height });
        }
        let t_camera_map = Rigid::from(&t_map_camera.inverse());
        let mut view = View { camera, t_camera_map, depth: None, options: self.options, spacing: self.places.spacing, margin: self.margin() };
        view.depth = self.options.occlusion.then(|| self.depth_image(&view));
        let pyramid = Pyramid::new(picture);
        let (image, places, spheres) = (self.images, self.places, &self.spheres[1]);
        let visible = self
            .vertices
            .par_chunks_mut(CHUNK)
            .enumerate()
            .filter(|(chunk, _)| view.may_see(spheres[*chunk]))
            .map(|(chunk, vertices)| {
                let mut visible = 0;
                for (k, vertex) in vertices.iter_mut().enumerate() {
                    let v = chunk * CHUNK + k;
                    if let Some(Visible { pixel, weight, patch }) = view.visible(places.positions[v], places.normals[v]) {
                        vertex.add(Observation::new(image, weight, pyramid.at(pixel, patch)));
                        visible += 1;
                    }
                }
                visible
            })
            .sum();
        self.images += 1;
        Ok(visible)
    }

    /// Counts an image that shows none of the places, as [`sees_none`](Self::sees_none) says, so that those that follow keep their numbers.
    pub fn skip(&mut self) {
        self.images += 1;
    }

    /// Whether no camera at `t_map_camera`, of any model, can colour any of the places: all are beyond its reach.
    pub fn sees_none(&self, t_map_camera: &Pose) -> bool {
        let t_camera_map = Rigid::from(&t_map_camera.inverse());
        self.spheres[1].iter().all(|(centre, radius)| length(t_camera_map.apply(*centre)) - radius > self.options.reach)
    }

    /// The colours.
    pub fn finish(self) -> Painted {
        let images = self.images as usize;
        let exposures = if self.options.even_exposure { exposures(&self.vertices, images) } else { vec![[1.0; 3]; images] };
        let mut colours: Vec<Option<[f32; 3]>> = self.vertices.par_iter().map(|vertex| blend(vertex, &exposures)).collect();
        let visible = colours.iter().flatten().count();
        let filled = spread(&mut colours, self.surface.triangles);
        Painted {
            known: colours.iter().map(Option::is_some).collect(),
            colours: colours.par_iter().map(|colour| colour.map_or([128; 3], |light| light.map(to_srgb))).collect(),
            visible,
            filled,
            exposures,
        }
    }

    /// The colours of the places, sRGB, with exposures that are known from the same images in the same order; none for those that no image shows.
    pub fn finish_with(self, exposures: &[[f32; 3]]) -> Vec<Option<[u8; 3]>> {
        self.vertices.par_iter().map(|place| Some(blend(place, exposures)?.map(to_srgb))).collect()
    }

    /// How far the camera sees at each pixel.
    fn depth_image(&self, view: &View<'_>) -> DepthImage {
        let Surface { positions, triangles, .. } = self.surface;
        let camera = view.camera;
        let nothing = [f32::NAN; 3];
        // Most vertices belong to six triangles: each is projected once.
        let project = |p: &[f32; 3]| {
            let p = view.t_camera_map.apply(*p);
            camera.project(p.map(f64::from)).map_or(nothing, |[u, v]| [u as f32, v as f32, length(p)])
        };
        let corners: Vec<Corner> = positions
            .par_chunks(CHUNK)
            .zip(&self.spheres[0])
            .flat_map_iter(|(vertices, sphere)| {
                let is_near = view.may_see(*sphere);
                vertices.iter().map(move |p| if is_near { project(p) } else { nothing })
            })
            .collect();
        let (width, height) = (camera.width() as f32, camera.height() as f32);
        let is_inside = |t: &[Corner; 3]| {
            let beyond = |k: usize, size: f32| t.iter().all(|c| c[k] < -0.5) || t.iter().all(|c| c[k] > size - 0.5);
            t.iter().all(|c| c[0].is_finite()) && !beyond(0, width) && !beyond(1, height)
        };
        let drawn: Vec<[Corner; 3]> = triangles.par_iter().map(|t| t.map(|v| corners[v as usize])).filter(is_inside).collect();
        // A margin beyond the border is of no use: images count little there.
        let squares: Vec<Corner> = corners.into_par_iter().filter(|c| (-0.5..width).contains(&c[0]) && (-0.5..height).contains(&c[1])).collect();
        DepthImage::draw(camera, &drawn, &squares, self.margin())
    }

    /// How far beyond its outline a thing may hide what is behind it, metres: patches around vertices are as wide as vertices are apart.
    fn margin(&self) -> f32 {
        self.options.accuracy.max(0.5 * self.spacing)
    }
}

impl std::fmt::Debug for Painter<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Painter").field("vertices", &self.vertices.len()).field("images", &self.images).finish_non_exhaustive()
    }
}

/// An image that is being added.
struct View<'a> {
    camera: &'a CameraModel,
    t_camera_map: Rigid,
    depth: Option<DepthImage>,
    options: PaintOptions,
    spacing: f32,
    margin: f32,
}

/// How a vertex is seen.
struct Visible {
    pixel: [f64; 2],
    weight: f32,
    /// Pixels from a vertex to the next.
    patch: f64,
}

impl View<'_> {
    /// Whether a sphere is partly within reach.
    fn may_see(&self, (centre, radius): ([f32; 3], f32)) -> bool {
        length(self.t_camera_map.apply(centre)) - radius <= self.options.reach
    }

    /// How a vertex is seen; `None` if it is not.
    fn visible(&self, position: [f32; 3], normal: [f32; 3]) -> Option<Visible> {
        let p = self.t_camera_map.apply(position);
        let range = length(p);
        let n = self.t_camera_map.rotate(normal);
        let cosine = -(0..3).map(|k| p[k] * n[k]).sum::<f32>() / range;
        if !(range <= self.options.reach && cosine >= FLATTEST) {
            return None;
        }
        let pixel = self.camera.project(p.map(f64::from)).filter(|pixel| self.camera.contains(*pixel))?;
        let focal = self.camera.focal()[0] as f32;
        if let Some(depth) = &self.depth {
            // At a slant, the squares of neighbours on the same surface are nearer: by up to the diagonal of a margin and a pixel along the surface.
            let allowed = 2.0 * (self.margin + range / focal) / cosine;
            if depth.at(pixel) < range - allowed {
                return None;
            }
        }
        let size = [self.camera.width() as f64, self.camera.height() as f64];
        let inside = (0..2).map(|k| (pixel[k] + 0.5).min(size[k] - 0.5 - pixel[k]) / (BORDER * size[k])).fold(1.0, f64::min);
        let weight = cosine * inside.max(1e-3) as f32 / range.max(NEAR).powi(2);
        Some(Visible { pixel, weight, patch: f64::from(self.spacing * focal / range) })
    }
}

fn length(p: [f32; 3]) -> f32 {
    p.iter().map(|c| c * c).sum::<f32>().sqrt()
}

/// A sphere around vertices: the one around their box.
fn sphere(vertices: &[[f32; 3]]) -> ([f32; 3], f32) {
    let extreme = |pick: fn(f32, f32) -> f32| vertices[1..].iter().fold(vertices[0], |m, p| std::array::from_fn(|k| pick(m[k], p[k])));
    let (low, high) = (extreme(f32::min), extreme(f32::max));
    (std::array::from_fn(|k| 0.5 * (low[k] + high[k])), 0.5 * length(std::array::from_fn(|k| high[k] - low[k])))
}

/// The median length of edges, of some of the triangles.
fn spacing(surface: &Surface<'_>) -> f32 {
    const SAMPLE: usize = 20_000;
    let step = surface.triangles.len() / SAMPLE + 1;
    let edge = |t: &[u32; 3]| {
        let (a, b) = (surface.positions[t[0] as usize], surface.positions[t[1] as usize]);
        length(std::array::from_fn(|k| a[k] - b[k]))
    };
    let mut lengths: Vec<f32> = surface.triangles.iter().step_by(step).map(edge).filter(|l| l.is_finite()).collect();
    lengths.sort_unstable_by(f32::total_cmp);
    lengths.get(lengths.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
