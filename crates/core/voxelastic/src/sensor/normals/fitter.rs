//! The plane fit of a whole image, strip by strip.

use super::covariance::{Scratch, Width, WindowRule};
use super::grid::Grid;
use super::plane::{Plane, Planes, Solve, has_gaps};
use super::plane_search::PlaneSearch;
use super::plane_select::select_planes;
use super::settings::{NormalSettings, STRIP};
use super::sweep_seam::Seam;
use crate::sensor::beam_model::BeamModel;
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

    /// Fills the normals and roughness of `returns`, whose points and pixels are those of `image`. `times` are the measurement times of all points, if
    /// known.
    pub(crate) fn fit(&mut self, points: &[[f32; 3]], times: Option<&[f32]>, image: &RangeImage, returns: &mut Returns) {
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
            let mut work = StripFit { grid, rule, settings: &settings, noise, scratch };
            let strips = rows.first().map_or(0, |row| row.len() / STRIP);
            for strip in 0..strips {
                work.fit((task * per_task + strip) * STRIP, rows.iter_mut().filter_map(|row| row[strip * STRIP..].first_chunk_mut()));
            }
        });
        select_planes(&self.search(noise.max(self.settings.roughness)), image, returns);
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
    scratch: &'a mut Scratch,
}

impl StripFit<'_> {
    /// Fits wide windows at all pixels of the strip that starts at `first_column`, and narrow ones where that gives no plane.
    fn fit<'p>(&mut self, first_column: usize, rows: impl Iterator<Item = &'p mut [Plane; STRIP]>) {
        self.scratch.start(self.grid.rows);
        for (row, planes) in rows.enumerate() {
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
