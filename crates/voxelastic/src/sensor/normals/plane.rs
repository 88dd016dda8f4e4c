//! From sums to planes, and the tests that accept or reject them.

use super::covariance::{ColumnSums, Place, Width};
use super::settings::{FITTED, GROUP, LANES, NormalSettings, STRIP};
use crate::simd::Kernel;
use crate::simd::larger;
use rayon::prelude::*;

/// Planes of one row of a strip, at one column of each group.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct PlaneRow {
    /// Unit normal towards the sensor, lidar frame.
    pub(super) normal: [[f32; LANES]; 3],
    /// Distance of the plane from the beams' origin, metres.
    pub(super) distance: [f32; LANES],
    /// Standard deviation of the neighbours along the normal, metres; negative where there is none.
    pub(super) roughness: [f32; LANES],
    /// Inverse depth where the plane was fitted, 1/m; 0 where there is no point.
    pub(super) inverse: [f32; LANES],
}

impl PlaneRow {
    pub(super) const NONE: Self = Self { normal: [[0.0; LANES]; 3], distance: [0.0; LANES], roughness: [-1.0; LANES], inverse: [0.0; LANES] };
}

/// The plane at a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Plane {
    /// Unit normal towards the sensor, lidar frame.
    pub(super) normal: [f32; 3],
    /// Distance from the beams' origin, metres.
    pub(super) distance: f32,
    /// Standard deviation of the neighbours along the normal, metres.
    pub(super) roughness: f32,
    /// Inverse depth where it was fitted, 1/m.
    pub(super) inverse: f32,
}

/// Planes of one row of a strip, at all columns that are fitted.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct PlaneStrip {
    planes: [[Plane; LANES]; FITTED.len()],
    /// Whether there is a plane: a bit for each lane, of the first fitted columns in the low half.
    accepted: u32,
}

impl PlaneStrip {
    const NONE: Self = Self { planes: [[Plane { normal: [0.0; 3], distance: 0.0, roughness: 0.0, inverse: 0.0 }; LANES]; FITTED.len()], accepted: 0 };

    /// Removes all planes.
    pub(super) fn clear(&mut self) {
        self.accepted = 0;
    }

    /// Stores those of the `which`-th fitted column of each group.
    pub(super) fn store(&mut self, which: usize, row: &PlaneRow) {
        let planes = &mut self.planes[which];
        let mut accepted = 0;
        for (l, plane) in planes.iter_mut().enumerate() {
            let normal = [row.normal[0][l], row.normal[1][l], row.normal[2][l]];
            *plane = Plane { normal, distance: row.distance[l], roughness: row.roughness[l], inverse: row.inverse[l] };
            accepted |= u32::from(row.roughness[l] >= 0.0) << l;
        }
        self.accepted |= accepted << (which * LANES);
    }
}

/// Planes of an image: row by row, and within a row strip by strip.
#[derive(Clone, Debug, Default)]
pub(super) struct Planes {
    strips: usize,
    rows: Vec<PlaneStrip>,
    /// Copy of what is accepted in `rows`. Fits the first-level cache, unlike the planes, so searches look here first.
    accepted: Vec<u32>,
}

/// The planes that are nearest to a pixel along its row.
#[derive(Clone, Copy)]
pub(super) struct Nearest<'a> {
    planes: &'a [[Plane; LANES]; FITTED.len()],
    lane: usize,
    /// Which of the fitted columns of the group is nearer, and whether there is a plane at it and at the other.
    which: usize,
    has: [bool; 2],
}

