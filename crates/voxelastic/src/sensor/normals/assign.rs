//! Which plane a return lies on.

use super::super::image::RangeImage;
use super::super::prepare::Beams;
use super::grid::Grid;
use super::moments::{Width, WindowRule};
use super::plane::{Plane, Planes};
use rayon::prelude::*;

/// Returns that one task looks at.
const CHUNK: usize = 4096;

/// Gives every beam the plane of its pixel, or, where that is not believed or not met, the nearest fitting plane of the
/// pixels around: at an edge or a crease the windows of the neighbours on one side hold one surface only.
pub(crate) fn assign(shared: &Shared<'_>, image: &RangeImage, beams: &mut Beams) {
    let Shared { planes, grid, .. } = *shared;
    let count = beams.points.len();
    beams.normals.resize(count, [0.0; 3]);
    beams.roughness.resize(count, 0.0);
    let (points, pixels, source) = (&beams.points, &beams.pixel, &beams.source);
    let chunks = beams.normals.par_chunks_mut(CHUNK).zip(beams.roughness.par_chunks_mut(CHUNK));
    chunks.enumerate().for_each(|(chunk, (normals, roughness))| {
        let first = chunk * CHUNK;
        let mut row = Row::of(pixels[first] as usize, grid.columns);
        for (i, (normal, roughness)) in normals.iter_mut().zip(roughness).enumerate() {
            let pixel = pixels[first + i] as usize;
            if pixel >= row.end {
                row = Row::of(pixel, grid.columns);
            }
            let at = (row.index, pixel - row.start);
            let (lanes, l) = planes.lanes(at.0, at.1);
            // Most beams end here, without the detour through a `Plane` in memory.
            if image.points[pixel] == source[first + i] && lanes.roughness[l] >= 0.0 && lanes.misfit[l] <= ON_PLANE {
                *normal = [lanes.normal[0][l], lanes.normal[1][l], lanes.normal[2][l]];
                *roughness = lanes.roughness[l];
            } else {
                (*normal, *roughness) = shared.search(points[first + i], at).map_or(([0.0; 3], 0.0), |plane| (plane.normal, plane.roughness));
            }
        }
    });
}

/// A row and its pixels.
struct Row {
    index: usize,
    start: usize,
    end: usize,
}

impl Row {
    fn of(pixel: usize, columns: usize) -> Self {
        let index = pixel / columns;
        Self { index, start: index * columns, end: (index + 1) * columns }
    }
}

impl Plane {
    /// Distance of `p` (above the beams' origin) from the plane, in units of what noise along the ray and the plane's
    /// roughness explain.
    #[inline(always)]
    fn misfit_of(&self, p: [f32; 3], noise: f32) -> f32 {
        let off = (dot(self.normal, p) + self.distance).abs();
        // distance / |p| is the cosine of the incidence.
        let along_normal = noise * self.distance / dot(p, p).sqrt();
        off / along_normal.max(self.roughness).max(1e-4)
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Points within this many standard deviations are on the plane.
const ON_PLANE: f32 = 3.0;
/// A plane of a neighbour must fit better: it was not made from this point.
const ON_NEIGHBOUR: f32 = 2.0;

/// What every search looks at.
pub(crate) struct Shared<'a> {
    pub(crate) planes: &'a Planes,
    pub(crate) grid: &'a Grid,
    pub(crate) rule: &'a WindowRule,
    /// Range noise, or the roughness that is allowed where that is more, metres.
    pub(crate) noise: f32,
}

impl Shared<'_> {
    /// The plane of the pixel if the point is on it, else the best among the pixels around.
    #[inline(never)]
    fn search(&self, point: [f32; 3], (row, column): (usize, usize)) -> Option<Plane> {
        let p = [point[0], point[1], point[2] - self.grid.height];
        let own = self.planes.get(row, column).filter(|plane| plane.misfit_of(p, self.noise) <= ON_PLANE);
        own.or_else(|| self.around(p, (row as isize, column as isize)))
    }

    /// The best plane among the pixels half a window away, else a window away.
    fn around(&self, p: [f32; 3], (row, column): (isize, isize)) -> Option<Plane> {
        let depth = (p[0] * p[0] + p[1] * p[1]).sqrt();
        let reach = self.rule.reach(row as usize, Width::Narrow).map(|r| (r.at(1.0 / depth.max(1e-3)) + 0.5) as isize);
        [1, 2].iter().find_map(|far| self.best(p, depth, (row, column), reach.map(|r| r * far)))
    }

    /// The best plane among the eight pixels `reach` away (along the row, down the column).
    fn best(&self, p: [f32; 3], depth: f32, (row, column): (isize, isize), reach: [isize; 2]) -> Option<Plane> {
        let mut best: Option<(f32, Plane)> = None;
        for (down, along) in [(0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)] {
            let (r, c) = (row + down * reach[1], column + along * reach[0]);
            if r < 0 || r >= self.grid.rows as isize {
                continue;
            }
            let (r, c) = (r as usize, c.rem_euclid(self.grid.columns as isize) as usize);
            let Some(plane) = self.planes.get(r, c) else { continue };
            let misfit = plane.misfit_of(p, self.noise);
            if misfit <= ON_NEIGHBOUR && best.is_none_or(|(least, _)| misfit < least) && self.is_near(depth, (r, c)) {
                best = Some((misfit, plane));
            }
        }
        best.map(|(_, plane)| plane)
    }

    /// Whether a pixel's depth is like `depth`: far beyond a gap a plane may pass by chance.
    fn is_near(&self, depth: f32, (row, column): (usize, usize)) -> bool {
        (depth * self.grid.inverse[self.grid.at(row, column)] - 1.0).abs() < 0.25
    }
}
