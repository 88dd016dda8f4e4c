//! Sums over each pixel's window: first along the row, then down the column.

use super::super::dispatch::{Kernel, dispatch};
use super::super::model::BeamModel;
use super::super::trig::{larger, smaller};
use super::STRIP;
use super::grid::{Grid, PAD};

/// Largest window: pixels on each side of the centre, along the row and down the column.
pub(crate) const MAX_REACH: [usize; 2] = [8, 5];
/// Smallest window: fewer pixels could not be told from chance.
const MIN_REACH: f32 = 2.0;
/// Smallest narrow window.
const MIN_NARROW: f32 = 1.0;

/// Which window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Width {
    /// The usual one.
    Wide,
    /// Half of it, for surfaces that bend.
    Narrow,
}

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

    /// The reach of the windows of a row: along the row, and down the column.
    #[inline(always)]
    pub(crate) fn reach(&self, row: usize, width: Width) -> [Reach; 2] {
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
pub(crate) struct Reach {
    pixels: f32,
    most: f32,
    factor: f32,
    least: f32,
}

impl Reach {
    /// Pixels, not rounded, around a pixel whose 1 / X is `inverse`.
    #[inline(always)]
    pub(crate) fn at(&self, inverse: f32) -> f32 {
        // Not `clamp`, whose check of its bounds would keep the loop from being vectorised.
        larger(smaller(larger(self.pixels * inverse, MIN_REACH), self.most) * self.factor, self.least)
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

/// The row sums of one strip of columns, for both widths; the narrow ones only where they were asked for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    wide: Vec<Moments>,
    narrow: Vec<Moments>,
    has_narrow: Vec<bool>,
}

impl Scratch {
    /// Sums along the rows of the strip that starts at `first_column`.
    pub(crate) fn start(&mut self, grid: &Grid, rule: &WindowRule, first_column: usize) {
        self.wide.resize(grid.rows, Moments::ZERO);
        self.narrow.resize(grid.rows, Moments::ZERO);
        self.has_narrow.clear();
        self.has_narrow.resize(grid.rows, false);
        for (row, sums) in self.wide.iter_mut().enumerate() {
            sum_row(grid, rule, Width::Wide, (row, first_column), sums);
        }
    }

    /// Sums over the windows around the pixels of a row.
    pub(crate) fn window(&mut self, grid: &Grid, rule: &WindowRule, width: Width, (row, first_column): (usize, usize)) -> Moments {
        if width == Width::Narrow {
            let reach = MAX_REACH[1].div_ceil(2);
            for near in row.saturating_sub(reach)..(row + reach + 1).min(grid.rows) {
                if !std::mem::replace(&mut self.has_narrow[near], true) {
                    sum_row(grid, rule, width, (near, first_column), &mut self.narrow[near]);
                }
            }
        }
        let rows = if width == Width::Wide { &self.wide } else { &self.narrow };
        let mut sums = Moments::ZERO;
        dispatch(ColumnSums { rows, grid, rule, width, row, first_column, sums: &mut sums });
        sums
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

/// Adds up a row's pixels around each lane. The planes start `PAD` columns before the strip.
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

/// The strip's part of a plane that starts `PAD` columns before the strip, `offset` columns further on.
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
        // Summed up in a copy, so that nothing read can be what is written: only then do the loops vectorise.
        let mut sums = Moments::ZERO;
        let (mut reach, mut right, mut left) = ([0f32; STRIP], [0f32; STRIP], [0f32; STRIP]);
        let window = self.rule.reach(self.row, self.width)[0];
        let row_rise = self.row_rise;
        for l in 0..STRIP {
            let valid = if centre[l] > 0.0 { 1.0 } else { 0.0 };
            (reach[l], right[l], left[l]) = (window.at(centre[l]) * valid, valid, valid);
            add(&mut sums, l, valid, [across[l], rise[l] - row_rise, 0.0]);
        }
        for k in 1..=farthest(&reach) {
            let [tan, sec] = self.rule.turn[k];
            let wanted = k as f32 - 0.5;
            for (side, alive, link) in [(1isize, &mut right, k as isize - 1), (-1, &mut left, -(k as isize))] {
                let at = side * k as isize;
                let link = lanes(self.link, link);
                let (w, f, z) = (lanes(self.inverse, at), lanes(self.across, at), lanes(self.rise, at));
                let tan = tan * side as f32;
                for l in 0..STRIP {
                    alive[l] *= link[l];
                    let m = if (reach[l] >= wanted) & (w[l] > 0.0) { alive[l] } else { 0.0 };
                    let turn = sec + f[l] * (sec * tan);
                    let x = tan + f[l] * (sec * sec);
                    let t = z[l] * turn - row_rise;
                    let u = w[l] * turn - centre[l];
                    add(&mut sums, l, m, [x, t, u]);
                }
            }
        }
        *self.sums = sums;
    }
}

/// Pixels in the longest of the reaches, rounded. Positive floats are ordered like their bits, which the compiler can
/// compare eight at a time.
#[inline(always)]
fn farthest(reach: &[f32; STRIP]) -> usize {
    let longest = reach.iter().fold(0, |most: u32, r| most.max(r.to_bits()));
    (f32::from_bits(longest) + 0.5) as usize
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
    width: Width,
    row: usize,
    first_column: usize,
    sums: &'a mut Moments,
}

impl Kernel for ColumnSums<'_> {
    #[inline(always)]
    fn run(self) {
        let (grid, row) = (self.grid, self.row);
        let part = |row: usize| grid.at(row, self.first_column) - PAD;
        let centre = lanes(&grid.inverse[part(row)..], 0);
        let mut reach = [0f32; STRIP];
        let window = self.rule.reach(row, self.width)[1];
        for l in 0..STRIP {
            reach[l] = if centre[l] > 0.0 { window.at(centre[l]) } else { 0.0 };
        }
        let mut sums = self.rows[row];
        for side in [1isize, -1] {
            let mut alive = [1f32; STRIP];
            for k in 1..=farthest(&reach) as isize {
                let other = row as isize + side * k;
                if other < 0 || other >= grid.rows as isize {
                    break;
                }
                let other = other as usize;
                let link = lanes(&grid.link_down[part(if side > 0 { other - 1 } else { other })..], 0);
                let inverse = lanes(&grid.inverse[part(other)..], 0);
                let fall = grid.row_rise[other] - grid.row_rise[row];
                let wanted = k as f32 - 0.5;
                for l in 0..STRIP {
                    alive[l] *= link[l];
                    let m = if reach[l] >= wanted { alive[l] } else { 0.0 };
                    add_shifted(&mut sums, &self.rows[other], l, m, [fall, inverse[l] - centre[l]]);
                }
            }
        }
        *self.sums = sums;
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
