//! Selection of the plane that each return lies on.

use super::covariance::{Width, WindowRule};
use super::grid::Grid;
use super::plane::{GroupPlace, PLANE, Plane, Planes};
use crate::sensor::patch_weights::PatchWeights;
use crate::sensor::pixel_row::PixelRow;
use crate::sensor::returns::Returns;
use crate::simd::{Kernel, dispatch, gather, larger};
use rayon::prelude::*;

/// Returns of one task.
const CHUNK: usize = 1024;

/// Gives every return the plane nearest to its pixel in the row, or, where there is none or the return is not on it, the best fitting plane of those around: at an
/// edge or a crease the windows of the neighbours on one side contain one surface only. Returns of weight 0 get none.
pub(super) fn select_planes(search: &PlaneSearch<'_>, weights: Option<&PatchWeights>, returns: &mut Returns) {
    let count = returns.points.len();
    returns.normals.resize(count, [0.0; 3]);
    returns.roughness.resize(count, 0.0);
    let chunks = returns.normals.par_chunks_mut(CHUNK).zip(returns.roughness.par_chunks_mut(CHUNK));
    let given = returns.points.par_chunks(CHUNK).zip(returns.pixel.par_chunks(CHUNK));
    chunks.zip(given).with_min_len(4).for_each(|((normals, roughness), (points, pixels))| {
        let (mut row, no_plane) = (PixelRow::new(search.grid.columns), search.planes.no_plane() as u32);
        let (mut places, mut numbers, mut is_on) = ([(0, 0); CHUNK], [no_plane; CHUNK], [0u32; CHUNK]);
        for (i, &pixel) in pixels.iter().enumerate() {
            places[i] = row.place(pixel as usize);
            if weights.is_none_or(|weights| weights.of(places[i]) != 0) {
                let (row, column) = places[i];
                numbers[i] = search.planes.nearest(row, GroupPlace::new(column)).number(search.planes);
            }
        }
        let (planes, height, noise) = (search.planes.numbers(), search.grid.height, search.noise);
        dispatch(Nearby {
            planes,
            numbers: &numbers,
            no_plane,
            points,
            height,
            noise,
            normals: &mut *normals,
            roughness: &mut *roughness,
            is_on: &mut is_on,
        });
        for i in (0..points.len()).filter(|&i| is_on[i] == 0) {
            let is_used = weights.is_none_or(|weights| weights.of(places[i]) != 0);
            let plane = if is_used { search.plane_of(points[i], places[i]) } else { None };
            (normals[i], roughness[i]) = plane.map_or(([0.0; 3], 0.0), |plane| (plane.normal, plane.roughness));
        }
    });
}

/// Gives points their nearest planes if they are on them.
struct Nearby<'a> {
    /// All planes, and the number of that of each point.
    planes: &'a [f32],
    numbers: &'a [u32; CHUNK],
    no_plane: u32,
    points: &'a [[f32; 3]],
    height: f32,
    noise: f32,
    normals: &'a mut [[f32; 3]],
    roughness: &'a mut [f32],
    /// 1 where a point got its plane.
    is_on: &'a mut [u32; CHUNK],
}

