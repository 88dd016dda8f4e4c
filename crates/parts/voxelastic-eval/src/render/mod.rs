//! A software renderer for meshes and clouds: no GPU, no window, the same pixels on every machine and for any number of threads.
//!
//! Primitives are transformed to view coordinates, clipped, sorted into tiles and rasterised with a depth buffer of 2 x 2 samples per pixel. Each
//! pixel shades each visible primitive once. Ambient occlusion makes corners and edges readable.
//!
//! ```
//! use voxelastic_eval::{MeshView, colour::Ramp, render::*};
//! let vertices = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 3.0, 1.0], [0.0, 3.0, 1.0]];
//! let mesh = MeshView::new(&vertices, &[[0, 1, 2], [0, 2, 3]])?;
//! let mut scene = Scene::default();
//! scene.meshes.push(MeshItem {
//!     mesh,
//!     t_map_mesh: voxelastic::Pose::identity(),
//!     colouring: Colouring::Height { ramp: Ramp::Land, low: 0.0, high: 1.0 },
//! });
//! let picture = render(&scene, &Camera::top(&scene.bounds()), Size { width: 64, height: 48 })?;
//! assert_eq!(picture.pixels.len(), 64 * 48);
//! # Ok::<(), voxelastic_eval::EvalError>(())
//! ```

mod camera;
mod geometry;
mod occlusion;
mod overlay;
mod raster;
mod scene;
mod shade;
#[cfg(test)]
mod tests;
mod tiles;

pub use crate::picture::{Picture, Size};
pub use camera::{Camera, Projection};
pub use scene::{CloudItem, Colouring, Faces, Legend, MeshItem, PointSize, Polyline, Scene, Style};

use crate::colour::{from_linear, to_linear};
use crate::{EvalError, error::Result};
use geometry::{Bin, ViewSpace};
use occlusion::Surface;
use raster::{NOTHING, Samples};
use rayon::prelude::*;
use shade::{Shaded, Shader};
use std::path::Path;
use tiles::{SUPERSAMPLING, TILE, TILE_PX, TileGrid};

/// Renders a scene into a PNG file.
///
/// # Errors
/// Those of [`render`], and [`EvalError::Write`].
pub fn render_png(path: &Path, scene: &Scene<'_>, camera: &Camera, size: Size) -> Result<()> {
    render(scene, camera, size)?.write_png(path)
}

/// Renders a scene. Primitives with coordinates that are not finite are left out.
///
/// # Errors
/// [`EvalError::Picture`] for sizes outside 1 to 16384; [`EvalError::Length`] when a colouring does not fit its mesh or cloud;
/// [`EvalError::Setting`] beyond 2^32 - 2 primitives.
pub fn render(scene: &Scene<'_>, camera: &Camera, size: Size) -> Result<Picture> {
    check(scene, size)?;
    let (width, height) = (size.width as usize, size.height as usize);
    let grid = TileGrid::new(width * SUPERSAMPLING, height * SUPERSAMPLING);
    let lens = camera.lens(grid.width as u32, grid.height as u32);
    let view = ViewSpace::new(scene, camera);
    let bins = geometry::bin(scene, &view, &lens, grid);
    let shader = Shader::new(scene, &view, camera, lens);
    let tiles: Vec<Vec<Pixel>> =
        (0..grid.across * grid.down).into_par_iter().map_init(Samples::new, |samples, t| draw_tile(samples, &shader, &bins, t, grid)).collect();

    let pixel = |x: usize, y: usize| &tiles[y / TILE_PX * grid.across + x / TILE_PX][y % TILE_PX * TILE_PX + x % TILE_PX];
    let surfaces: Vec<Surface> = (0..width * height).into_par_iter().map(|i| pixel(i % width, i / width).surface).collect();
    let bright = occlusion::occlusion(&surfaces, width, &camera.lens(size.width, size.height), scene.style.occlusion);
    let background = scene.style.background.map(to_linear);
    let finish = |i: usize| {
        let p = pixel(i % width, i / width);
        std::array::from_fn(|k| from_linear(p.solid[k] * bright[i] + p.line[k] + (1.0 - p.cover) * background[k]))
    };
    let mut picture = Picture { size, pixels: (0..width * height).into_par_iter().map(finish).collect() };
    overlay::draw(&mut picture, scene, camera);
    Ok(picture)
}

