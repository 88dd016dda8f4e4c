//! From sums to planes, and the tests that accept or reject them.

use super::covariance::{ColumnSums, Width};
use super::settings::{NormalSettings, STRIP};
use crate::simd::Kernel;
use crate::simd::larger;
use rayon::prelude::*;

/// Planes of one row of a strip.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct PlaneRow {
    /// Unit normal towards the sensor, lidar frame.
    pub(super) normal: [[f32; STRIP]; 3],
    /// Distance of the plane from the beams' origin, metres.
    pub(super) distance: [f32; STRIP],
    /// Standard deviation of the neighbours along the normal, metres; negative where there is none.
    pub(super) roughness: [f32; STRIP],
    /// How far off the plane the pixel's own point is, in standard deviations.
    pub(super) misfit: [f32; STRIP],
}

impl PlaneRow {
    pub(super) const NONE: Self = Self { normal: [[0.0; STRIP]; 3], distance: [0.0; STRIP], roughness: [-1.0; STRIP], misfit: [0.0; STRIP] };
}

/// Planes of all pixels: row by row, and within a row strip by strip.
#[derive(Clone, Debug, Default)]
pub(super) struct Planes {
    strips: usize,
    rows: Vec<PlaneRow>,
    /// A bit for each lane of `rows`: whether there is a plane. Fits the first-level cache, unlike the planes, so searches test it first.
    accepted: Vec<u32>,
}

/// The plane at a pixel.
#[derive(Clone, Copy)]
pub(super) struct Plane<'a> {
    lanes: &'a PlaneRow,
    l: usize,
}

impl Plane<'_> {
    /// Unit normal towards the sensor, lidar frame.
    #[inline(always)]
    pub(super) fn normal(&self) -> [f32; 3] {
        let n = &self.lanes.normal;
        [n[0][self.l], n[1][self.l], n[2][self.l]]
    }

    /// Distance from the beams' origin, metres.
    #[inline(always)]
    pub(super) fn distance(&self) -> f32 {
        self.lanes.distance[self.l]
    }

    /// Standard deviation of the neighbours along the normal, metres; negative where there is none.
    #[inline(always)]
    pub(super) fn roughness(&self) -> f32 {
        self.lanes.roughness[self.l]
    }

    /// How far off the plane the pixel's own point is, in standard deviations.
    #[inline(always)]
    pub(super) fn misfit(&self) -> f32 {
        self.lanes.misfit[self.l]
    }
}

impl Planes {
    pub(super) fn reset(&mut self, rows: usize, strips: usize) {
        self.strips = strips;
        self.rows.resize(rows * strips, PlaneRow::NONE);
    }

    /// The planes of `per_task` neighbouring strips for each task, a slice for each row.
    pub(super) fn split(&mut self, per_task: usize) -> Vec<Vec<&mut [PlaneRow]>> {
        let mut tasks: Vec<Vec<&mut [PlaneRow]>> = (0..self.strips.div_ceil(per_task)).map(|_| Vec::new()).collect();
        for row in self.rows.chunks_exact_mut(self.strips) {
            row.chunks_mut(per_task).zip(&mut tasks).for_each(|(part, task)| task.push(part));
        }
        tasks
    }

    /// Updates the mask of pixels with a plane, after all are fitted.
    pub(super) fn update_mask(&mut self) {
        let bits = |row: &PlaneRow| (0..STRIP).fold(0, |bits, l| bits | (u32::from(row.roughness[l] >= 0.0) << l));
        self.rows.par_iter().with_min_len(256).map(bits).collect_into_vec(&mut self.accepted);
    }

    /// Whether a pixel has a plane, as of the last [`update_mask`](Self::update_mask).
    #[inline(always)]
    pub(super) fn has(&self, row: usize, column: usize) -> bool {
        self.accepted[row * self.strips + column / STRIP] >> (column % STRIP) & 1 == 1
    }

    /// The plane at a pixel, accepted or not.
    #[inline(always)]
    pub(super) fn at(&self, row: usize, column: usize) -> Plane<'_> {
        Plane { lanes: &self.rows[row * self.strips + column / STRIP], l: column % STRIP }
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
        let ColumnSums { grid, row, first_column, width, .. } = self.windows;
        let (sums, rows) = self.windows.sum();
        let at = grid.at(row, first_column);
        // Local copies, which cannot alias the output: only then is the loop vectorised.
        let (centre, across, rise) = (chunk(&grid.inverse[at..]), chunk(&grid.across[at..]), chunk(&grid.rise[at..]));
        let axes = chunk(&grid.axes[first_column..]);
        let mut out = PlaneRow::NONE;
        let row_rise = grid.row_rise[row];
        let ray2 = 1.0 + row_rise * row_rise;
        let noise2 = self.noise * self.noise / ray2;
        let most = self.settings.max_uncertainty;
        let most_rough = if width == Width::Narrow { self.settings.roughness } else { 0.0 };
        for l in 0..STRIP {
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
            let ray = (1.0 + across[l] * across[l] + rise[l] * rise[l]).sqrt();
            let has_rows = (rows[l] >= LEAST_ROWS) | (per_length * inverse >= GRAZING * ray);
            let accepted = solvable & has_rows & is_flat & (uncertainty <= most * most) & (centre[l] > 0.0);
            let off = level + b * across[l] + c * (rise[l] - row_rise);
            let [cos, sin] = axes[l];
            out.normal[0][l] = (b * sin - a * cos) * per_length;
            out.normal[1][l] = -(a * sin + b * cos) * per_length;
            out.normal[2][l] = -c * per_length;
            out.distance[l] = per_length;
            out.misfit[l] = off.abs() / larger(larger(expected, variance), f32::MIN_POSITIVE).sqrt();
            out.roughness[l] = if accepted { along_normal.sqrt() } else { -1.0 };
        }
        match width {
            Width::Wide => *self.planes = out,
            Width::Narrow => self.planes.fill_gaps(&out),
        }
    }
}

/// The first lanes of a slice.
#[inline(always)]
fn chunk<T: Copy + Default>(slice: &[T]) -> [T; STRIP] {
    slice.first_chunk().copied().unwrap_or([T::default(); STRIP])
}

impl PlaneRow {
    /// Copies the planes of `other` where this row has none.
    #[inline(always)]
    fn fill_gaps(&mut self, other: &Self) {
        for l in 0..STRIP {
            let gap = self.roughness[l] < 0.0;
            let pick = |mine: &mut f32, theirs: f32| *mine = if gap { theirs } else { *mine };
            for k in 0..3 {
                pick(&mut self.normal[k][l], other.normal[k][l]);
            }
            pick(&mut self.distance[l], other.distance[l]);
            pick(&mut self.misfit[l], other.misfit[l]);
            pick(&mut self.roughness[l], other.roughness[l]);
        }
    }

    /// Whether a pixel with a point has no plane yet.
    pub(super) fn has_gaps(&self, centre: &[f32]) -> bool {
        self.roughness.iter().zip(centre).fold(false, |any, (&r, &c)| any | ((r < 0.0) & (c > 0.0)))
    }
}
