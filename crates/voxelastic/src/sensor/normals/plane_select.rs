//! Selection of the plane that each return lies on.

use super::covariance::{Width, WindowRule};
use super::grid::Grid;
use super::plane::{Plane, Planes};
use crate::sensor::patch_weights::PatchWeights;
use crate::sensor::pixel_row::PixelRow;
use crate::sensor::range_image::RangeImage;
use crate::sensor::returns::Returns;
use crate::simd::larger;
use rayon::prelude::*;

/// Returns of one task.
const CHUNK: usize = 4096;

/// Gives every return the plane of its pixel, or, where that is rejected or does not contain the return, the best fitting plane of the pixels around: at an edge
/// or a crease the windows of the neighbours on one side contain one surface only. Returns of weight 0 get none.
pub(super) fn select_planes(search: &PlaneSearch<'_>, image: &RangeImage, weights: Option<&PatchWeights>, returns: &mut Returns) {
    let PlaneSearch { planes, grid, .. } = *search;
    let count = returns.points.len();
    returns.normals.resize(count, [0.0; 3]);
    returns.roughness.resize(count, 0.0);
    let (points, pixels, source) = (&returns.points, &returns.pixel, &returns.source);
    let chunks = returns.normals.par_chunks_mut(CHUNK).zip(returns.roughness.par_chunks_mut(CHUNK));
    chunks.with_max_len(1).enumerate().for_each(|(chunk, (normals, roughness))| {
        let first = chunk * CHUNK;
        let mut row = PixelRow::new(grid.columns);
        for (i, (normal, roughness)) in normals.iter_mut().zip(roughness).enumerate() {
            let pixel = pixels[first + i] as usize;
            let at = row.place(pixel);
            if weights.is_some_and(|weights| weights.of(at) == 0) {
                (*normal, *roughness) = ([0.0; 3], 0.0);
                continue;
            }
            let own = planes.at(at.0, at.1);
            let is_shown = image.points[pixel] == source[first + i];
            let plane =
                if is_shown && planes.has(at.0, at.1) && own.misfit() <= ON_PLANE { Some(own) } else { search.plane_of(points[first + i], at) };
            (*normal, *roughness) = plane.map_or(([0.0; 3], 0.0), |plane| (plane.normal(), plane.roughness()));
        }
    });
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Points within this many standard deviations are on the plane.
const ON_PLANE: f32 = 3.0;
/// A plane of a neighbour must fit better, because it was not fitted to this point.
const ON_NEIGHBOUR: f32 = 2.0;

/// The input of all searches.
pub(super) struct PlaneSearch<'a> {
    pub(super) planes: &'a Planes,
    pub(super) grid: &'a Grid,
    pub(super) rule: &'a WindowRule,
    /// Range noise, or the roughness that is allowed where that is more, metres.
    pub(super) noise: f32,
}

/// A point whose plane is searched.
#[derive(Clone, Copy)]
struct Query {
    /// Above the returns' origin.
    point: [f32; 3],
    /// Distance from the axis.
    depth: f32,
    /// Range noise over the range: times a plane's distance it is the noise along the plane's normal.
    noise_per_metre: f32,
}

impl Query {
    /// Distance from the plane, in units of what noise along the ray and the plane's roughness explain.
    #[inline(always)]
    fn misfit(&self, plane: &Plane<'_>) -> f32 {
        let off = (dot(plane.normal(), self.point) + plane.distance()).abs();
        off / larger(larger(self.noise_per_metre * plane.distance(), plane.roughness()), 1e-4)
    }
}

impl<'a> PlaneSearch<'a> {
    /// The plane of the pixel if the point is on it, else the best among the pixels around.
    #[inline(never)]
    fn plane_of(&self, point: [f32; 3], (row, column): (usize, usize)) -> Option<Plane<'a>> {
        let point = [point[0], point[1], point[2] - self.grid.height];
        let depth = (point[0] * point[0] + point[1] * point[1]).sqrt();
        let query = Query { point, depth, noise_per_metre: self.noise / dot(point, point).sqrt() };
        let own = self.planes.at(row, column);
        if self.planes.has(row, column) && query.misfit(&own) <= ON_PLANE {
            return Some(own);
        }
        // First half a window away, then a window away.
        let reach = self.rule.reach(row, Width::Narrow).map(|r| (r.at(1.0 / larger(depth, 1e-3)) + 0.5) as isize);
        let at = (row as isize, column as isize);
        self.best(&query, at, reach).or_else(|| self.best(&query, at, reach.map(|r| 2 * r)))
    }

    /// The best plane among the eight pixels `reach` away (along the row, down the column; less than a turn).
    fn best(&self, query: &Query, (row, column): (isize, isize), [along, down]: [isize; 2]) -> Option<Plane<'a>> {
        let columns = self.grid.columns as isize;
        let left = if column < along { column - along + columns } else { column - along };
        let right = if column + along >= columns { column + along - columns } else { column + along };
        // Three loops, candidates, misfits and the best of them, so that nothing branches on unpredictable conditions.
        let (mut candidates, mut count) = ([(0, 0); 9], 0);
        for r in [row, row - down, row + down] {
            let within = (0..self.grid.rows as isize).contains(&r);
            let r = r.clamp(0, self.grid.rows as isize - 1) as usize;
            for c in [left, right, column] {
                let c = c.clamp(0, columns - 1) as usize;
                candidates[count % candidates.len()] = (r, c);
                count += usize::from(within & self.planes.has(r, c));
            }
        }
        let candidates = &candidates[..count];
        let mut misfits = [0.0; 9];
        for (misfit, &(r, c)) in misfits.iter_mut().zip(candidates) {
            *misfit = query.misfit(&self.planes.at(r, c));
        }
        let mut best = (ON_NEIGHBOUR, None);
        for (&misfit, &at) in misfits.iter().zip(candidates) {
            if misfit < best.0 && self.is_near(query.depth, at) {
                best = (misfit, Some(at));
            }
        }
        best.1.map(|(r, c)| self.planes.at(r, c))
    }

    /// Whether a pixel's depth is similar to `depth`: a plane far beyond a gap may fit by chance.
    #[inline(always)]
    fn is_near(&self, depth: f32, (row, column): (usize, usize)) -> bool {
        (depth * self.grid.inverse[self.grid.at(row, column)] - 1.0).abs() < 0.25
    }
}
