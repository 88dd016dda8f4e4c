//! Sums over each pixel's window: first along the row, then down the column.

use super::super::dispatch::{Kernel, dispatch};
use super::super::model::BeamModel;
use super::grid::{Grid, PAD};
use super::{NormalSettings, STRIP};

/// Largest window: pixels on each side of the centre, along the row and down the column.
pub(crate) const MAX_REACH: [usize; 2] = [8, 5];
/// Smallest window: fewer pixels could not be told from chance.
pub(crate) const MIN_REACH: f32 = 2.0;

/// How many pixels a window spans.
#[derive(Clone, Debug)]
pub(crate) struct WindowRule {
    /// Pixels in half a window one metre away, along the row.
    pub(crate) along: f32,
    /// The same down the column, for each row.
    pub(crate) down: Vec<f32>,
    /// Tangent and secant of k columns, k = 0..=MAX_REACH.
    pub(crate) turn: Vec<[f32; 2]>,
}

impl WindowRule {
    pub(crate) fn new(model: &BeamModel, half_window: f32) -> Self {
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

    /// Pixels on each side of a pixel whose 1 / X is `inverse`, not rounded.
    #[inline(always)]
    pub(crate) fn reach(&self, row: usize, inverse: f32) -> [f32; 2] {
        [(self.along * inverse).clamp(MIN_REACH, MAX_REACH[0] as f32), (self.down[row] * inverse).clamp(MIN_REACH, MAX_REACH[1] as f32)]
    }
}

/// Sums over windows, one lane a column. x is the tangent of the azimuth from the centre's column, t the rise above the
/// centre's row, u the inverse depth above the centre's.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Moments {
    pub(crate) n: [f32; STRIP],
    pub(crate) x: [f32; STRIP],
    pub(crate) t: [f32; STRIP],
    pub(crate) u: [f32; STRIP],
    pub(crate) xx: [f32; STRIP],
    pub(crate) xt: [f32; STRIP],
    pub(crate) tt: [f32; STRIP],
    pub(crate) xu: [f32; STRIP],
    pub(crate) tu: [f32; STRIP],
    pub(crate) uu: [f32; STRIP],
}

impl Moments {
    pub(crate) const ZERO: Self = {
        let z = [0.0; STRIP];
        Self { n: z, x: z, t: z, u: z, xx: z, xt: z, tt: z, xu: z, tu: z, uu: z }
    };
}

/// The sums of one strip of columns.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    pub(crate) rows: Vec<Moments>,
}

impl Scratch {
    /// Sums along the rows of the strip that starts at `first_column`.
    pub(crate) fn sum_rows(&mut self, grid: &Grid, rule: &WindowRule, first_column: usize) {
        self.rows.resize(grid.rows, Moments::ZERO);
        for (row, sums) in self.rows.iter_mut().enumerate() {
            let at = grid.at(row, first_column);
            dispatch(RowSums {
                inverse: &grid.inverse[at - PAD..],
                across: &grid.across[at - PAD..],
                rise: &grid.rise[at - PAD..],
                link: &grid.link_right[at - PAD..],
                row_rise: grid.row_rise[row],
                rule,
                row,
                lanes: STRIP.min(grid.columns - first_column),
                sums,
            });
        }
    }

    /// Sums down the columns and fits the planes of the strip.
    pub(crate) fn fit(
        &self,
        grid: &Grid,
        rule: &WindowRule,
        settings: &NormalSettings,
        noise: f32,
        (first_column, strip): (usize, &mut super::plane::Strip),
    ) {
        let lanes = STRIP.min(grid.columns - first_column);
        for row in 0..grid.rows {
            let mut sums = self.rows[row];
            dispatch(ColumnSums { rows: &self.rows, grid, rule, row, first_column, lanes, sums: &mut sums });
            dispatch(super::plane::Solve { sums: &sums, grid, row, first_column, lanes, settings, noise, planes: &mut strip.rows[row] });
        }
    }
}

/// Adds up a row's pixels around each lane. The planes start `PAD` columns before the strip.
struct RowSums<'a> {
    inverse: &'a [f32],
    across: &'a [f32],
    rise: &'a [f32],
    link: &'a [f32],
    row_rise: f32,
    rule: &'a WindowRule,
    row: usize,
    lanes: usize,
    sums: &'a mut Moments,
}

/// A strip's part of a plane, `offset` columns from the strip's first column; the planes are padded so that it exists.
#[inline(always)]
fn lanes(plane: &[f32], offset: isize, count: usize) -> [f32; STRIP] {
    let start = (PAD as isize + offset) as usize;
    let mut out = [0.0; STRIP];
    out[..count].copy_from_slice(&plane[start..start + count]);
    out
}

