//! Covariance sums over each pixel's window: first along the row, then down the column.

use super::grid::{Grid, PAD};
use super::settings::STRIP;
use crate::sensor::beam_model::BeamModel;
use crate::simd::{Kernel, dispatch};
use crate::simd::{larger, smaller};

/// Largest window: pixels on each side of the centre, along the row and down the column.
pub(super) const MAX_REACH: [usize; 2] = [8, 5];
/// Smallest window: fewer pixels do not determine a plane.
const MIN_REACH: f32 = 2.0;
/// Smallest narrow window.
const MIN_NARROW: f32 = 1.0;

/// The width of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Width {
    /// The width from the settings.
    Wide,
    /// Half of it, for curved surfaces.
    Narrow,
}

/// The sizes of windows in pixels.
#[derive(Clone, Debug)]
pub(super) struct WindowRule {
    /// Pixels in half a window one metre away, along the row.
    pub(super) along: f32,
    /// The same down the column, for each row.
    pub(super) down: Vec<f32>,
    /// Tangent and secant of k columns, k = 0..=MAX_REACH.
    pub(super) turn: Vec<[f32; 2]>,
}

impl WindowRule {
    pub(super) fn new(model: &BeamModel, half_window: f32) -> Self {
        let rows = model.rows();
        let step = model.azimuth_step();
        let sign = if model.is_clockwise() { -1.0 } else { 1.0 };
        let rise: Vec<f32> = model.elevations().iter().map(|e| e.clamp(-1.55, 1.55).tan()).collect();
        let down = (0..rows)
            .map(|row| {
                let (above, below) = (row.saturating_sub(2), (row + 2).min(rows - 1));
                let gap = (rise[above] - rise[below]) / (below - above).max(1) as f32;
                half_window / gap.max(1e-4)
            })
            .collect();
        let turn = (0..=MAX_REACH[0])
            .map(|k| {
                let angle = (k as f32 * step).min(1.4);
                [sign * angle.tan(), 1.0 / angle.cos()]
            })
            .collect();
        Self { along: half_window / step, down, turn }
    }

    /// The reach of the windows of a row: along the row, and down the column.
    #[inline(always)]
    pub(super) fn reach(&self, row: usize, width: Width) -> [Reach; 2] {
        let (factor, least) = match width {
            Width::Wide => (1.0, MIN_REACH),
            Width::Narrow => (0.5, MIN_NARROW),
        };
        let reach = |pixels, most: usize| Reach { pixels, most: most as f32, factor, least };
        [reach(self.along, MAX_REACH[0]), reach(self.down[row], MAX_REACH[1])]
    }
}

/// How far a window reaches to each side of its pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reach {
    pixels: f32,
    most: f32,
    factor: f32,
    least: f32,
}

impl Reach {
    /// Pixels, not rounded, around a pixel whose 1 / X is `inverse`.
    #[inline(always)]
    pub(super) fn at(&self, inverse: f32) -> f32 {
        // Not `clamp`, whose check of its bounds prevents vectorisation.
        larger(smaller(larger(self.pixels * inverse, MIN_REACH), self.most) * self.factor, self.least)
    }
}

/// Sums over windows, one lane a column. x is the tangent of the azimuth from the centre's column, t the rise above the
/// centre's row, u the inverse depth above the centre's.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Moments {
    pub(super) n: [f32; STRIP],
    pub(super) x: [f32; STRIP],
    pub(super) t: [f32; STRIP],
    pub(super) u: [f32; STRIP],
    pub(super) xx: [f32; STRIP],
    pub(super) xt: [f32; STRIP],
    pub(super) tt: [f32; STRIP],
    pub(super) xu: [f32; STRIP],
    pub(super) tu: [f32; STRIP],
    pub(super) uu: [f32; STRIP],
}

impl Moments {
    pub(super) const ZERO: Self = {
        let z = [0.0; STRIP];
        Self { n: z, x: z, t: z, u: z, xx: z, xt: z, tt: z, xu: z, tu: z, uu: z }
    };
}

/// The row sums of one strip of columns, for both widths; computed when needed.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    wide: Vec<Moments>,
    narrow: Vec<Moments>,
    has_wide: Vec<bool>,
    has_narrow: Vec<bool>,
}

