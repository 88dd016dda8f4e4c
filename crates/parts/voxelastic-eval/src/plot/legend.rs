//! The legend: a colour and a name for each series, in rows above the plot.

use super::marks::{CAPITAL, INK, Mark, text};
use super::model::Plot;
use crate::canvas::Anchor;
use crate::glyphs;

/// Height of a row.
pub(super) const ROW: f32 = 17.0;
/// From the left edge of an entry to its name.
const SWATCH: f32 = 19.0;
/// Between two entries of a row.
const GAP: f32 = 21.0;

/// Marks of the legend between two page coordinates, and its number of rows.
pub(super) fn legend(plot: &Plot, (left, right): (f32, f32)) -> (Vec<Mark>, usize) {
    let (mut marks, mut at, mut rows) = (Vec::new(), left, 0);
    for (i, s) in plot.series.iter().enumerate().filter(|(_, s)| !s.label.is_empty()) {
        let label = shortened(&s.label, right - left - SWATCH);
        let width = SWATCH + glyphs::strokes(&label, CAPITAL).1;
        if rows == 0 || at + width > right && at > left {
            (at, rows) = (left, rows + 1);
        }
        let down = ROW * (rows - 1) as f32;
        marks.push(Mark::Box { at: [at, 35.0 + down], size: [14.0, 4.0], colour: plot.colour(i), alpha: 255 });
        marks.push(text(&label, [at + SWATCH, 41.0 + down], Anchor::Start, INK));
        at += width + GAP;
    }
    (marks, rows)
}

/// A label of at most `width`; the end of a longer one is replaced by two dots.
fn shortened(label: &str, width: f32) -> String {
    let fits = |text: &str| glyphs::strokes(text, CAPITAL).1 <= width;
    if fits(label) {
        return label.to_owned();
    }
    let mut short = label.to_owned();
    while short.pop().is_some() && !fits(&format!("{short}..")) {}
    short + ".."
}