impl Kernel for RowSums<'_> {
    #[inline(always)]
    fn run(self) {
        let count = self.lanes;
        let centre = lanes(self.inverse, 0, count);
        let (across, rise) = (lanes(self.across, 0, count), lanes(self.rise, 0, count));
        let sums = self.sums;
        let (mut reach, mut right, mut left) = ([0f32; STRIP], [0f32; STRIP], [0f32; STRIP]);
        let mut farthest = 0f32;
        for l in 0..STRIP {
            let valid = if centre[l] > 0.0 { 1.0 } else { 0.0 };
            let (x, t) = (across[l], rise[l] - self.row_rise);
            (reach[l], right[l], left[l]) = (self.rule.reach(self.row, centre[l])[0] * valid, valid, valid);
            farthest = farthest.max(reach[l]);
            let (x, t) = (x * valid, t * valid);
            (sums.n[l], sums.x[l], sums.t[l], sums.u[l]) = (valid, x, t, 0.0);
            (sums.xx[l], sums.xt[l], sums.tt[l]) = (x * x, x * t, t * t);
            (sums.xu[l], sums.tu[l], sums.uu[l]) = (0.0, 0.0, 0.0);
        }
        for k in 1..=(farthest + 0.5) as usize {
            let [tan, sec] = self.rule.turn[k];
            let wanted = k as f32 - 0.5;
            for (side, alive, link) in [(1isize, &mut right, k as isize - 1), (-1, &mut left, -(k as isize))] {
                let at = side * k as isize;
                let link = lanes(self.link, link, count);
                let (w, f, z) = (lanes(self.inverse, at, count), lanes(self.across, at, count), lanes(self.rise, at, count));
                let tan = tan * side as f32;
                for l in 0..STRIP {
                    alive[l] *= link[l];
                    let m = if reach[l] >= wanted { alive[l] } else { 0.0 };
                    let turn = sec + f[l] * (sec * tan);
                    let x = tan + f[l] * (sec * sec);
                    let t = z[l] * turn - self.row_rise;
                    let u = w[l] * turn - centre[l];
                    add(sums, l, m, [x, t, u]);
                }
            }
        }
    }
}

/// Adds one sample of weight `m` to lane `l`.
#[inline(always)]
fn add(sums: &mut Moments, l: usize, m: f32, [x, t, u]: [f32; 3]) {
    let (mx, mt, mu) = (m * x, m * t, m * u);
    sums.n[l] += m;
    sums.x[l] += mx;
    sums.t[l] += mt;
    sums.u[l] += mu;
    sums.xx[l] += mx * x;
    sums.xt[l] += mx * t;
    sums.tt[l] += mt * t;
    sums.xu[l] += mx * u;
    sums.tu[l] += mt * u;
    sums.uu[l] += mu * u;
}

/// Adds the row sums of the rows above and below.
struct ColumnSums<'a> {
    rows: &'a [Moments],
    grid: &'a Grid,
    rule: &'a WindowRule,
    row: usize,
    first_column: usize,
    lanes: usize,
    sums: &'a mut Moments,
}

impl Kernel for ColumnSums<'_> {
    #[inline(always)]
    fn run(self) {
        let (grid, row, count) = (self.grid, self.row, self.lanes);
        let part = |plane: &[f32], row: usize| lanes(&plane[grid.at(row, self.first_column) - PAD..], 0, count);
        let centre = part(&grid.inverse, row);
        let mut reach = [0f32; STRIP];
        let mut farthest = 0f32;
        for l in 0..STRIP {
            reach[l] = if centre[l] > 0.0 { self.rule.reach(row, centre[l])[1] } else { 0.0 };
            farthest = farthest.max(reach[l]);
        }
        for side in [1isize, -1] {
            let mut alive = [1f32; STRIP];
            for k in 1..=(farthest + 0.5) as isize {
                let other = row as isize + side * k;
                if other < 0 || other >= grid.rows as isize {
                    break;
                }
                let other = other as usize;
                let link = part(&grid.link_down, if side > 0 { other - 1 } else { other });
                let inverse = part(&grid.inverse, other);
                let fall = grid.row_rise[other] - grid.row_rise[row];
                let wanted = k as f32 - 0.5;
                for l in 0..STRIP {
                    alive[l] *= link[l];
                    let m = if reach[l] >= wanted { alive[l] } else { 0.0 };
                    add_shifted(self.sums, &self.rows[other], l, m, [fall, inverse[l] - centre[l]]);
                }
            }
        }
    }
}

/// Adds the sums of another centre, which lies `b` higher in t and `a` in u, with weight `m`.
#[inline(always)]
fn add_shifted(sums: &mut Moments, other: &Moments, l: usize, m: f32, [b, a]: [f32; 2]) {
    let (n, x, t, u) = (m * other.n[l], m * other.x[l], m * other.t[l], m * other.u[l]);
    let (bn, an) = (b * n, a * n);
    sums.n[l] += n;
    sums.x[l] += x;
    sums.t[l] += t + bn;
    sums.u[l] += u + an;
    sums.xx[l] += m * other.xx[l];
    sums.xt[l] += m * other.xt[l] + b * x;
    sums.tt[l] += m * other.tt[l] + b * (t + t + bn);
    sums.xu[l] += m * other.xu[l] + a * x;
    sums.tu[l] += m * other.tu[l] + a * t + b * (u + an);
    sums.uu[l] += m * other.uu[l] + a * (u + u + an);
}
