//! The range image in the coordinates of the plane fit, with the links between pixels of one surface.

use super::links::{Centre, LinkDown, LinkRight};
use super::settings::{FITTED, GROUP, LANES, STRIP};
use super::sweep_seam::Seam;
use crate::sensor::beam_model::BeamModel;
use crate::sensor::range_image::{NO_POINT, RangeImage};
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// Groups of columns repeated beyond both ends of a row, so that windows need not wrap: the largest window reaches two groups beyond its own, and links another.
const PAD_GROUPS: usize = 4;
const PAD: usize = PAD_GROUPS * GROUP;

/// Least rows of one task: fewer are not worth the overhead.
const ROWS_PER_TASK: usize = 4;

/// Quantile of the second differences from which the range noise is estimated, and the value of that quantile of |x| of a normal distribution.
const QUANTILE: f32 = 0.35;
const QUANTILE_OF_NORMAL: f32 = 0.4538;

/// Per pixel, with `PAD` wrapped columns on both sides of each row (and zeros up to whole strips): the point in the frame of its column (X along the
/// column's azimuth, Y to the left, Z up from the beams' origin).
///
/// The columns of a row are stored in [`GROUP`] parts: every fourth one from the first, every fourth one from the second, and so on. So the same column of
/// neighbouring groups is in neighbouring vector lanes.
#[derive(Clone, Debug, Default)]
pub(super) struct Grid {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) strips: usize,
    /// Length of a part of a row.
    part: usize,
    /// 1 / X; 0 where there is no point.
    inverse: Vec<f32>,
    /// Y / X.
    across: Vec<f32>,
    /// Z / X.
    rise: Vec<f32>,
    /// `inverse` interpolated to the pixel's centre: rows are staggered, and projected points are off the centre.
    centred: Vec<f32>,
    /// The inverse depth at each fitted pixel, or, where that is empty, of a pixel beside it; 0 if all three are empty.
    centres: Vec<f32>,
    /// 1 where the pixel and the next in the row are on one surface, else 0. A single pixel without a point belongs to the surface that continues beyond it, also
    /// down the column.
    link_right: Vec<f32>,
    /// 1 where the pixel and the one below are on one surface, else 0. Of fitted columns only.
    link_down: Vec<f32>,
    /// Cosine and sine of each column's azimuth, in whole strips, in the order of a row's parts.
    axes: [Vec<[f32; 2]>; GROUP],
    pub(super) height: f32,
    /// 1 / (signed angle between columns).
    per_step: f32,
    /// Tangent of each row's elevation.
    pub(super) row_rise: Vec<f32>,
}

/// What the grid has of one row.
#[derive(Clone, Copy)]
pub(super) struct GridRow<'a> {
    part: usize,
    inverse: &'a [f32],
    across: &'a [f32],
    rise: &'a [f32],
    centres: &'a [f32],
    link_right: &'a [f32],
    link_down: &'a [f32],
}

/// Pixels of one row, `GROUP` columns from one to the next.
pub(super) struct Pixels<'a> {
    pub(super) inverse: &'a [f32; LANES],
    pub(super) across: &'a [f32; LANES],
    pub(super) rise: &'a [f32; LANES],
}

/// `LANES` items of a slice.
#[inline(always)]
fn lanes(slice: &[f32], at: usize) -> &[f32; LANES] {
    const NOTHING: [f32; LANES] = [0.0; LANES];
    slice[at..].first_chunk().unwrap_or(&NOTHING)
}

impl<'a> GridRow<'a> {
    /// Position of the columns `offset` columns from the one of number `fitted` in each group of a strip.
    #[inline(always)]
    fn position(&self, (strip, fitted): (usize, usize), offset: isize) -> usize {
        let column = (PAD + fitted) as isize + offset;
        (column as usize % GROUP) * self.part + column as usize / GROUP + strip * LANES
    }

