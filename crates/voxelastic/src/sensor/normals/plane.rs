//! From sums to planes, and which of them to believe.

use super::super::dispatch::Kernel;
use super::grid::{Grid, PAD};
use super::moments::Moments;
use super::{NormalSettings, STRIP};

/// Planes of one row of a strip: points p (lidar frame, above the beams' origin) on the plane satisfy a . p = 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneRow {
    pub(crate) a: [[f32; STRIP]; 3],
    /// Standard deviation of the neighbours along the normal, metres; negative where there is no plane.
    pub(crate) roughness: [f32; STRIP],
}

impl PlaneRow {
    const NONE: Self = Self { a: [[0.0; STRIP]; 3], roughness: [-1.0; STRIP] };
}

/// Planes of a strip of columns.
#[derive(Clone, Debug, Default)]
pub(crate) struct Strip {
    pub(crate) rows: Vec<PlaneRow>,
}

/// Planes of all pixels, strip by strip.
#[derive(Clone, Debug, Default)]
pub(crate) struct Planes {
    strips: Vec<Strip>,
}

/// A plane that is believed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    pub(crate) a: [f32; 3],
    pub(crate) roughness: f32,
}

impl Planes {
    pub(crate) fn reset(&mut self, rows: usize, strips: usize) {
        self.strips.resize_with(strips, Strip::default);
        self.strips.iter_mut().for_each(|strip| strip.rows.resize(rows, PlaneRow::NONE));
    }

    pub(crate) fn strips_mut(&mut self) -> &mut [Strip] {
        &mut self.strips
    }

    /// The plane at a pixel, if one is believed.
    #[inline(always)]
    pub(crate) fn get(&self, row: usize, column: usize) -> Option<Plane> {
        let planes = &self.strips[column / STRIP].rows[row];
        let l = column % STRIP;
        (planes.roughness[l] >= 0.0).then(|| Plane { a: [planes.a[0][l], planes.a[1][l], planes.a[2][l]], roughness: planes.roughness[l] })
    }
}

/// Solves the systems of one row of a strip.
pub(crate) struct Solve<'a> {
    pub(crate) sums: &'a Moments,
    pub(crate) grid: &'a Grid,
    pub(crate) row: usize,
    pub(crate) first_column: usize,
    pub(crate) lanes: usize,
    pub(crate) settings: &'a NormalSettings,
    pub(crate) noise: f32,
    pub(crate) planes: &'a mut PlaneRow,
}

impl Kernel for Solve<'_> {
    #[inline(always)]
    fn run(self) {
        /// A plane and its residual need this many samples.
        const LEAST_SAMPLES: f32 = 6.0;
        let Self { sums, grid, row, .. } = self;
        let at = grid.at(row, self.first_column);
        let mut centre = [0f32; STRIP];
        centre[..self.lanes].copy_from_slice(&grid.inverse[at..at + self.lanes]);
        let mut axes = [[0f32; 2]; STRIP];
        axes[..self.lanes].copy_from_slice(&grid.axes[self.first_column..self.first_column + self.lanes]);
        let row_rise = grid.row_rise[row];
        let ray = (1.0 + row_rise * row_rise).sqrt();
        let most = self.settings.max_uncertainty * self.settings.max_uncertainty;
        for l in 0..STRIP {
            let n = sums.n[l];
            let per_n = 1.0 / n.max(1.0);
            let (mx, mt, mu) = (sums.x[l] * per_n, sums.t[l] * per_n, sums.u[l] * per_n);
            let (xx, xt, tt) = (sums.xx[l] - sums.x[l] * mx, sums.xt[l] - sums.x[l] * mt, sums.tt[l] - sums.t[l] * mt);
            let (xu, tu, uu) = (sums.xu[l] - sums.x[l] * mu, sums.tu[l] - sums.t[l] * mu, sums.uu[l] - sums.u[l] * mu);
            let determinant = xx * tt - xt * xt;
            let solvable = (n >= LEAST_SAMPLES) & (determinant > 0.05 * xx * tt);
            let per_det = 1.0 / if solvable { determinant } else { 1.0 };
            let b = (xu * tt - tu * xt) * per_det;
            let c = (tu * xx - xu * xt) * per_det;
            let a = centre[l] + mu - b * mx - c * (mt + row_rise);
            let length2 = a * a + b * b + c * c;
            let freedom = (n - 3.0).max(1.0);
            let variance = (uu - b * xu - c * tu).max(0.0) / freedom;
            // What the range noise alone would leave, in inverse depth.
            let inverse = centre[l] + mu;
            let sigma = self.noise * inverse * inverse / ray;
            let expected = sigma * sigma;
            // Three standard deviations of the sample variance.
            let spread = 1.0 + 3.0 * (2.0 / freedom).sqrt();
            let along_normal = variance / (inverse * inverse * length2).max(f32::MIN_POSITIVE);
            let rough = self.settings.roughness;
            let flat = (variance <= expected * spread) | (along_normal <= rough * rough);
            let doubt = expected.max(variance) * per_det * (tt + xx * ray * ray) / length2.max(f32::MIN_POSITIVE);
            let believed = solvable & flat & (doubt <= most) & (centre[l] > 0.0);
            let [cos, sin] = axes[l];
            self.planes.a[0][l] = a * cos - b * sin;
            self.planes.a[1][l] = a * sin + b * cos;
            self.planes.a[2][l] = c;
            self.planes.roughness[l] = if believed { along_normal.sqrt() } else { -1.0 };
        }
        debug_assert!(PAD > 0);
    }
}