impl Scratch {
    /// Begins a strip of an image with so many rows.
    pub(super) fn start(&mut self, rows: usize) {
        for sums in [&mut self.wide, &mut self.narrow] {
            sums.resize(rows, Moments::ZERO);
        }
        for has in [&mut self.has_wide, &mut self.has_narrow] {
            has.clear();
            has.resize(rows, false);
        }
    }

    /// The windows around the pixels of a row, with their row sums.
    pub(super) fn window<'a>(
        &'a mut self,
        grid: &'a Grid,
        rule: &'a WindowRule,
        width: Width,
        (row, first_column): (usize, usize),
    ) -> ColumnSums<'a> {
        let (rows, has, reach) = match width {
            Width::Wide => (&mut self.wide, &mut self.has_wide, MAX_REACH[1]),
            Width::Narrow => (&mut self.narrow, &mut self.has_narrow, MAX_REACH[1].div_ceil(2)),
        };
        for near in row.saturating_sub(reach)..(row + reach + 1).min(grid.rows) {
            if !std::mem::replace(&mut has[near], true) {
                sum_row(grid, rule, width, (near, first_column), &mut rows[near]);
            }
        }
        ColumnSums { rows, grid, rule, width, row, first_column }
    }
}

fn sum_row(grid: &Grid, rule: &WindowRule, width: Width, (row, first_column): (usize, usize), sums: &mut Moments) {
    let at = grid.at(row, first_column) - PAD;
    let end = at + STRIP + 2 * PAD;
    dispatch(RowSums {
        inverse: &grid.inverse[at..end],
        across: &grid.across[at..end],
        rise: &grid.rise[at..end],
        link: &grid.link_right[at..end],
        row_rise: grid.row_rise[row],
        rule,
        width,
        row,
        sums,
    });
}

/// Sums a row's pixels around each lane. The arrays start `PAD` columns before the strip.
struct RowSums<'a> {
    inverse: &'a [f32],
    across: &'a [f32],
    rise: &'a [f32],
    link: &'a [f32],
    row_rise: f32,
    rule: &'a WindowRule,
    width: Width,
    row: usize,
    sums: &'a mut Moments,
}

/// The lanes of the strip, shifted by `offset` columns, in an array that starts `PAD` columns before the strip.
#[inline(always)]
fn lanes(plane: &[f32], offset: isize) -> &[f32; STRIP] {
    const NOTHING: [f32; STRIP] = [0.0; STRIP];
    plane[(PAD as isize + offset) as usize..].first_chunk().unwrap_or(&NOTHING)
}

impl Kernel for RowSums<'_> {
    #[inline(always)]
    fn run(self) {
        let centre = lanes(self.inverse, 0);
        let (across, rise) = (lanes(self.across, 0), lanes(self.rise, 0));
        // Sums are in a local copy, which cannot alias the inputs: only then are the loops vectorised.
        let mut sums = Moments::ZERO;
        let (mut reach, mut right, mut left) = ([0f32; STRIP], [0f32; STRIP], [0f32; STRIP]);
        let window = self.rule.reach(self.row, self.width)[0];
        let row_rise = self.row_rise;
        for l in 0..STRIP {
            let valid = if centre[l] > 0.0 { 1.0 } else { 0.0 };
            (reach[l], right[l], left[l]) = (window.at(centre[l]) * valid, valid, valid);
            sums.add(l, Sample::new(valid, [across[l], rise[l] - row_rise, 0.0]));
        }
        for k in 1..=farthest(&reach) {
            let [tan, sec] = self.rule.turn[k];
            let wanted = k as f32 - 0.5;
            let side = |at: isize, link: isize| {
                let link = lanes(self.link, link);
                (link, lanes(self.inverse, at), lanes(self.across, at), lanes(self.rise, at))
            };
            let (to, from) = (k as isize, -(k as isize));
            let (link_r, w_r, f_r, z_r) = side(to, to - 1);
            let (link_l, w_l, f_l, z_l) = side(from, from);
            // The coordinates of a pixel in the frame of the centre's column, which is k columns away.
            let seen = |tan: f32, w: f32, f: f32, z: f32, w_centre: f32| {
                let turn = sec + f * (sec * tan);
                [tan + f * (sec * sec), z * turn - row_rise, w * turn - w_centre]
            };
            for l in 0..STRIP {
                right[l] *= link_r[l];
                left[l] *= link_l[l];
                let m_r = if (reach[l] >= wanted) & (w_r[l] > 0.0) { right[l] } else { 0.0 };
                let m_l = if (reach[l] >= wanted) & (w_l[l] > 0.0) { left[l] } else { 0.0 };
                let sample_r = Sample::new(m_r, seen(tan, w_r[l], f_r[l], z_r[l], centre[l]));
                let sample_l = Sample::new(m_l, seen(-tan, w_l[l], f_l[l], z_l[l], centre[l]));
                sums.add(l, sample_r.plus(sample_l));
            }
        }
        *self.sums = sums;
    }
}

