//! Where everything in a plot stands: ranges, ticks, frame, key.

use super::marks::Mark;
use super::{Look, Plot};
use crate::canvas::Anchor;
use crate::colour::Rgb;
use crate::render::round_number;

const INK: Rgb = [40, 44, 52];
const SOFT: Rgb = [110, 116, 126];
const GRID: Rgb = [228, 231, 235];
const LIMIT: Rgb = [190, 60, 50];
pub(super) const CAPITAL: f32 = 8.6;

/// An axis: values on it, and where they lie on the page.
struct Axis {
    low: f64,
    high: f64,
    step: f64,
    from: f32,
    to: f32,
}

impl Axis {
    /// An axis that holds the values, with about `ticks` ticks at round numbers; from zero when nothing is negative and `zero` is asked for.
    fn new(values: impl Iterator<Item = f64>, ticks: f64, zero: bool, (from, to): (f32, f32)) -> Self {
        let (mut low, mut high) = values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if zero && low > 0.0 {
            low = 0.0;
        }
        // Beyond this the steps between ticks are lost in rounding.
        (low, high) = (low.clamp(-1e30, 1e30), high.clamp(-1e30, 1e30));
        if high - low < 1e-9 * high.abs().max(low.abs()).max(1e-12) {
            high = low + low.abs().max(1.0);
        }
        let step = round_up((high - low) / ticks);
        Self { low: (low / step).floor() * step, high: (high / step).ceil() * step, step, from, to }
    }

    fn at(&self, value: f64) -> f32 {
        let t = ((value - self.low) / (self.high - self.low)).clamp(-10.0, 10.0) as f32;
        self.from + (self.to - self.from) * t
    }

    fn ticks(&self) -> Vec<f64> {
        let n = ((self.high - self.low) / self.step).round().clamp(1.0, 100.0) as usize;
        (0..=n).map(|i| self.low + self.step * i as f64).collect()
    }

    fn label(&self, value: f64) -> String {
        let digits = (-self.step.log10().floor()).clamp(0.0, 9.0) as usize;
        if value.abs() >= 1e7 { format!("{value:.1e}") } else { format!("{:.digits$}", if value.abs() < self.step * 1e-6 { 0.0 } else { value }) }
    }
}

/// The next number of the form 1, 2, 5 times a power of ten.
fn round_up(v: f64) -> f64 {
    let below = round_number(v);
    [1.0, 2.0, 2.5, 5.0].into_iter().map(|f| round_number(below * f * 1.000_001)).find(|s| *s >= v * 0.999_999).unwrap_or(below * 2.5)
}

/// All marks of a plot, background to foreground.
pub(super) fn layout(plot: &Plot) -> Vec<Mark> {
    let (w, h) = (plot.size.width as f32, plot.size.height as f32);
    let half_bar = plot.series.iter().map(|s| if let Look::Bars(b) = s.look { b / 2.0 } else { 0.0 }).fold(0.0, f64::max);
    let xs = plot.series.iter().flat_map(|s| s.points.iter().flat_map(|p| [p[0] - half_bar, p[0] + half_bar]));
    let ys = plot.series.iter().flat_map(|s| s.points.iter().map(|p| p[1])).chain(plot.limits.iter().map(|l| l.y));
    let x = Axis::new(xs, 8.0, false, (64.0, w - 18.0));
    let (key, rows) = key(plot, &x);
    let y = Axis::new(ys, 5.0, true, (h - 48.0, (58.0 + KEY_ROW * rows.saturating_sub(1) as f32).min(h * 0.3)));
    let mut out = Vec::new();
    frame(plot, &x, &y, &mut out);
    for i in 0..plot.series.len() {
        series(plot, i, (&x, &y), &mut out);
    }
    limits(plot, &x, &y, &mut out);
    out.extend(key);
    out
}

fn text(text: &str, at: [f32; 2], anchor: Anchor, colour: Rgb) -> Mark {
    Mark::Text { text: text.into(), at, capital: CAPITAL, anchor, colour, turned: false }
}