    /// The pixels `offset` columns (at most the padding) from the ones of number `fitted` in each group of a strip.
    #[inline(always)]
    pub(super) fn pixels(&self, at: (usize, usize), offset: isize) -> Pixels<'a> {
        let position = self.position(at, offset);
        Pixels { inverse: lanes(self.inverse, position), across: lanes(self.across, position), rise: lanes(self.rise, position) }
    }

    /// The links from such pixels to the next ones in the row.
    #[inline(always)]
    pub(super) fn link_right(&self, at: (usize, usize), offset: isize) -> &'a [f32; LANES] {
        lanes(self.link_right, self.position(at, offset))
    }

    /// The links down from the fitted pixels themselves.
    #[inline(always)]
    pub(super) fn link_down(&self, (strip, fitted): (usize, usize)) -> &'a [f32; LANES] {
        lanes(self.link_down, fitted / 2 * self.part + PAD_GROUPS + strip * LANES)
    }

    /// The inverse depths that planes are fitted around.
    #[inline(always)]
    pub(super) fn centres(&self, (strip, fitted): (usize, usize)) -> &'a [f32; LANES] {
        lanes(self.centres, fitted / 2 * self.part + PAD_GROUPS + strip * LANES)
    }
}

impl Grid {
    pub(super) fn new(model: &BeamModel) -> Self {
        let first = model.azimuth(0.0, 0.0) as f64;
        let step = (model.azimuth(0.0, 1.0) - model.azimuth(0.0, 0.0)) as f64;
        let step = step.signum() * std::f64::consts::TAU / model.columns() as f64;
        let (rows, columns) = (model.rows(), model.columns());
        let strips = columns.div_ceil(STRIP);
        let axis = |column: usize| (first + column as f64 * step).sin_cos();
        let axes = [0, 1, 2, 3].map(|k| (0..strips * LANES).map(|group| axis(GROUP * group + k)).map(|(s, c)| [c as f32, s as f32]).collect());
        let row_rise = model.elevations().iter().map(|e| e.clamp(-1.55, 1.55).tan()).collect();
        let part = strips * LANES + 2 * PAD_GROUPS;
        let plane = |parts: usize| vec![0f32; rows * parts * part];
        Self {
            rows,
            columns,
            strips,
            part,
            inverse: plane(GROUP),
            across: plane(GROUP),
            rise: plane(GROUP),
            centred: plane(GROUP),
            centres: plane(FITTED.len()),
            link_right: plane(GROUP),
            link_down: plane(FITTED.len()),
            axes,
            height: model.origin_height(),
            per_step: (1.0 / step) as f32,
            row_rise,
        }
    }

