//! A local plane for every return, from its neighbours in the range image.
//!
//! A plane is a line in inverse depth: with X, Y, Z along, across and above a pixel's column, the plane aX + bY + cZ = 1
//! reads 1/X = a + b (Y/X) + c (Z/X). A least-squares fit in these coordinates (Badino et al., ICRA 2011, solve the same
//! system in spherical ones) is exact for planes at any slant: ground whose rings are metres apart is as straight as a
//! wall. Range noise moves 1/X alone, so that the fit also says how sure it is.
//!
//! 1. [`grid`]: the coordinates of every pixel, and which neighbours continue one surface (no jump against the trend).
//!    Between the first and the last column of a sweep the sensor has moved on: [`seam`] cuts there.
//! 2. [`moments`]: sums over a window of about 30 cm that ends where the surface does, along rows, then down columns.
//! 3. [`plane`]: the 3 x 3 systems, and the tests that turn doubtful planes away.
//! 4. [`assign`]: returns take the plane of their pixel, or of a neighbour, if they lie on it; else none.

mod assign;
mod grid;
mod moments;
mod plane;
mod seam;

use super::image::RangeImage;
use super::model::BeamModel;
use super::prepare::Beams;
use crate::dispatch::dispatch;
use assign::Shared;
use grid::Grid;
use moments::{Scratch, Width, WindowRule};
use plane::{PlaneRow, Planes, Solve};
use rayon::prelude::*;
use seam::Seam;

/// Columns that are worked on together: the sums of a strip stay in the second-level cache.
pub(crate) const STRIP: usize = 32;

/// Shares of the image for each thread: parts of it are more work than others.
const TASKS_PER_THREAD: usize = 4;

/// Settings of the plane fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalSettings {
    /// Half of the width of the surface patch that a plane is fitted to, metres. Far away, where pixels are farther apart,
    /// the patch is the nearest two pixels on each side.
    pub half_window: f32,
    /// Range noise (1 sigma, metres) if known; measured from each scan otherwise.
    pub range_noise: Option<f32>,
    /// Patches rougher than the range noise explains are still planes up to this deviation along the normal (1 sigma,
    /// metres): grass, gravel, rounding.
    pub roughness: f32,
    /// Largest standard deviation of a normal's direction that is trusted, radians.
    pub max_uncertainty: f32,
}

impl Default for NormalSettings {
    fn default() -> Self {
        Self { half_window: 0.2, range_noise: None, roughness: 0.015, max_uncertainty: 0.12 }
    }
}

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

    /// Fills the normals and roughness of `beams`, whose points and pixels are those of `image`. `times` says when each point was measured, if
    /// that is known.
    pub(crate) fn fit(&mut self, points: &[[f32; 3]], times: Option<&[f32]>, image: &RangeImage, beams: &mut Beams) {
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
            let strips = rows.first().map_or(0, |row| row.len());
            for strip in 0..strips {
                work.fit((task * per_task + strip) * STRIP, rows.iter_mut().map(|row| &mut row[strip]));
            }
        });
        self.planes.note();
        let shared = Shared { planes: &self.planes, grid: &self.grid, rule: &self.rule, noise: noise.max(self.settings.roughness) };
        assign::assign(&shared, image, beams);
    }
}

/// All that fitting a strip needs.
struct StripFit<'a> {
    grid: &'a Grid,
    rule: &'a WindowRule,
    settings: &'a NormalSettings,
    noise: f32,
    scratch: &'a mut Scratch,
}

impl StripFit<'_> {
    /// Wide windows for all pixels of the strip that starts at `first_column`, narrow ones for those left without a plane.
    fn fit<'p>(&mut self, first_column: usize, rows: impl Iterator<Item = &'p mut PlaneRow>) {
        self.scratch.start(self.grid, self.rule, first_column);
        for (row, planes) in rows.enumerate() {
            self.solve(Width::Wide, (row, first_column), planes);
            let at = self.grid.at(row, first_column);
            if planes.has_gaps(&self.grid.inverse[at..at + STRIP]) {
                self.solve(Width::Narrow, (row, first_column), planes);
            }
        }
    }

    fn solve(&mut self, width: Width, (row, first_column): (usize, usize), planes: &mut PlaneRow) {
        let Self { grid, rule, settings, noise, .. } = *self;
        let windows = self.scratch.window(grid, rule, width, (row, first_column));
        dispatch(Solve { windows, settings, noise, planes });
    }
}
