//! The search for the plane that a return lies on, among those of the pixels around its own.

#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::covariance::{Width, WindowRule};
use super::grid::Grid;
use super::plane::{Plane, Planes};
use crate::simd::larger;

/// Pixels around one.
const AROUND: usize = 8;

/// Points within this many standard deviations are on the plane.
pub(super) const ON_PLANE: f32 = 3.0;
/// A plane of a neighbour must fit better, because it was not fitted to this point.
const ON_NEIGHBOUR: f32 = 2.0;
/// Largest difference between the depths of a point and of the pixel whose plane it gets, as a share: a plane far beyond a gap may fit by chance.
const NEAR: f32 = 0.25;

/// Of a plane that does not fit, among the bits of misfits.
const NO_FIT: u32 = u32::MAX;

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
    fn misfit(&self, [x, y, z, distance, roughness]: [f32; 5]) -> f32 {
        let off = (x * self.point[0] + y * self.point[1] + z * self.point[2] + distance).abs();
        off / larger(larger(self.noise_per_metre * distance, roughness), 1e-4)
    }
}

impl<'a> PlaneSearch<'a> {
    /// The plane of the pixel if the point is on it, else the best among the pixels around: first half a window away, then a window away.
    #[inline(always)]
    pub(super) fn find(&self, point: [f32; 3], (row, column): (usize, usize)) -> Option<&'a Plane> {
        let point = [point[0], point[1], point[2] - self.grid.height];
        let depth = (point[0] * point[0] + point[1] * point[1]).sqrt();
        let range = (point[0] * point[0] + point[1] * point[1] + point[2] * point[2]).sqrt();
        let query = Query { point, depth, noise_per_metre: self.noise / range };
        let own = self.planes.at(row, column);
        let [x, y, z] = own.normal;
        if own.is_accepted() && query.misfit([x, y, z, own.distance, own.roughness]) <= ON_PLANE {
            return Some(own);
        }
        let [along, down] = self.rule.reach(row, Width::Narrow);
        let inverse = 1.0 / larger(depth, 1e-3);
        let (along, down) = ((along.at(inverse) + 0.5) as i32, (down.at(inverse) + 0.5) as i32);
        let at = [row as i32, column as i32];
        let near = self.best(&query, at, [along, down]);
        if near.is_some() { near } else { self.best(&query, at, [2 * along, 2 * down]) }
    }

    /// The best plane among the eight pixels `reach` away (along the row, down the column; less than a turn); the first of equals.
    #[inline(always)]
    fn best(&self, query: &Query, [row, column]: [i32; 2], [along, down]: [i32; 2]) -> Option<&'a Plane> {
        let (rows, columns) = (self.grid.rows as i32, self.grid.columns as i32);
        let (before, after) = (column - along, column + along);
        let left = (if before < 0 { before + columns } else { before }).max(0);
        let right = (if after >= columns { after - columns } else { after }).min(columns - 1);
        let (above, below) = ((row - down).max(0), (row + down).min(rows - 1));
        let (is_above, is_below) = (row >= down, row + down < rows);
        let around: [(i32, i32, bool); AROUND] = [
            (row, left, true),
            (row, right, true),
            (above, left, is_above),
            (above, right, is_above),
            (above, column, is_above),
            (below, left, is_below),
            (below, right, is_below),
            (below, column, is_below),
        ];
        // In vector lanes: branches on the planes would be unpredictable.
        let (mut fields, mut inverse, mut within) = ([[0.0; AROUND]; 5], [0.0; AROUND], [0; AROUND]);
        for i in 0..AROUND {
            let (row, column, is_within) = around[i];
            let plane = self.planes.at(row as usize, column as usize);
            let [x, y, z] = plane.normal;
            [fields[0][i], fields[1][i], fields[2][i], fields[3][i], fields[4][i]] = [x, y, z, plane.distance, plane.roughness];
            (inverse[i], within[i]) = (plane.inverse, u32::from(is_within));
        }
        // Bits of numbers that are not negative have the order of the numbers.
        let mut misfits = [NO_FIT; AROUND];
        for i in 0..AROUND {
            let roughness = fields[4][i];
            let misfit = query.misfit([fields[0][i], fields[1][i], fields[2][i], fields[3][i], roughness]);
            let is_near = (query.depth * inverse[i] - 1.0).abs() < NEAR;
            let is_fit = (within[i] == 1) & is_near & (roughness >= 0.0) & (misfit < ON_NEIGHBOUR);
            misfits[i] = if is_fit { misfit.to_bits() } else { NO_FIT };
        }
        let mut least = NO_FIT;
        for misfit in misfits {
            least = least.min(misfit);
        }
        if least == NO_FIT {
            return None;
        }
        let mut first = 0u32;
        for i in 0..AROUND {
            first |= u32::from(misfits[i] == least) << i;
        }
        let (row, column, _) = around[first.trailing_zeros() as usize % AROUND];
        Some(self.planes.at(row as usize, column as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::normals::PlaneFitter;
    use crate::sensor::normals::settings::NormalSettings;
    use crate::sensor::preset;
    use crate::sensor::range_image::RangeImage;
    use crate::sensor::returns::Returns;
    use proptest::prelude::*;

    /// The definition: one plane after the other.
    fn search_slowly<'a>(search: &PlaneSearch<'a>, point: [f32; 3], (row, column): (usize, usize)) -> Option<&'a Plane> {
        let point = [point[0], point[1], point[2] - search.grid.height];
        let depth = (point[0] * point[0] + point[1] * point[1]).sqrt();
        let range = (point[0] * point[0] + point[1] * point[1] + point[2] * point[2]).sqrt();
        let misfit = |plane: &Plane| {
            let n = plane.normal;
            let off = (n[0] * point[0] + n[1] * point[1] + n[2] * point[2] + plane.distance).abs();
            off / (search.noise / range * plane.distance).max(plane.roughness).max(1e-4)
        };
        let own = search.planes.at(row, column);
        if own.is_accepted() && misfit(own) <= ON_PLANE {
            return Some(own);
        }
        let reach = search.rule.reach(row, Width::Narrow).map(|r| (r.at(1.0 / depth.max(1e-3)) + 0.5) as isize);
        for windows in [1, 2] {
            let [along, down] = reach.map(|r| windows * r);
            let mut best: Option<(f32, &Plane)> = None;
            for r in [0, -down, down].map(|d| row as isize + d) {
                for c in [-along, along, 0].map(|d| (column as isize + d).rem_euclid(search.grid.columns as isize) as usize) {
                    let Some(plane) = (0..search.grid.rows as isize).contains(&r).then(|| search.planes.at(r as usize, c)) else { continue };
                    let is_near = (depth * search.grid.inverse[search.grid.at(r as usize, c)] - 1.0).abs() < NEAR;
                    if plane.is_accepted() && is_near && misfit(plane) < best.map_or(ON_NEIGHBOUR, |best| best.0) {
                        best = Some((misfit(plane), plane));
                    }
                }
            }
            if let Some((_, plane)) = best {
                return Some(plane);
            }
        }
        None
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_search_finds_what_one_plane_after_the_other_gives(
            seed in prop::collection::vec(-1f32..1.0, 977), name in prop::sample::select(vec!["vlp-16", "os1-64"]), noise in 0.005f32..0.1,
        ) {
            let model = preset(name).map_err(|e| TestCaseError::fail(e.to_string()))?;
            let (rows, columns) = (model.rows(), model.columns());
            let number = |i: usize| seed[i * 31 % seed.len()];
            // Facades at several depths, some rough, with gaps.
            let range = |pixel: usize| {
                let facade = pixel % columns / 40 + 7 * (pixel / columns / 6);
                let rough = if facade.is_multiple_of(5) { 0.05 } else { 0.001 };
                (4.0 + 3.0 * number(facade).abs()) * (1.0 + rough * number(pixel))
            };
            let points: Vec<[f32; 3]> = (0..rows * columns).map(|i| model.point((i / columns) as f32, (i % columns) as f32, range(i))).collect();
            let numbers: Vec<u32> = (0..points.len() as u32).collect();
            let image = RangeImage { rows, columns, ranges: (0..points.len()).map(range).collect(), points: numbers.clone() };
            let mut fitter = PlaneFitter::new(&model, NormalSettings { range_noise: Some(0.02), ..NormalSettings::default() });
            let mut returns = Returns { points: points.clone(), pixel: numbers.clone(), source: numbers, ..Returns::default() };
            fitter.fit(&points, None, &image, &mut returns);
            let search = fitter.search(noise);
            let mut counts = [0; 2];
            for i in 0..6000 {
                let pixel = i * 1009 % points.len();
                let (point, at) = (points[pixel].map(|c| c * (1.0 + 0.02 * number(i))), (pixel / columns, pixel % columns));
                let found = search.find(point, at);
                prop_assert_eq!(found.map(std::ptr::from_ref), search_slowly(&search, point, at).map(std::ptr::from_ref));
                counts[usize::from(found.is_some())] += 1;
            }
            prop_assert!(counts.iter().all(|count| *count > 200), "{:?} without and with a plane", counts);
        }
    }
}