/// The longest of the reaches, rounded. Positive floats are ordered like their bits, which are compared as integer vectors.
#[inline(always)]
fn farthest(reach: &[f32; STRIP]) -> usize {
    let longest = reach.iter().fold(0, |most: u32, r| most.max(r.to_bits()));
    (f32::from_bits(longest) + 0.5) as usize
}

/// The terms that a pixel or a window adds to the sums of one lane, in the order of the fields of [`Moments`].
#[derive(Clone, Copy)]
struct Sample([f32; 10]);

impl Sample {
    /// A pixel of weight `m` at x, t, u.
    #[inline(always)]
    fn new(m: f32, [x, t, u]: [f32; 3]) -> Self {
        let (mx, mt, mu) = (m * x, m * t, m * u);
        Self([m, mx, mt, mu, mx * x, mx * t, mt * t, mx * u, mt * u, mu * u])
    }

    /// The sums around another centre, which is `b` higher in t and `a` higher in u, with weight `m`.
    #[inline(always)]
    fn shifted(other: &Moments, l: usize, m: f32, [b, a]: [f32; 2]) -> Self {
        let (n, x, t, u) = (m * other.n[l], m * other.x[l], m * other.t[l], m * other.u[l]);
        let (bn, an) = (b * n, a * n);
        Self([
            n,
            x,
            t + bn,
            u + an,
            m * other.xx[l],
            m * other.xt[l] + b * x,
            m * other.tt[l] + b * (t + t + bn),
            m * other.xu[l] + a * x,
            m * other.tu[l] + a * t + b * (u + an),
            m * other.uu[l] + a * (u + u + an),
        ])
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6], a[7] + b[7], a[8] + b[8], a[9] + b[9]])
    }
}

impl Moments {
    #[inline(always)]
    fn add(&mut self, l: usize, Sample([n, x, t, u, xx, xt, tt, xu, tu, uu]): Sample) {
        self.n[l] += n;
        self.x[l] += x;
        self.t[l] += t;
        self.u[l] += u;
        self.xx[l] += xx;
        self.xt[l] += xt;
        self.tt[l] += tt;
        self.xu[l] += xu;
        self.tu[l] += tu;
        self.uu[l] += uu;
    }
}

/// Adds the row sums of the rows above and below.
#[derive(Clone, Copy)]
pub(super) struct ColumnSums<'a> {
    rows: &'a [Moments],
    pub(super) grid: &'a Grid,
    rule: &'a WindowRule,
    pub(super) width: Width,
    pub(super) row: usize,
    pub(super) first_column: usize,
}

