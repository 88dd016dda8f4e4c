//! The range image in the coordinates of the plane fit, and the links between pixels of one surface.

use super::settings::STRIP;
use super::sweep_seam::Seam;
use crate::sensor::beam_model::BeamModel;
use crate::sensor::range_image::{NO_POINT, RangeImage};
use crate::simd::{Kernel, dispatch};
use crate::simd::{larger, smaller};
use rayon::prelude::*;

/// Columns repeated beyond both ends of a row, so that windows need not wrap: at least the largest window, and two more for the differences at its ends.
pub(super) const PAD: usize = 16;

/// Least rows of one task: fewer are not worth the overhead.
const ROWS_PER_TASK: usize = 4;

/// A surface ends at differences against the trend of more than this many standard deviations of the range noise.
const JUMP_SIGMAS: f32 = 5.0;

/// Quantile of the second differences from which the range noise is estimated, and the value of that quantile of |x| of a normal distribution.
const QUANTILE: f32 = 0.35;
const QUANTILE_OF_NORMAL: f32 = 0.4538;

/// Per pixel, with `PAD` wrapped columns on both sides of each row (and zeros up to whole strips): the point in the frame of its column (X along the
/// column's azimuth, Y to the left, Z up from the beams' origin).
#[derive(Clone, Debug, Default)]
pub(super) struct Grid {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) stride: usize,
    /// 1 / X; 0 where there is no point.
    pub(super) inverse: Vec<f32>,
    /// Y / X.
    pub(super) across: Vec<f32>,
    /// Z / X.
    pub(super) rise: Vec<f32>,
    /// `inverse` interpolated to the pixel's centre: rows are staggered, and projected points are off the centre.
    centred: Vec<f32>,
    /// 1 where the pixel and the next in the row are on one surface, else 0. A single pixel without a point belongs to the surface that continues beyond it, also
    /// down the column.
    pub(super) link_right: Vec<f32>,
    /// 1 where the pixel and the one below are on one surface, else 0.
    pub(super) link_down: Vec<f32>,
    /// Cosine and sine of each column's azimuth.
    pub(super) axes: Vec<[f32; 2]>,
    pub(super) height: f32,
    /// 1 / (signed angle between columns).
    per_step: f32,
    /// Tangent of each row's elevation.
    pub(super) row_rise: Vec<f32>,
}

impl Grid {
    pub(super) fn new(model: &BeamModel) -> Self {
        let first = model.azimuth(0.0, 0.0) as f64;
        let step = (model.azimuth(0.0, 1.0) - model.azimuth(0.0, 0.0)) as f64;
        let step = step.signum() * std::f64::consts::TAU / model.columns() as f64;
        let whole_strips = model.columns().next_multiple_of(STRIP);
        let axes = (0..whole_strips).map(|c| (first + c as f64 * step).sin_cos()).map(|(s, c)| [c as f32, s as f32]).collect();
        let row_rise = model.elevations().iter().map(|e| e.clamp(-1.55, 1.55).tan()).collect();
        let (rows, columns) = (model.rows(), model.columns());
        let stride = whole_strips + 2 * PAD;
        let plane = || vec![0f32; rows * stride];
        Self {
            rows,
            columns,
            stride,
            inverse: plane(),
            across: plane(),
            rise: plane(),
            centred: plane(),
            link_right: plane(),
            link_down: plane(),
            axes,
            height: model.origin_height(),
            per_step: (1.0 / step) as f32,
            row_rise,
        }
    }

    /// Position of a pixel in the padded planes.
    #[inline(always)]
    pub(super) fn at(&self, row: usize, column: usize) -> usize {
        row * self.stride + PAD + column
    }

    /// Copies the points that the pixels of `image` show.
    pub(super) fn fill(&mut self, points: &[[f32; 3]], image: &RangeImage) {
        let Self { columns, stride, height, per_step, .. } = *self;
        let axes = &self.axes[..columns];
        let planes = (
            self.inverse.par_chunks_mut(stride),
            self.across.par_chunks_mut(stride),
            self.rise.par_chunks_mut(stride),
            self.centred.par_chunks_mut(stride),
            image.points.par_chunks(columns),
        );
        let shown = || vec![[0f32; 3]; columns];
        planes.into_par_iter().with_min_len(ROWS_PER_TASK).for_each_init(shown, |shown, (inverse, across, rise, centred, indices)| {
            for (p, &index) in shown.iter_mut().zip(indices) {
                *p = if index == NO_POINT { [0.0; 3] } else { points[index as usize] };
            }
            let inside = PAD..PAD + columns;
            dispatch(Fill {
                points: shown,
                axes,
                height,
                inverse: &mut inverse[inside.clone()],
                across: &mut across[inside.clone()],
                rise: &mut rise[inside],
            });
            for plane in [&mut *inverse, &mut *across, rise] {
                wrap(plane, columns);
            }
            dispatch(Centre { inverse, across, per_step, centred });
        });
    }

