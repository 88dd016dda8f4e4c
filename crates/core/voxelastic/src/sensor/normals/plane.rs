//! From sums to planes, and the tests that accept or reject them.

use super::covariance::{ColumnSums, Width};
use super::settings::{NormalSettings, STRIP};
use crate::simd::Kernel;
use crate::simd::larger;

/// The plane fitted at a pixel: all that a search of it needs, in half a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Plane {
    /// Unit normal towards the sensor, lidar frame.
    pub(super) normal: [f32; 3],
    /// Distance from the beams' origin, metres.
    pub(super) distance: f32,
    /// Standard deviation of the neighbours along the normal, metres; negative where there is no plane.
    pub(super) roughness: f32,
    /// How far off the plane the pixel's own point is, in standard deviations.
    pub(super) misfit: f32,
    /// 1 / X of the pixel's point; 0 without one.
    pub(super) inverse: f32,
}

impl Plane {
    pub(super) const NONE: Self = Self { normal: [0.0; 3], distance: 0.0, roughness: -1.0, misfit: 0.0, inverse: 0.0 };

    /// Whether there is a plane.
    #[inline(always)]
    pub(super) fn is_accepted(&self) -> bool {
        self.roughness >= 0.0
    }
}

/// Planes of all pixels, row by row, up to whole strips.
#[derive(Clone, Debug, Default)]
pub(super) struct Planes {
    width: usize,
    planes: Vec<Plane>,
}

impl Planes {
    pub(super) fn reset(&mut self, rows: usize, strips: usize) {
        self.width = strips * STRIP;
        self.planes.resize(rows * self.width, Plane::NONE);
    }

    /// The planes of `per_task` neighbouring strips for each task, a slice for each row.
    pub(super) fn split(&mut self, per_task: usize) -> Vec<Vec<&mut [Plane]>> {
        let width = per_task * STRIP;
        let mut tasks: Vec<Vec<&mut [Plane]>> = (0..self.width.div_ceil(width)).map(|_| Vec::new()).collect();
        for row in self.planes.chunks_exact_mut(self.width) {
            row.chunks_mut(width).zip(&mut tasks).for_each(|(part, task)| task.push(part));
        }
        tasks
    }

    /// The plane at a pixel, accepted or not.
    #[inline(always)]
    pub(super) fn at(&self, row: usize, column: usize) -> &Plane {
        &self.planes[row * self.width + column]
    }
}

/// Whether a pixel with a point has no plane yet.
pub(super) fn has_gaps(planes: &[Plane; STRIP], centre: &[f32]) -> bool {
    planes.iter().zip(centre).fold(false, |any, (plane, &c)| any | (!plane.is_accepted() & (c > 0.0)))
}

/// Sums up and solves the systems of one row of a strip.
pub(super) struct Solve<'a> {
    pub(super) windows: ColumnSums<'a>,
    pub(super) settings: &'a NormalSettings,
    pub(super) noise: f32,
    pub(super) planes: &'a mut [Plane; STRIP],
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
        let mut out = Lanes::NONE;
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
        // By index: as an iterator it makes a fit a tenth slower.
        #[allow(clippy::needless_range_loop)]
        for l in 0..STRIP {
            // What is not accepted in the wide window gets the plane of the narrow one.
            if width == Width::Wide || !self.planes[l].is_accepted() {
                let normal = [out.normal[0][l], out.normal[1][l], out.normal[2][l]];
                self.planes[l] = Plane { normal, distance: out.distance[l], roughness: out.roughness[l], misfit: out.misfit[l], inverse: centre[l] };
            }
        }
    }
}

/// Planes of one row of a strip, as they are computed.
struct Lanes {
    normal: [[f32; STRIP]; 3],
    distance: [f32; STRIP],
    roughness: [f32; STRIP],
    misfit: [f32; STRIP],
}

impl Lanes {
    const NONE: Self = Self { normal: [[0.0; STRIP]; 3], distance: [0.0; STRIP], roughness: [-1.0; STRIP], misfit: [0.0; STRIP] };
}

/// The first lanes of a slice.
#[inline(always)]
fn chunk<T: Copy + Default>(slice: &[T]) -> [T; STRIP] {
    slice.first_chunk().copied().unwrap_or([T::default(); STRIP])
}
