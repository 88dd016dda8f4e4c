//! Layout of a plot: title, legend, axes, series and limits as marks on a page.

use super::axis::Axis;
use super::legend::{self, ROW};
use super::marks::{CAPITAL, INK, Mark, SOFT, text};
use super::model::{Plot, SeriesStyle};
use crate::canvas::Anchor;
use crate::colour::Rgb;
use crate::picture::Size;

const GRID: Rgb = [228, 231, 235];
const LIMIT: Rgb = [190, 60, 50];

/// A laid-out plot.
pub(super) struct Page {
    /// Size in user units: that of the plot, higher where the legend has more than one row.
    pub size: Size,
    /// All marks, background to foreground.
    pub marks: Vec<Mark>,
}

/// Lays out a plot.
pub(super) fn layout(plot: &Plot) -> Page {
    let w = plot.size.width as f32;
    let half_bar = plot.series.iter().map(|s| if let SeriesStyle::Bars(b) = s.style { b / 2.0 } else { 0.0 }).fold(0.0, f64::max);
    let xs = plot.series.iter().flat_map(|s| s.points.iter().flat_map(|p| [p[0] - half_bar, p[0] + half_bar]));
    let ys = plot.series.iter().flat_map(|s| s.points.iter().map(|p| p[1])).chain(plot.limits.iter().map(|l| l.y));
    let x = Axis::new(xs, 8.0, false, (64.0, w - 18.0));
    let (legend, rows) = legend::legend(plot, (x.from, x.to));
    // Further rows of the legend make the page higher, so that the plotting area keeps its size.
    let added = ROW * rows.saturating_sub(1) as f32;
    let size = Size { height: plot.size.height.saturating_add(added.ceil() as u32), ..plot.size };
    let y = Axis::new(ys, 5.0, true, (size.height as f32 - 48.0, 58.0 + added));
    let mut marks = Vec::new();
    frame(plot, &x, &y, &mut marks);
    for i in 0..plot.series.len() {
        series(plot, i, (&x, &y), &mut marks);
    }
    limits(plot, &x, &y, &mut marks);
    marks.extend(legend);
    Page { size, marks }
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
    match series.style {
        SeriesStyle::Line => {
            for run in series.points.split(|p| !finite(&p)).filter(|r| r.len() > 1) {
                out.push(Mark::Line { points: run.iter().map(place).collect(), width: 1.6, colour });
            }
        }
        SeriesStyle::Dots => out.extend(series.points.iter().filter(finite).map(|p| Mark::Dot { at: place(p), radius: 2.0, colour })),
        SeriesStyle::Bars(width) => {
            for p in series.points.iter().filter(finite) {
                let (left, right) = (x.at(p[0] - width / 2.0), x.at(p[0] + width / 2.0));
                let (top, bottom) = (y.at(p[1].max(0.0)), y.at(p[1].min(0.0)));
                // A gap of one unit between bars, unless they are too narrow for it.
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