    /// Standard deviation of the range, metres, from a low quantile of second differences, which excludes edges and rough surfaces.
    ///
    /// Along rows the differences contain the noise of each laser, down columns also the biases between lasers and what an imperfect undistortion leaves. A plane
    /// fit is affected by all of these.
    pub(super) fn range_noise(&self) -> f32 {
        /// Larger deviations are not noise but rough surfaces.
        const WORST: f32 = 0.03;
        let along = |row, column| {
            let i = self.at(row, column);
            self.deviation([i - 1, i, i + 1], 0.5)
        };
        let down = |row, column| {
            let i = self.at(row, column);
            let [above, below] = [i.checked_sub(self.stride)?, i + self.stride];
            let (rise_above, rise_below) = (self.rise[above], *self.rise.get(below)?);
            let share = (self.rise[i] - rise_below) / (rise_above - rise_below).max(1e-4);
            self.deviation([above, i, below], share.clamp(0.0, 1.0))
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
    fn quantile_of(&self, deviation: impl Fn(usize, usize) -> Option<f32>) -> Option<f32> {
        /// Enough samples for an accuracy of a few per cent.
        const SAMPLES: usize = 3072;
        let pixels = self.rows * self.columns;
        let stride = (pixels / SAMPLES).max(1) | 1;
        let mut deviations: Vec<f32> =
            (0..pixels).step_by(stride).filter_map(|pixel| deviation(pixel / self.columns, pixel % self.columns)).collect();
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
        let Self { rows, columns, stride, .. } = *self;
        let (inverse, centred, rise) = (&self.inverse, &self.centred, &self.rise);
        let row = |r: isize| {
            let r = r.clamp(0, rows as isize - 1) as usize;
            r * stride + PAD..(r + 1) * stride - PAD
        };
        let links = (self.link_right.par_chunks_mut(stride), self.link_down.par_chunks_mut(stride), inverse.par_chunks(stride));
        links.into_par_iter().with_min_len(ROWS_PER_TASK).enumerate().for_each(|(r, (right, down, here))| {
            dispatch(LinkRight { inverse: here, noise, link: right });
            if r + 1 < rows {
                let inverse = [-2, -1, 0, 1, 2, 3].map(|k| &centred[row(r as isize + k)]);
                let rise = [-2, -1, 0, 1, 2, 3].map(|k| &rise[row(r as isize + k)]);
                dispatch(LinkDown { inverse, rise, noise, link: &mut down[PAD..stride - PAD] });
            }
            if let Some(seam) = seam {
                seam.cut(&mut right[PAD..], [r, r], 1);
                seam.cut(&mut down[PAD..], [r, (r + 1).min(rows - 1)], 0);
                wrap(right, columns);
            }
            wrap(down, columns);
        });
    }
}

/// Repeats the ends of a padded row.
fn wrap(row: &mut [f32], columns: usize) {
    for i in 0..PAD {
        row[PAD - 1 - i] = row[PAD + columns - 1 - i % columns];
        row[PAD + columns + i] = row[PAD + i % columns];
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

/// The middle one of three.
#[inline(always)]
fn median(a: f32, b: f32, c: f32) -> f32 {
    larger(smaller(a, b), smaller(larger(a, b), c))
}

/// 1 if the step from `here` to `next` differs from the median of it and the steps before and after by no more than the noise.
///
/// On a plane the steps of the inverse depth are equal. At a crease they change once, and the middle one is still the median. Only at a jump the middle step differs
/// from both others.
#[inline(always)]
fn linked(here: f32, next: f32, steps: [f32; 3], noise: f32) -> f32 {
    let nearer = larger(here, next);
    let jump = (steps[1] - median(steps[0], steps[1], steps[2])).abs();
    let both = (here > 0.0) & (next > 0.0);
    if both & (jump <= JUMP_SIGMAS * noise * nearer * nearer) { 1.0 } else { 0.0 }
}

#[inline(always)]
fn step(from: f32, to: f32) -> f32 {
    if (from > 0.0) & (to > 0.0) { to - from } else { 0.0 }
}

/// As [`linked`] for the pixels before and after an empty one: 1 if the surface continues beyond it.
#[inline(always)]
fn bridged(w: [f32; 5], noise: f32) -> f32 {
    let [first, before, here, after, last] = w;
    if here > 0.0 { 0.0 } else { linked(before, after, [2.0 * step(first, before), step(before, after), 2.0 * step(after, last)], noise) }
}

struct LinkRight<'a> {
    inverse: &'a [f32],
    noise: f32,
    link: &'a mut [f32],
}

impl Kernel for LinkRight<'_> {
    #[inline(always)]
    fn run(self) {
        let (w, n, noise) = (self.inverse, self.inverse.len(), self.noise);
        let link = &mut self.link[2..n - 3];
        let [a, b, c, d, e, f] = [0, 1, 2, 3, 4, 5].map(|k| &w[k..n - 5 + k]);
        for i in 0..link.len() {
            let steps = [step(b[i], c[i]), step(c[i], d[i]), step(d[i], e[i])];
            let direct = linked(c[i], d[i], steps, noise);
            let over_this = bridged([a[i], b[i], c[i], d[i], e[i]], noise);
            let over_next = bridged([b[i], c[i], d[i], e[i], f[i]], noise);
            link[i] = larger(direct, larger(over_this, over_next));
        }
    }
}

struct Centre<'a> {
    inverse: &'a [f32],
    across: &'a [f32],
    per_step: f32,
    centred: &'a mut [f32],
}

impl Kernel for Centre<'_> {
    /// Interpolates each inverse depth to its pixel's centre by the smaller of the slopes to both sides.
    #[inline(always)]
    fn run(self) {
        let n = self.inverse.len();
        let (before, here, after) = (&self.inverse[..n - 2], &self.inverse[1..n - 1], &self.inverse[2..n]);
        let across = &self.across[1..n - 1];
        let centred = &mut self.centred[1..n - 1];
        for i in 0..centred.len() {
            let (left, right) = (step(before[i], here[i]), step(here[i], after[i]));
            let gentle = median(left, right, 0.0) * self.per_step;
            centred[i] = larger(here[i] - gentle * across[i], 0.0);
        }
    }
}