/// A pixel before occlusion: light of surfaces and of lines, each weighted by its share of the samples.
#[derive(Clone, Copy)]
struct Pixel {
    solid: [f32; 3],
    line: [f32; 3],
    cover: f32,
    surface: Surface,
}

impl Pixel {
    const EMPTY: Self = Self { solid: [0.0; 3], line: [0.0; 3], cover: 0.0, surface: Surface::NONE };
}

fn draw_tile(samples: &mut Samples, shader: &Shader<'_>, bins: &[Bin], tile: usize, grid: TileGrid) -> Vec<Pixel> {
    if bins.iter().all(|b| b.starts[tile] == b.starts[tile + 1]) {
        return vec![Pixel::EMPTY; TILE_PX * TILE_PX];
    }
    let (x0, y0) = (tile % grid.across * TILE, tile / grid.across * TILE);
    samples.draw(bins, tile, x0, y0);
    (0..TILE_PX * TILE_PX).map(|i| resolve(samples, shader, (x0, y0), (i % TILE_PX, i / TILE_PX))).collect()
}

/// Mean of a pixel's samples.
fn resolve(samples: &Samples, shader: &Shader<'_>, (x0, y0): (usize, usize), (px, py): (usize, usize)) -> Pixel {
    const SHARE: f32 = 1.0 / (SUPERSAMPLING * SUPERSAMPLING) as f32;
    let mut out = Pixel::EMPTY;
    let mut last: Option<(u32, Shaded)> = None;
    for s in 0..SUPERSAMPLING * SUPERSAMPLING {
        let (x, y) = (px * SUPERSAMPLING + s % SUPERSAMPLING, py * SUPERSAMPLING + s / SUPERSAMPLING);
        let (id, q) = (samples.id[y * TILE + x], samples.q[y * TILE + x]);
        if id == NOTHING {
            continue;
        }
        let shaded = match last {
            Some((of, shaded)) if of == id => shaded,
            _ => shader.shade(id, (x0 + x) as f32 + 0.5, (y0 + y) as f32 + 0.5, q),
        };
        last = Some((id, shaded));
        out.cover += SHARE;
        let sum = if shaded.solid { &mut out.solid } else { &mut out.line };
        (0..3).for_each(|k| sum[k] += SHARE * shaded.colour[k]);
        if shaded.solid && q > out.surface.q {
            out.surface = Surface { q, normal: shaded.normal };
        }
    }
    out
}

fn check(scene: &Scene<'_>, size: Size) -> Result<()> {
    if !(1..=16384).contains(&size.width) || !(1..=16384).contains(&size.height) {
        return Err(EvalError::Picture { width: size.width, height: size.height, reason: "each side must be 1 to 16384 pixels".into() });
    }
    let meshes = scene.meshes.iter().map(|m| (&m.colouring, m.mesh.vertices().len(), m.mesh.triangles().len()));
    let clouds = scene.clouds.iter().map(|c| (&c.colouring, c.points.len(), c.points.len()));
    let mut primitives = scene.polylines.iter().map(|l| l.points.len()).sum::<usize>();
    for (colouring, expected, count) in meshes.chain(clouds) {
        primitives += count;
        let got = match colouring {
            Colouring::Scalar { values, .. } => values.len(),
            Colouring::Vertex(colours) => colours.len(),
            Colouring::Flat(_) | Colouring::Height { .. } => expected,
        };
        if got != expected {
            return Err(EvalError::Length { what: "colouring", got, expected });
        }
    }
    if primitives >= NOTHING as usize {
        return Err(EvalError::Setting { setting: "number of primitives", value: primitives as f64, must: "below 2^32 - 1" });
    }
    Ok(())
}