impl Kernel for Nearby<'_> {
    #[inline(always)]
    fn run(self) {
        /// Points at a time: their planes stay in the first-level cache.
        const LANES: usize = 64;
        let Self { planes, numbers, no_plane, points, height, noise, normals, roughness, is_on } = self;
        for first in (0..points.len().min(CHUNK)).step_by(LANES) {
            let count = (points.len() - first).min(LANES);
            let (mut index, mut plane) = ([0u32; LANES], [[0f32; LANES]; 6]);
            for (k, values) in plane.iter_mut().enumerate() {
                for i in 0..LANES {
                    index[i] = numbers[first + i] * PLANE as u32 + k as u32;
                }
                gather(planes, &index, values);
            }
            let [x, y, z, distance, rough, inverse] = plane;
            let (mut p, mut on) = ([[0f32; 3]; LANES], [0u32; LANES]);
            p[..count].copy_from_slice(&points[first..first + count]);
            for i in 0..LANES {
                let up = p[i][2] - height;
                let flat = p[i][0] * p[i][0] + p[i][1] * p[i][1];
                let per_metre = noise / (flat + up * up).sqrt();
                let is_near = (flat.sqrt() * inverse[i] - 1.0).abs() < NEAR;
                let off = (x[i] * p[i][0] + y[i] * p[i][1] + z[i] * up + distance[i]).abs();
                let expected = larger(larger(per_metre * distance[i], rough[i]), LEAST_DEVIATION);
                on[i] = u32::from((off <= ON_PLANE * expected) & is_near & (numbers[first + i] != no_plane));
            }
            for i in 0..count {
                normals[first + i] = [x[i], y[i], z[i]];
                roughness[first + i] = rough[i];
                is_on[first + i] = on[i];
            }
        }
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Points within this many standard deviations are on the plane of their group of columns.
const ON_PLANE: f32 = 3.0;
/// A plane of another group must fit better, because it was not fitted to this point.
const ON_NEIGHBOUR: f32 = 2.0;
/// A plane far beyond a gap may fit by chance: only those at a similar depth count, up to this part of it.
const NEAR: f32 = 0.25;
/// Least deviation that is expected, metres.
const LEAST_DEVIATION: f32 = 1e-4;

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
    /// Whether the plane was fitted at a similar depth.
    #[inline(always)]
    fn is_near(&self, plane: &Plane) -> bool {
        (self.depth * plane.inverse - 1.0).abs() < NEAR
    }

    /// Distance from the plane, and the one that noise along the ray and the plane's roughness explain.
    #[inline(always)]
    fn deviation(&self, plane: &Plane) -> Deviation {
        let off = (dot(plane.normal, self.point) + plane.distance).abs();
        Deviation { off, expected: larger(larger(self.noise_per_metre * plane.distance, plane.roughness), LEAST_DEVIATION) }
    }
}

/// How far a point is off a plane, and how far it would be expected to be, metres.
#[derive(Clone, Copy)]
struct Deviation {
    off: f32,
    expected: f32,
}

impl Deviation {
    /// Whether the point is nearer than so many standard deviations.
    #[inline(always)]
    fn is_within(self, most: f32) -> bool {
        self.off <= most * self.expected
    }

    /// Whether it is nearer than another, in standard deviations.
    #[inline(always)]
    fn is_less(self, other: Self) -> bool {
        self.off * other.expected < other.off * self.expected
    }
}

impl PlaneSearch<'_> {
    /// The plane nearest to the pixel if the point is on it, else the best among those around.
    #[inline(never)]
    fn plane_of(&self, point: [f32; 3], (row, column): (usize, usize)) -> Option<Plane> {
        let point = [point[0], point[1], point[2] - self.grid.height];
        let depth = (point[0] * point[0] + point[1] * point[1]).sqrt();
        let query = Query { point, depth, noise_per_metre: self.noise / dot(point, point).sqrt() };
        let nearest = self.planes.nearest(row, GroupPlace::new(column));
        let is_on = |plane: &Plane| query.deviation(plane).is_within(ON_PLANE) && query.is_near(plane);
        nearest.plane().filter(is_on).or_else(|| nearest.other().filter(is_on)).or_else(|| self.around(&query, (row, column)))
    }

    /// The best plane one fitted column and half a window down the column away; if there is none, twice as far away.
    #[inline(always)]
    fn around(&self, query: &Query, (row, column): (usize, usize)) -> Option<Plane> {
        let along = self.planes.spacing(row, column);
        let down = (self.rule.reach(row, Width::Narrow)[1].at(1.0 / larger(query.depth, 1e-3)) + 0.5) as usize;
        let once = self.best(query, (row, column), [along, down]);
        once.or_else(|| self.best(query, (row, column), [2 * along, 2 * down]))
    }

    /// The best plane nearest to the eight pixels `reach` away (along the row, down the column; less than a turn).
    fn best(&self, query: &Query, (row, column): (usize, usize), [along, down]: [usize; 2]) -> Option<Plane> {
        let columns = self.grid.columns;
        let left = if column < along { (column + columns).saturating_sub(along) } else { column - along };
        let right = if column + along >= columns { column + along - columns } else { column + along };
        let places = [left, right, column].map(|column| GroupPlace::new(column.min(columns - 1)));
        let mut best = (Deviation { off: ON_NEIGHBOUR, expected: 1.0 }, None);
        // The planes in the same column of this row were looked at before.
        for (row, places) in [(Some(row), &places[..2]), (row.checked_sub(down), &places[..]), (Some(row + down), &places[..])] {
            let Some(row) = row.filter(|&row| row < self.grid.rows) else { continue };
            for &place in places {
                let Some(plane) = self.planes.nearest(row, place).plane() else { continue };
                let deviation = query.deviation(&plane);
                if deviation.is_less(best.0) && query.is_near(&plane) {
                    best = (deviation, Some(plane));
                }
            }
        }
        best.1
    }
}