struct LinkDown<'a> {
    /// The rows from two above to three below.
    inverse: [&'a [f32]; 6],
    rise: [&'a [f32]; 6],
    noise: f32,
    link: &'a mut [f32],
}

impl<'a> Kernel for LinkDown<'a> {
    #[inline(always)]
    fn run(self) {
        let noise = self.noise;
        for (strip, link) in self.link.chunks_exact_mut(STRIP).enumerate() {
            let chunk = |row: usize, planes: &[&'a [f32]; 6]| planes[row][strip * STRIP..].first_chunk::<STRIP>();
            let six =
                |planes| Some([chunk(0, planes)?, chunk(1, planes)?, chunk(2, planes)?, chunk(3, planes)?, chunk(4, planes)?, chunk(5, planes)?]);
            let (Some(w), Some(t)) = (six(&self.inverse), six(&self.rise)) else { return };
            // A local copy: it cannot alias the inputs, so the loop is vectorised.
            let mut links = [0f32; STRIP];
            for i in 0..STRIP {
                let at = |k: usize| (w[k][i], t[k][i]);
                let direct = linked_down([at(1), at(2), at(3), at(4)], noise);
                // Over an empty pixel: between the neighbours of the gap.
                let over_this = linked_down([at(0), at(1), at(3), at(4)], noise);
                let over_next = linked_down([at(1), at(2), at(4), at(5)], noise);
                let over = if w[2][i] > 0.0 { over_next } else { over_this };
                links[i] = if (w[2][i] > 0.0) & (w[3][i] > 0.0) { direct } else { over };
            }
            link.copy_from_slice(&links);
        }
    }
}

/// As [`linked`], for rows that are not evenly spaced: four pairs of inverse depth and rise, of which the middle two may be linked.
#[inline(always)]
fn linked_down([before, here, next, after]: [(f32, f32); 4], noise: f32) -> f32 {
    /// Rows that noise has brought closer than this are not divided by.
    const LEAST_FALL: f32 = 1e-4;
    let fall = |a: (f32, f32), b: (f32, f32)| larger(a.1 - b.1, LEAST_FALL);
    let middle = fall(here, next);
    let steps = [step(before.0, here.0) * (middle / fall(before, here)), step(here.0, next.0), step(next.0, after.0) * (middle / fall(next, after))];
    linked(here.0, next.0, steps, noise)
}