fn frame(plot: &Plot, x: &Axis, y: &Axis, out: &mut Vec<Mark>) {
    let line = |points: Vec<[f32; 2]>, colour| Mark::Line { points, width: 1.0, colour };
    for v in y.ticks() {
        out.push(line(vec![[x.from, y.at(v)], [x.to, y.at(v)]], GRID));
        out.push(text(&y.label(v), [x.from - 8.0, y.at(v) + CAPITAL / 2.0], Anchor::End, SOFT));
    }
    for v in x.ticks() {
        out.push(line(vec![[x.at(v), y.from], [x.at(v), y.from + 4.0]], SOFT));
        out.push(text(&x.label(v), [x.at(v), y.from + 18.0], Anchor::Middle, SOFT));
    }
    out.push(line(vec![[x.from, y.from], [x.to, y.from]], SOFT));
    out.push(text(&plot.x_label, [0.5 * (x.from + x.to), y.from + 38.0], Anchor::Middle, INK));
    out.push(Mark::Text {
        text: plot.y_label.clone(),
        at: [20.0, 0.5 * (y.from + y.to)],
        capital: CAPITAL,
        anchor: Anchor::Middle,
        colour: INK,
        turned: true,
    });
    out.push(Mark::Text { text: plot.title.clone(), at: [x.from, 24.0], capital: CAPITAL * 1.25, anchor: Anchor::Start, colour: INK, turned: false });
}

fn series(plot: &Plot, i: usize, (x, y): (&Axis, &Axis), out: &mut Vec<Mark>) {
    let (series, colour) = (&plot.series[i], plot.colour(i));
    let finite = |p: &&[f64; 2]| p[0].is_finite() && p[1].is_finite();
    let place = |p: &[f64; 2]| [x.at(p[0]), y.at(p[1])];
    match series.look {
        Look::Line => {
            for run in series.points.split(|p| !finite(&p)).filter(|r| r.len() > 1) {
                out.push(Mark::Line { points: run.iter().map(place).collect(), width: 1.6, colour });
            }
        }
        Look::Dots => out.extend(series.points.iter().filter(finite).map(|p| Mark::Dot { at: place(p), radius: 2.0, colour })),
        Look::Bars(width) => {
            for p in series.points.iter().filter(finite) {
                let (left, right) = (x.at(p[0] - width / 2.0), x.at(p[0] + width / 2.0));
                let (top, bottom) = (y.at(p[1].max(0.0)), y.at(p[1].min(0.0)));
                // A hair between bars, unless they are too narrow for it.
                let gap = if right - left > 4.0 { 1.0 } else { 0.0 };
                out.push(Mark::Box { at: [left, top], size: [right - left - gap, bottom - top], colour, alpha: 200 });
            }
        }
    }
}

fn limits(plot: &Plot, x: &Axis, y: &Axis, out: &mut Vec<Mark>) {
    for limit in plot.limits.iter().filter(|l| l.y.is_finite()) {
        let (at, mut from) = (y.at(limit.y), x.from);
        while from < x.to {
            out.push(Mark::Line { points: vec![[from, at], [(from + 7.0).min(x.to), at]], width: 1.2, colour: LIMIT });
            from += 12.0;
        }
        out.push(text(&limit.label, [x.to - 2.0, at - 5.0], Anchor::End, LIMIT));
    }
}

/// From one row of the key to the next.
const KEY_ROW: f32 = 17.0;

/// Names of the series in rows above the plot, and how many rows that makes.
fn key(plot: &Plot, x: &Axis) -> (Vec<Mark>, usize) {
    let (mut marks, mut at, mut rows) = (Vec::new(), x.from, 0);
    for (i, s) in plot.series.iter().enumerate().filter(|(_, s)| !s.label.is_empty()) {
        let (colour, width) = (plot.colour(i), 19.0 + crate::glyphs::strokes(&s.label, CAPITAL).1);
        if rows == 0 || at + width > x.to && at > x.from {
            (at, rows) = (x.from, rows + 1);
        }
        let down = KEY_ROW * (rows - 1) as f32;
        marks.push(Mark::Box { at: [at, 35.0 + down], size: [14.0, 4.0], colour, alpha: 255 });
        marks.push(text(&s.label, [at + 19.0, 41.0 + down], Anchor::Start, INK));
        at += width + 21.0;
    }
    (marks, rows)
}