impl ColumnSums<'_> {
    /// The sums, and the number of rows in them.
    #[inline(always)]
    pub(super) fn sum(&self) -> (Moments, [f32; STRIP]) {
        let (grid, row) = (self.grid, self.row as isize);
        let part = |row: usize| grid.at(row, self.first_column) - PAD;
        let centre = lanes(&grid.inverse[part(self.row)..], 0);
        let mut reach = [0f32; STRIP];
        let window = self.rule.reach(self.row, self.width)[1];
        for l in 0..STRIP {
            reach[l] = if centre[l] > 0.0 { window.at(centre[l]) } else { 0.0 };
        }
        let mut sums = self.rows[self.row];
        let mut rows = [1f32; STRIP];
        let (mut down, mut up) = ([1f32; STRIP], [1f32; STRIP]);
        for k in 1..=farthest(&reach) as isize {
            let wanted = k as f32 - 0.5;
            // Beyond the edge of the image the weight is 0; what is read there does not matter.
            let side = |other: isize, link: isize| {
                let inside = (0..grid.rows as isize).contains(&other);
                let (other, link) = if inside { (other as usize, link as usize) } else { (self.row, self.row) };
                let fall = grid.row_rise[other] - grid.row_rise[self.row];
                let planes = (lanes(&grid.link_down[part(link)..], 0), lanes(&grid.inverse[part(other)..], 0));
                (if inside { 1.0 } else { 0.0 }, fall, planes, &self.rows[other])
            };
            let (inside_d, fall_d, (link_d, w_d), sums_d) = side(row + k, row + k - 1);
            let (inside_u, fall_u, (link_u, w_u), sums_u) = side(row - k, row - k);
            for l in 0..STRIP {
                down[l] *= link_d[l] * inside_d;
                up[l] *= link_u[l] * inside_u;
                let (m_d, m_u) = if reach[l] >= wanted { (down[l], up[l]) } else { (0.0, 0.0) };
                let from_below = Sample::shifted(sums_d, l, m_d, [fall_d, w_d[l] - centre[l]]);
                let from_above = Sample::shifted(sums_u, l, m_u, [fall_u, w_u[l] - centre[l]]);
                sums.add(l, from_below.plus(from_above));
                rows[l] += if m_d * sums_d.n[l] > 0.0 { 1.0 } else { 0.0 };
                rows[l] += if m_u * sums_u.n[l] > 0.0 { 1.0 } else { 0.0 };
            }
        }
        (sums, rows)
    }
}

#[cfg(test)]
mod tests {
    use super::super::plane::{Plane, Solve};
    use super::super::settings::NormalSettings;
    use super::*;
    use crate::sensor::{RangeImage, preset};
    use proptest::prelude::*;

    /// A grid of noisy, broken surfaces, in the pixels of a small part of a sensor.
    fn grid(seed: &[f32]) -> Grid {
        let model = preset("vlp-16").unwrap_or_else(|e| panic!("{e}"));
        let range = |row: usize, column: usize| {
            let s = seed[(row * 31 + column * 17) % seed.len()];
            if s > 0.95 { 0.0 } else { (4.0 + (column / 40) as f32 * 0.7) * (1.0 + 0.01 * s) }
        };
        let (rows, columns) = (model.rows(), model.columns());
        let points: Vec<[f32; 3]> =
            (0..rows * columns).map(|i| model.point((i / columns) as f32, (i % columns) as f32, range(i / columns, i % columns))).collect();
        let ranges = (0..rows * columns).map(|i| range(i / columns, i % columns)).collect();
        let image = RangeImage { rows, columns, ranges, points: (0..(rows * columns) as u32).collect() };
        let mut grid = Grid::new(&model);
        grid.fill(&points, &image);
        grid.link(0.02, None);
        grid
    }

    fn bits(planes: &[Plane]) -> Vec<u32> {
        let of = |plane: &Plane| {
            let [x, y, z] = plane.normal;
            [x, y, z, plane.distance, plane.roughness, plane.misfit, plane.inverse].map(f32::to_bits)
        };
        planes.iter().flat_map(of).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]
        #[test]
        fn wide_instructions_give_the_same_planes(seed in prop::collection::vec(-1f32..1.0, 977), first in 0usize..50) {
            let grid = grid(&seed);
            let model = preset("vlp-16").map_err(|e| TestCaseError::fail(e.to_string()))?;
            let rule = WindowRule::new(&model, 0.2);
            let settings = NormalSettings::default();
            let mut scratch = Scratch::default();
            scratch.start(grid.rows);
            for row in 0..grid.rows {
                let mut planes = [[Plane::NONE; STRIP]; 2];
                let windows = scratch.window(&grid, &rule, Width::Wide, (row, first * STRIP));
                dispatch(Solve { windows, settings: &settings, noise: 0.02, planes: &mut planes[0] });
                Solve { windows, settings: &settings, noise: 0.02, planes: &mut planes[1] }.run();
                prop_assert_eq!(bits(&planes[0]), bits(&planes[1]));
            }
        }
    }
}
