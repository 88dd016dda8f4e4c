//! Selection of the plane that each return lies on.

use super::covariance::{Width, WindowRule};
use super::grid::Grid;
use super::plane::{Plane, Planes};
use crate::sensor::patch_weights::PatchWeights;
use crate::sensor::pixel_row::PixelRow;
use crate::sensor::returns::Returns;
use crate::simd::larger;
use rayon::prelude::*;

/// Returns of one task.
const CHUNK: usize = 4096;

/// Gives every return the plane nearest to its pixel in the row, or, where there is none or the return is not on it, the best fitting plane of those around: at an
/// edge or a crease the windows of the neighbours on one side contain one surface only. Returns of weight 0 get none.
pub(super) fn select_planes(search: &PlaneSearch<'_>, weights: Option<&PatchWeights>, returns: &mut Returns) {
    let columns = search.grid.columns;
    let count = returns.points.len();
    returns.normals.resize(count, [0.0; 3]);
    returns.roughness.resize(count, 0.0);
    let (points, pixels) = (&returns.points, &returns.pixel);
    let chunks = returns.normals.par_chunks_mut(CHUNK).zip(returns.roughness.par_chunks_mut(CHUNK));
    chunks.with_max_len(1).enumerate().for_each(|(chunk, (normals, roughness))| {
        let first = chunk * CHUNK;
        let mut row = PixelRow::new(columns);
        for (i, (normal, roughness)) in normals.iter_mut().zip(roughness).enumerate() {
            let at = row.place(pixels[first + i] as usize);
            let plane = if weights.is_some_and(|weights| weights.of(at) == 0) { None } else { search.plane_of(points[first + i], at) };
            (*normal, *roughness) = plane.map_or(([0.0; 3], 0.0), |plane| (plane.normal, plane.roughness));
        }
    });
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Points within this many standard deviations are on the plane of their group of columns.
const ON_PLANE: f32 = 3.0;
/// A plane of another group must fit better, because it was not fitted to this point.
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
    /// Range noise over the range: times a plane's distance it is the noise along the plane's normal.
    noise_per_metre: f32,
}

impl Query {
    /// Distance from the plane, in units of what noise along the ray and the plane's roughness explain.
    #[inline(always)]
    fn misfit(&self, plane: &Plane) -> f32 {
        let off = (dot(plane.normal, self.point) + plane.distance).abs();
        off / larger(larger(self.noise_per_metre * plane.distance, plane.roughness), 1e-4)
    }
}

impl<'a> PlaneSearch<'a> {
    /// The plane nearest to the pixel if the point is on it, else the best among those around.
    #[inline(always)]
    fn plane_of(&self, point: [f32; 3], (row, column): (usize, usize)) -> Option<&'a Plane> {
        let point = [point[0], point[1], point[2] - self.grid.height];
        let query = Query { point, noise_per_metre: self.noise / dot(point, point).sqrt() };
        let nearest = self.planes.nearest(row, column);
        let is_on = |plane: &&Plane| query.misfit(plane) <= ON_PLANE;
        nearest.plane().filter(is_on).or_else(|| nearest.other().filter(is_on)).or_else(|| self.around(&query, (row, column)))
    }

    /// The best plane one fitted column and half a window down the column away; if there is none, twice as far away.
    #[inline(never)]
    fn around(&self, query: &Query, (row, column): (usize, usize)) -> Option<&'a Plane> {
        let depth = (query.point[0] * query.point[0] + query.point[1] * query.point[1]).sqrt();
        let along = self.planes.spacing(row, column) as isize;
        let down = (self.rule.reach(row, Width::Narrow)[1].at(1.0 / larger(depth, 1e-3)) + 0.5) as isize;
        let at = (row as isize, column as isize);
        self.best((query, depth), at, [along, down]).or_else(|| self.best((query, depth), at, [2 * along, 2 * down]))
    }

    /// The best plane nearest to the eight pixels `reach` away (along the row, down the column; less than a turn).
    fn best(&self, (query, depth): (&Query, f32), (row, column): (isize, isize), [along, down]: [isize; 2]) -> Option<&'a Plane> {
        let columns = self.grid.columns as isize;
        let left = if column < along { column - along + columns } else { column - along };
        let right = if column + along >= columns { column + along - columns } else { column + along };
        let mut best = (ON_NEIGHBOUR, None);
        for r in [row, row - down, row + down] {
            if !(0..self.grid.rows as isize).contains(&r) {
                continue;
            }
            for c in [left, right, column] {
                let c = c.clamp(0, columns - 1) as usize;
                if let Some(plane) = self.planes.nearest(r as usize, c).plane() {
                    let misfit = query.misfit(plane);
                    // A plane far beyond a gap may fit by chance: only those at a similar depth count.
                    if misfit < best.0 && (depth * plane.inverse - 1.0).abs() < 0.25 {
                        best = (misfit, Some(plane));
                    }
                }
            }
        }
        best.1
    }
}