    /// What there is of a row.
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> GridRow<'_> {
        let all = row * GROUP * self.part..(row + 1) * GROUP * self.part;
        let fitted = row * FITTED.len() * self.part..(row + 1) * FITTED.len() * self.part;
        GridRow {
            part: self.part,
            inverse: &self.inverse[all.clone()],
            across: &self.across[all.clone()],
            rise: &self.rise[all.clone()],
            centres: &self.centres[fitted.clone()],
            link_right: &self.link_right[all],
            link_down: &self.link_down[fitted],
        }
    }

    /// Cosine and sine of the azimuth of the columns of number `fitted` in each group of a strip.
    #[inline(always)]
    pub(super) fn axes(&self, (strip, fitted): (usize, usize)) -> &[[f32; 2]; LANES] {
        const NOTHING: [[f32; 2]; LANES] = [[0.0; 2]; LANES];
        self.axes[fitted][strip * LANES..].first_chunk().unwrap_or(&NOTHING)
    }

    /// Position of a pixel, which may be in the padding, in the padded planes.
    #[inline(always)]
    fn at(&self, row: usize, column: isize) -> usize {
        row * GROUP * self.part + place(self.part, column)
    }

    /// Copies the points that the pixels of `image` show.
    pub(super) fn fill(&mut self, points: &[[f32; 3]], image: &RangeImage) {
        let Self { columns, part, height, per_step, .. } = *self;
        let groups = columns.div_ceil(GROUP);
        let axes = &self.axes;
        let planes = (
            self.inverse.par_chunks_mut(GROUP * part),
            self.across.par_chunks_mut(GROUP * part),
            self.rise.par_chunks_mut(GROUP * part),
            self.centred.par_chunks_mut(GROUP * part),
            self.centres.par_chunks_mut(FITTED.len() * part),
            image.points.par_chunks(columns),
        );
        let shown = || [0; GROUP].map(|_| vec![[0f32; 3]; groups]);
        planes.into_par_iter().with_min_len(ROWS_PER_TASK).for_each_init(shown, |shown, (inverse, across, rise, centred, centres, indices)| {
            for (group, indices) in indices.chunks(GROUP).enumerate() {
                for (shown, &index) in shown.iter_mut().zip(indices) {
                    shown[group] = if index == NO_POINT { [0.0; 3] } else { points[index as usize] };
                }
            }
            for (k, points) in shown.iter().enumerate() {
                let inside = k * part + PAD_GROUPS..k * part + PAD_GROUPS + groups;
                dispatch(Fill {
                    points,
                    axes: &axes[k],
                    height,
                    inverse: &mut inverse[inside.clone()],
                    across: &mut across[inside.clone()],
                    rise: &mut rise[inside],
                });
            }
            for plane in [&mut *inverse, &mut *across, rise] {
                wrap(plane, columns);
            }
            for (k, centres) in FITTED.into_iter().zip(centres.chunks_exact_mut(part)) {
                let [left, own, right] = [-1, 0, 1].map(|offset| beside(inverse, k as isize + offset));
                dispatch(FillGaps { left, own, right, centres: &mut centres[1..part - 1] });
            }
            for k in 0..GROUP as isize {
                let [before, here, after] = [-1, 0, 1].map(|offset| beside(inverse, k + offset));
                let inner = k as usize * part + 1..(k as usize + 1) * part - 1;
                dispatch(Centre { before, here, after, across: &across[inner.clone()], per_step, centred: &mut centred[inner] });
            }
        });
    }

    /// Standard deviation of the range, metres, from a low quantile of second differences, which excludes edges and rough surfaces.
    ///
    /// Along rows the differences contain the noise of each laser, down columns also the biases between lasers and what an imperfect undistortion leaves. A plane
    /// fit is affected by all of these.
    pub(super) fn range_noise(&self) -> f32 {
        /// Larger deviations are not noise but rough surfaces.
        const WORST: f32 = 0.03;
        let along = |row, column: isize| self.deviation([-1, 0, 1].map(|k| self.at(row, column + k)), 0.5);
        let down = |row: usize, column: isize| {
            let (above, below) = (row.checked_sub(1)?, Some(row + 1).filter(|&row| row < self.rows)?);
            let [above, here, below] = [above, row, below].map(|row| self.at(row, column));
            let share = (self.rise[here] - self.rise[below]) / (self.rise[above] - self.rise[below]).max(1e-4);
            self.deviation([above, here, below], share.clamp(0.0, 1.0))
        };
        let (along, down) = rayon::join(|| self.quantile_of(along), || self.quantile_of(down));
        // From that quantile of |x| of a normal distribution; 1.5 is the variance of (1 - 2 + 1) / 2.
        let to_sigma = 1.0 / (QUANTILE_OF_NORMAL * 1.5f32.sqrt());
        match (along, down) {
            (Some(along), Some(down)) => (along.max(down) * to_sigma).min(WORST),
            (Some(one), None) | (None, Some(one)) => (one * to_sigma).min(WORST),
            (None, None) => WORST,
        }
    }

    /// A low quantile of a deviation over pixels spread over the image; `None` if there are too few.
    fn quantile_of(&self, deviation: impl Fn(usize, isize) -> Option<f32>) -> Option<f32> {
        /// Enough samples for an accuracy of a few per cent.
        const SAMPLES: usize = 3072;
        let pixels = self.rows * self.columns;
        let stride = (pixels / SAMPLES).max(1) | 1;
        let mut deviations: Vec<f32> =
            (0..pixels).step_by(stride).filter_map(|pixel| deviation(pixel / self.columns, (pixel % self.columns) as isize)).collect();
        let place = (deviations.len() as f32 * QUANTILE) as usize;
        (deviations.len() >= 32).then(|| *deviations.select_nth_unstable_by(place, f32::total_cmp).1)
    }

    /// Deviation of a pixel's range from the straight line between two neighbours, metres; `share` is the weight of the first one.
    fn deviation(&self, [before, here, after]: [usize; 3], share: f32) -> Option<f32> {
        let [w_before, w, w_after] = [before, here, after].map(|k| self.centred[k]);
        if w_before == 0.0 || w == 0.0 || w_after == 0.0 {
            return None;
        }
        let ray = (1.0 + self.across[here] * self.across[here] + self.rise[here] * self.rise[here]).sqrt();
        Some((share * w_before + (1.0 - share) * w_after - w).abs() / (w * w) * ray)
    }

    /// Computes the links for a range noise in metres, and removes those across the `seam`.
    pub(super) fn link(&mut self, noise: f32, seam: Option<&Seam<'_>>) {
        let Self { rows, columns, part, .. } = *self;
        let (inverse, centred, rise) = (&self.inverse, &self.centred, &self.rise);
        let inside = |r: isize, k: usize| {
            let start = (r.clamp(0, rows as isize - 1) as usize * GROUP + k) * part;
            start + PAD_GROUPS..start + part - PAD_GROUPS
        };
        let links =
            (self.link_right.par_chunks_mut(GROUP * part), self.link_down.par_chunks_mut(FITTED.len() * part), inverse.par_chunks(GROUP * part));
        links.into_par_iter().with_min_len(ROWS_PER_TASK).enumerate().for_each(|(r, (right, down, here))| {
            for (k, link) in right.chunks_exact_mut(part).enumerate() {
                let inverse = [-2, -1, 0, 1, 2, 3].map(|offset| beside(here, k as isize + offset));
                dispatch(LinkRight { inverse, noise, link: &mut link[1..part - 1] });
            }
            if r + 1 < rows {
                for (k, link) in FITTED.into_iter().zip(down.chunks_exact_mut(part)) {
                    let [inverse, rise] = [&centred, &rise].map(|plane| [-2, -1, 0, 1, 2, 3].map(|offset| &plane[inside(r as isize + offset, k)]));
                    dispatch(LinkDown { inverse, rise, noise, link: &mut link[PAD_GROUPS..part - PAD_GROUPS] });
                }
            }
            if let Some(seam) = seam {
                seam.cut([r, r], 1, |column| right[place(part, column as isize)] = 0.0);
                wrap(right, columns);
                let is_fitted = |column: usize| FITTED.iter().position(|&k| column % GROUP == k);
                seam.cut([r, (r + 1).min(rows - 1)], 0, |column| {
                    is_fitted(column).into_iter().for_each(|k| down[k * part + PAD_GROUPS + column / GROUP] = 0.0);
                });
            }
        });
    }
}