impl<'a> Nearest<'a> {
    /// The nearest plane, if there is one in the pixel's group.
    #[inline(always)]
    pub(super) fn plane(&self) -> Option<&'a Plane> {
        let which = if self.has[0] { self.which } else { 1 - self.which };
        (self.has[0] | self.has[1]).then(|| &self.planes[which][self.lane])
    }

    /// The plane that was fitted nearest to the pixel, if that is accepted.
    #[cfg(test)]
    pub(super) fn own(&self) -> Option<&'a Plane> {
        self.has[0].then(|| &self.planes[self.which][self.lane])
    }

    /// The other one, if there are two.
    #[inline(always)]
    pub(super) fn other(&self) -> Option<&'a Plane> {
        (self.has[0] & self.has[1]).then(|| &self.planes[1 - self.which][self.lane])
    }
}

impl Planes {
    pub(super) fn reset(&mut self, rows: usize, strips: usize) {
        self.strips = strips;
        self.rows.resize(rows * strips, PlaneStrip::NONE);
    }

    /// The planes of `per_task` neighbouring strips for each task, a slice for each row.
    pub(super) fn split(&mut self, per_task: usize) -> Vec<Vec<&mut [PlaneStrip]>> {
        let mut tasks: Vec<Vec<&mut [PlaneStrip]>> = (0..self.strips.div_ceil(per_task)).map(|_| Vec::new()).collect();
        for row in self.rows.chunks_exact_mut(self.strips) {
            row.chunks_mut(per_task).zip(&mut tasks).for_each(|(part, task)| task.push(part));
        }
        tasks
    }

    /// Updates what is known of which pixels have a plane, after all are fitted.
    pub(super) fn update_mask(&mut self) {
        self.rows.par_iter().with_min_len(1024).map(|strip| strip.accepted).collect_into_vec(&mut self.accepted);
    }

    /// Columns from one fitted column to the next around a pixel, as of the last [`update_mask`](Self::update_mask).
    #[inline(always)]
    pub(super) fn spacing(&self, row: usize, column: usize) -> usize {
        if self.accepted[row * self.strips + column / STRIP] >> LANES == 0 { GROUP } else { GROUP / FITTED.len() }
    }

    /// The planes next to a pixel, as of the last [`update_mask`](Self::update_mask).
    #[inline(always)]
    pub(super) fn nearest(&self, row: usize, column: usize) -> Nearest<'_> {
        let (at, lane, which) = (row * self.strips + column / STRIP, column % STRIP / GROUP, column % GROUP / FITTED.len());
        let accepted = self.accepted[at] >> lane;
        let has = |which: usize| accepted >> (which * LANES) & 1 == 1;
        Nearest { planes: &self.rows[at].planes, lane, which, has: [has(which), has(1 - which)] }
    }
}

/// Sums up and solves the systems of one row of a strip.
pub(super) struct Solve<'a> {
    pub(super) windows: ColumnSums<'a>,
    pub(super) settings: &'a NormalSettings,
    pub(super) noise: f32,
    pub(super) planes: &'a mut PlaneRow,
}

