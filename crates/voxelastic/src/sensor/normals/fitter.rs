//! The plane fit of a whole image, strip by strip.

use super::covariance::{Scratch, Width, WindowRule};
use super::grid::Grid;
use super::plane::{Plane, Planes, Solve, has_gaps};
use super::plane_search::PlaneSearch;
use super::plane_select::select_planes;
use super::settings::{NormalSettings, STRIP};
use super::sweep_seam::Seam;
use crate::sensor::beam_model::BeamModel;
use crate::sensor::patch_weights::PatchWeights;
use crate::sensor::range_image::RangeImage;
use crate::sensor::returns::Returns;
use crate::simd::dispatch;
use rayon::prelude::*;

/// Tasks per thread: parts of the image are not equal work.
const TASKS_PER_THREAD: usize = 4;

/// Fits planes to range images of one sensor.
#[derive(Clone, Debug)]
pub(crate) struct PlaneFitter {
    settings: NormalSettings,
    rule: WindowRule,
    grid: Grid,
    planes: Planes,
    scratch: Vec<Scratch>,
}

impl PlaneFitter {
    pub(crate) fn new(model: &BeamModel, settings: NormalSettings) -> Self {
        let rule = WindowRule::new(model, settings.half_window);
        Self { settings, rule, grid: Grid::new(model), planes: Planes::default(), scratch: Vec::new() }
    }

    /// Fills the normals and roughness of `returns`, whose points and pixels are those of `image`; zero for returns of weight 0. `times` are the measurement
    /// times of all points, if known.
    pub(crate) fn fit(
        &mut self,
        points: &[[f32; 3]],
        times: Option<&[f32]>,
        image: &RangeImage,
        weights: Option<&PatchWeights>,
        returns: &mut Returns,
    ) {
        self.grid.fill(points, image);
        let noise = self.settings.range_noise.unwrap_or_else(|| self.grid.range_noise()).max(0.002);
        self.grid.link(noise, times.and_then(|times| Seam::new(times, image)).as_ref());
        let strips = image.columns.div_ceil(STRIP);
        self.planes.reset(image.rows, strips);
        let tasks = (TASKS_PER_THREAD * rayon::current_num_threads()).min(strips).max(1);
        self.scratch.resize_with(tasks, Scratch::default);
        let per_task = strips.div_ceil(tasks);
        let (grid, rule, settings) = (&self.grid, &self.rule, self.settings);
        let parts = self.planes.split(per_task);
        parts.into_par_iter().zip(&mut self.scratch).with_max_len(1).enumerate().for_each(|(task, (mut rows, scratch))| {
            let mut work = StripFit { grid, rule, settings: &settings, noise, weights, scratch };
            let strips = rows.first().map_or(0, |row| row.len() / STRIP);
            for strip in 0..strips {
                work.fit((task * per_task + strip) * STRIP, rows.iter_mut().filter_map(|row| row[strip * STRIP..].first_chunk_mut()));
            }
        });
        select_planes(&self.search(noise.max(self.settings.roughness)), image, weights, returns);
    }

    /// A search among the planes that were fitted last, of points with so much noise, metres.
    pub(super) fn search(&self, noise: f32) -> PlaneSearch<'_> {
        PlaneSearch { planes: &self.planes, grid: &self.grid, rule: &self.rule, noise }
    }
}

/// The input of the fit of a strip.
struct StripFit<'a> {
    grid: &'a Grid,
    rule: &'a WindowRule,
    settings: &'a NormalSettings,
    noise: f32,
    weights: Option<&'a PatchWeights>,
    scratch: &'a mut Scratch,
}

impl StripFit<'_> {
    /// Fits wide windows at all pixels of the strip that starts at `first_column`, and narrow ones where that gives no plane.
    fn fit<'p>(&mut self, first_column: usize, rows: impl Iterator<Item = &'p mut [Plane; STRIP]>) {
        self.scratch.start(self.grid.rows);
        let weights = self.weights;
        let is_used = |row| weights.is_none_or(|weights| weights.of((row, first_column)) != 0);
        for (row, planes) in rows.enumerate() {
            if !is_used(row) {
                *planes = [Plane::NONE; STRIP];
                continue;
            }
            self.solve(Width::Wide, (row, first_column), planes);
            let at = self.grid.at(row, first_column);
            if has_gaps(planes, &self.grid.inverse[at..at + STRIP]) {
                self.solve(Width::Narrow, (row, first_column), planes);
            }
        }
    }

    fn solve(&mut self, width: Width, (row, first_column): (usize, usize), planes: &mut [Plane; STRIP]) {
        let Self { grid, rule, settings, noise, .. } = *self;
        let windows = self.scratch.window(grid, rule, width, (row, first_column));
        dispatch(Solve { windows, settings, noise, planes });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::preset;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn patches_that_are_used_get_the_planes_that_all_would(seed in prop::collection::vec(-1f32..1.0, 977), turn in 0usize..8, sharing in prop::collection::vec(0u32..4, 1..40)) {
            let model = preset("vlp-16").map_err(|e| TestCaseError::fail(e.to_string()))?;
            let size = (model.rows(), model.columns());
            let range = |pixel: usize| (4.0 + (pixel % size.1 / 40) as f32 * 0.7) * (1.0 + 0.002 * seed[pixel * 31 % seed.len()]);
            let pixels = 0..size.0 * size.1;
            let points: Vec<[f32; 3]> = pixels.clone().map(|pixel| model.point((pixel / size.1) as f32, (pixel % size.1) as f32, range(pixel))).collect();
            let numbers: Vec<u32> = (0..points.len() as u32).collect();
            let image = RangeImage { rows: size.0, columns: size.1, ranges: pixels.map(range).collect(), points: numbers.clone() };
            let weights = PatchWeights::new(size, turn, |patch| 1 << sharing[patch % sharing.len()]);
            let [mut all, mut used] = [None, Some(&weights)].map(|weights| {
                let mut fitter = PlaneFitter::new(&model, NormalSettings { range_noise: Some(0.02), ..NormalSettings::default() });
                let mut returns = Returns { points: points.clone(), pixel: numbers.clone(), source: numbers.clone(), ..Returns::default() };
                fitter.fit(&points, None, &image, weights, &mut returns);
                (fitter, returns)
            });
            let mut planes = 0;
            for pixel in 0..points.len() {
                let (row, column) = (pixel / size.1, pixel % size.1);
                if weights.of((row, column)) == 0 {
                    prop_assert_eq!(used.1.normals[pixel], [0.0; 3]);
                    continue;
                }
                prop_assert_eq!(used.0.planes.at(row, column).is_accepted(), all.0.planes.at(row, column).is_accepted());
                let [own_all, own_used] = [&mut all, &mut used].map(|fit| fit.0.planes.at(row, column).normal);
                prop_assert_eq!(own_used, own_all);
                planes += usize::from(used.1.normals[pixel] != [0.0; 3]);
            }
            prop_assert!(planes > 0);
        }
    }
}