/// Position of a column, from -`PAD` on, in a row of `GROUP` parts.
#[inline(always)]
fn place(part: usize, column: isize) -> usize {
    let column = (column + PAD as isize) as usize;
    (column % GROUP) * part + column / GROUP
}

/// The pixels of the columns of number `k` in their groups, but for the first and the last; a `k` outside of a group is of the groups before or after.
#[inline(always)]
fn beside(row: &[f32], k: isize) -> &[f32] {
    let part = row.len() / GROUP;
    let start = k.rem_euclid(GROUP as isize) as usize * part + (1 + k.div_euclid(GROUP as isize)) as usize;
    &row[start..start + part - 2]
}

/// Repeats the ends of a padded row.
fn wrap(row: &mut [f32], columns: usize) {
    let part = row.len() / GROUP;
    for i in 0..PAD {
        row[place(part, -1 - i as isize)] = row[place(part, (columns - 1 - i % columns) as isize)];
        row[place(part, (columns + i) as isize)] = row[place(part, (i % columns) as isize)];
    }
}

struct Fill<'a> {
    points: &'a [[f32; 3]],
    axes: &'a [[f32; 2]],
    height: f32,
    inverse: &'a mut [f32],
    across: &'a mut [f32],
    rise: &'a mut [f32],
}

impl Kernel for Fill<'_> {
    #[inline(always)]
    fn run(self) {
        /// Points nearer to the axis than this are behind or beside their pixel, metres.
        const NEAREST: f32 = 1e-3;
        let count = self.points.len().min(self.axes.len()).min(self.inverse.len()).min(self.across.len()).min(self.rise.len());
        for i in 0..count {
            let (p, [cos, sin]) = (self.points[i], self.axes[i]);
            let x = p[0] * cos + p[1] * sin;
            let y = p[1] * cos - p[0] * sin;
            let is_ahead = x > NEAREST;
            let inverse = 1.0 / if is_ahead { x } else { 1.0 };
            self.inverse[i] = if is_ahead { inverse } else { 0.0 };
            self.across[i] = if is_ahead { y * inverse } else { 0.0 };
            self.rise[i] = if is_ahead { (p[2] - self.height) * inverse } else { 0.0 };
        }
    }
}

/// Chooses the inverse depths that planes are fitted around.
struct FillGaps<'a> {
    left: &'a [f32],
    own: &'a [f32],
    right: &'a [f32],
    centres: &'a mut [f32],
}

impl Kernel for FillGaps<'_> {
    #[inline(always)]
    fn run(self) {
        let count = self.centres.len();
        let (left, own, right) = (&self.left[..count], &self.own[..count], &self.right[..count]);
        for i in 0..count {
            let (l, o, r) = (left[i], own[i], right[i]);
            let beside = if r > 0.0 { r } else { l };
            self.centres[i] = if o > 0.0 { o } else { beside };
        }
    }
}