impl Kernel for Solve<'_> {
    /// Deviations in a wide window must be explained by the range noise; in a narrow one, used where the wide one gives no plane, they may also be as large as the
    /// roughness that the settings allow.
    #[inline(always)]
    fn run(self) {
        /// A plane and its residual need this many samples.
        const LEAST_SAMPLES: f32 = 6.0;
        /// Any two rows of pixels lie on a plane, even a rail and the wall behind it. Rays graze such a plane, so a third row is required where the sine of the angle
        /// between ray and plane is less than this.
        const GRAZING: f32 = 0.05;
        const LEAST_ROWS: f32 = 3.0;
        /// Noise differs over a scan: a variance larger than its median by this factor still counts as noise.
        const SLACK: f32 = 1.5;
        let ColumnSums { grid, place: Place { row, strip, fitted }, width, .. } = self.windows;
        let (sums, rows) = self.windows.sum();
        // Local copies, which cannot alias the output: only then is the loop vectorised.
        let (centre, axes) = (*grid.row(row).centres((strip, fitted)), *grid.axes((strip, fitted)));
        let mut out = PlaneRow::NONE;
        let row_rise = grid.row_rise[row];
        let ray2 = 1.0 + row_rise * row_rise;
        let ray = ray2.sqrt();
        let noise2 = self.noise * self.noise / ray2;
        let most = self.settings.max_uncertainty;
        let most_rough = if width == Width::Narrow { self.settings.roughness } else { 0.0 };
        for l in 0..LANES {
            let n = sums.n[l];
            let per_n = 1.0 / larger(n, 1.0);
            let (mx, mt, mu) = (sums.x[l] * per_n, sums.t[l] * per_n, sums.u[l] * per_n);
            let (xx, xt, tt) = (sums.xx[l] - sums.x[l] * mx, sums.xt[l] - sums.x[l] * mt, sums.tt[l] - sums.t[l] * mt);
            let (xu, tu, uu) = (sums.xu[l] - sums.x[l] * mu, sums.tu[l] - sums.t[l] * mu, sums.uu[l] - sums.u[l] * mu);
            let determinant = xx * tt - xt * xt;
            let solvable = (n >= LEAST_SAMPLES) & (determinant > 0.05 * xx * tt);
            let per_det = 1.0 / if solvable { determinant } else { 1.0 };
            let b = (xu * tt - tu * xt) * per_det;
            let c = (tu * xx - xu * xt) * per_det;
            let level = mu - b * mx - c * mt;
            let a = centre[l] + level - c * row_rise;
            let length2 = larger(a * a + b * b + c * c, f32::MIN_POSITIVE);
            let per_length = 1.0 / length2.sqrt();
            let freedom = larger(n - 3.0, 1.0);
            let variance = larger(uu - b * xu - c * tu, 0.0) / freedom;
            // Variance that range noise alone explains, in inverse depth.
            let inverse = centre[l] + mu;
            let square = inverse * inverse;
            let expected = noise2 * square * square;
            // Three standard deviations of the sample variance.
            let spread = SLACK + 3.0 * (2.0 / freedom).sqrt();
            let to_normal = per_length / larger(inverse, f32::MIN_POSITIVE);
            let along_normal = variance * to_normal * to_normal;
            let is_flat = (variance <= expected * spread) | (along_normal <= most_rough * most_rough);
            let uncertainty = larger(expected, variance) * per_det * (tt + xx * ray2) / length2;
            let has_rows = (rows[l] >= LEAST_ROWS) | (per_length * inverse >= GRAZING * ray);
            let accepted = solvable & has_rows & is_flat & (uncertainty <= most * most) & (centre[l] > 0.0);
            let [cos, sin] = axes[l];
            out.normal[0][l] = (b * sin - a * cos) * per_length;
            out.normal[1][l] = -(a * sin + b * cos) * per_length;
            out.normal[2][l] = -c * per_length;
            out.distance[l] = per_length;
            out.inverse[l] = centre[l];
            out.roughness[l] = if accepted { along_normal.sqrt() } else { -1.0 };
        }
        match width {
            Width::Wide => *self.planes = out,
            Width::Narrow => self.planes.fill_gaps(&out),
        }
    }
}

impl PlaneRow {
    /// Copies the planes of `other` where this row has none.
    #[inline(always)]
    fn fill_gaps(&mut self, other: &Self) {
        for l in 0..LANES {
            let gap = self.roughness[l] < 0.0;
            let pick = |mine: &mut f32, theirs: f32| *mine = if gap { theirs } else { *mine };
            for k in 0..3 {
                pick(&mut self.normal[k][l], other.normal[k][l]);
            }
            pick(&mut self.distance[l], other.distance[l]);
            pick(&mut self.roughness[l], other.roughness[l]);
        }
    }

    /// Whether a pixel with a point has no plane yet.
    #[inline(always)]
    pub(super) fn has_gaps(&self) -> bool {
        self.roughness.iter().zip(&self.inverse).fold(false, |any, (&r, &w)| any | ((r < 0.0) & (w > 0.0)))
    }
}
