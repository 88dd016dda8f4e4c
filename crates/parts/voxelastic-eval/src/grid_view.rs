//! A grid of coloured cells in a plane (a slice of a map, for instance), with lines and dots over it, axes in metres, a scale bar and a legend.
//!
//! ```
//! use voxelastic_eval::grid_view::GridView;
//! let cells = [[255, 255, 255], [20, 20, 20]];
//! let view = GridView { size: [2, 1], pixel: 0.1, cells: &cells, labels: ["x [m]", "y [m]"], ..GridView::default() };
//! assert!(view.picture()?.pixels.contains(&[20, 20, 20]));
//! # Ok::<(), voxelastic_eval::EvalError>(())
//! ```

use crate::EvalError;
use crate::canvas::{Anchor, Canvas};
use crate::colour::Rgb;
use crate::error::Result;
use crate::picture::{Picture, Size};
use crate::round_number::round_number;
use std::path::Path;

const INK: Rgb = [40, 44, 52];
const SOFT: Rgb = [110, 116, 126];
const PAPER: Rgb = [255, 255, 255];
/// Height of capitals, pixels.
const CAPITAL: f32 = 12.0;
/// Margins around the cells: left, top, right, bottom, pixels.
const MARGIN: [u32; 4] = [84, 48, 28, 96];
/// Cells are magnified to about this many pixels along the longer side.
const TARGET_SIZE: usize = 1400;

/// A polyline over the cells.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its points in the coordinates of the plane, metres.
    pub points: Vec<[f64; 2]>,
    /// Colour.
    pub colour: Rgb,
    /// Width, pixels of the picture.
    pub width: f32,
}

/// A round mark over cells and lines.
#[derive(Clone, Copy, Debug)]
pub struct Dot {
    /// Its centre in the coordinates of the plane, metres.
    pub at: [f64; 2],
    /// Colour.
    pub colour: Rgb,
    /// Radius, pixels of the picture.
    pub radius: f32,
}

/// A grid of cells in a plane, with annotations.
#[derive(Clone, Debug, Default)]
pub struct GridView<'a> {
    /// Title; none when empty.
    pub title: String,
    /// Labels of the horizontal and vertical axis, with units.
    pub labels: [&'a str; 2],
    /// Coordinates of the lower left corner, metres.
    pub origin: [f64; 2],
    /// Edge of a cell, metres.
    pub pixel: f64,
    /// Cells across and up.
    pub size: [usize; 2],
    /// Colours row by row, bottom row first.
    pub cells: &'a [Rgb],
    /// Legend: colours and their meanings.
    pub legend: Vec<(Rgb, String)>,
    /// Lines over the cells, drawn in this order.
    pub lines: Vec<Line>,
    /// Marks, drawn over the lines.
    pub dots: Vec<Dot>,
}

impl GridView<'_> {
    /// Draws the view.
    ///
    /// # Errors
    /// [`EvalError::Length`] when the cells do not fill the size, [`EvalError::Picture`] when a side is zero or too large.
    pub fn picture(&self) -> Result<Picture> {
        Ok(self.draw()?.into_picture())
    }

    /// Draws the view into a PNG file.
    ///
    /// # Errors
    /// Those of [`GridView::picture`], and [`EvalError::Write`].
    pub fn write_png(&self, path: &Path) -> Result<()> {
        self.draw()?.write_png(path)
    }

    fn draw(&self) -> Result<Canvas> {
        let [across, up] = self.size;
        if across.checked_mul(up) != Some(self.cells.len()) {
            return Err(EvalError::Length { what: "cells", got: self.cells.len(), expected: across.saturating_mul(up) });
        }
        let zoom = (TARGET_SIZE / across.max(up).max(1)).clamp(1, 16);
        let [left, top, right, bottom] = MARGIN;
        let side = |cells: usize, margins: u32| u32::try_from(cells * zoom).ok().and_then(|n| n.checked_add(margins)).filter(|_| cells > 0);
        let (width, height) = (side(across, left + right).unwrap_or(0), side(up, top + bottom).unwrap_or(0));
        let mut picture = Picture { size: Size { width, height }, pixels: vec![PAPER; width as usize * height as usize] };
        for (row, cells) in self.cells.chunks(across.max(1)).enumerate() {
            for line in 0..zoom {
                let y = top as usize + (up - 1 - row) * zoom + line;
                let start = y * width as usize + left as usize;
                for (i, &cell) in cells.iter().enumerate() {
                    picture.pixels[start + i * zoom..start + (i + 1) * zoom].fill(cell);
                }
            }
        }
        let mut canvas = Canvas::from_picture(&picture)?;
        let frame = Frame {
            left: left as f32,
            top: top as f32,
            width: (across * zoom) as f32,
            height: (up * zoom) as f32,
            per_metre: zoom as f64 / self.pixel,
        };
        self.overlay(&mut canvas, &frame);
        self.annotate(&mut canvas, &frame);
        Ok(canvas)
    }

    fn overlay(&self, canvas: &mut Canvas, frame: &Frame) {
        let position = |p: &[f64; 2]| {
            let along = |k: usize| ((p[k] - self.origin[k]) * frame.per_metre) as f32;
            [frame.left + along(0), frame.top + frame.height - along(1)]
        };
        for line in &self.lines {
            let points: Vec<[f32; 2]> = line.points.iter().map(position).collect();
            canvas.lines(std::iter::once(points.as_slice()), line.width, line.colour);
        }
        for dot in &self.dots {
            // A line of no length with round caps is a disc.
            let [x, y] = position(&dot.at);
            let point = [[x, y], [x + 0.01, y]];
            canvas.lines(std::iter::once(point.as_slice()), 2.0 * dot.radius + 3.0, PAPER);
            canvas.lines(std::iter::once(point.as_slice()), 2.0 * dot.radius, dot.colour);
        }
    }

    fn annotate(&self, canvas: &mut Canvas, frame: &Frame) {
        let (right, bottom) = (frame.left + frame.width, frame.top + frame.height);
        let corners = [[frame.left, frame.top], [right, frame.top], [right, bottom], [frame.left, bottom], [frame.left, frame.top]];
        canvas.lines(std::iter::once(corners.as_slice()), 1.5, INK);
        for (at, text) in frame.ticks(self.origin[0], frame.width) {
            let x = frame.left + at;
            canvas.lines(std::iter::once([[x, bottom], [x, bottom + 6.0]].as_slice()), 1.5, INK);
            canvas.text(&text, [x, bottom + 10.0 + CAPITAL], CAPITAL, Anchor::Middle, INK, false);
        }
        for (at, text) in frame.ticks(self.origin[1], frame.height) {
            let y = bottom - at;
            canvas.lines(std::iter::once([[frame.left - 6.0, y], [frame.left, y]].as_slice()), 1.5, INK);
            canvas.text(&text, [frame.left - 12.0, y + 0.5 * CAPITAL], CAPITAL, Anchor::End, INK, false);
        }
        canvas.text(self.labels[0], [frame.left + 0.5 * frame.width, bottom + 46.0], CAPITAL, Anchor::Middle, SOFT, false);
        canvas.text(self.labels[1], [22.0, frame.top + 0.5 * frame.height], CAPITAL, Anchor::Middle, SOFT, true);
        canvas.text(&self.title, [frame.left, frame.top - 16.0], 1.2 * CAPITAL, Anchor::Start, INK, false);
        let foot = bottom + 80.0;
        self.scale_bar(canvas, frame, foot);
        let mut x = right;
        for (colour, text) in self.legend.iter().rev() {
            canvas.text(text, [x, foot], CAPITAL, Anchor::End, INK, false);
            x -= 0.66 * CAPITAL * text.chars().count() as f32 + 26.0;
            canvas.fill([x - 1.0, foot - CAPITAL - 1.0], [CAPITAL + 2.0; 2], SOFT, 255);
            canvas.fill([x, foot - CAPITAL], [CAPITAL; 2], *colour, 255);
            x -= 20.0;
        }
    }

    fn scale_bar(&self, canvas: &mut Canvas, frame: &Frame, y: f32) {
        let metres = round_number(f64::from(frame.width) * 0.22 / frame.per_metre);
        let length = (metres * frame.per_metre) as f32;
        let x = frame.left;
        canvas.lines(std::iter::once([[x, y - 6.0], [x, y], [x + length, y], [x + length, y - 6.0]].as_slice()), 2.5, INK);
        canvas.text(&format!("{metres} m"), [x + length + 10.0, y], CAPITAL, Anchor::Start, INK, false);
    }
}

/// Position of the cells in the picture.
struct Frame {
    left: f32,
    top: f32,
    width: f32,
    height: f32,
    per_metre: f64,
}

impl Frame {
    /// Positions (pixels from the start of the axis) and texts of the ticks of an axis that starts at `first` metres.
    fn ticks(&self, first: f64, length: f32) -> Vec<(f32, String)> {
        let metres = f64::from(length) / self.per_metre;
        // Ticks at least 70 pixels apart, and no more than fit.
        let step = round_number((metres / 4.0).min((f64::from(length) / 70.0).max(1.0).recip() * metres * 2.5)).max(1e-9);
        let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        let start = (first / step).ceil();
        let count = ((metres / step).floor() as usize).min(64);
        let tick = |i: usize| {
            let value = (start + i as f64) * step;
            (((value - first) * self.per_metre) as f32, format!("{:.digits$}", if value.abs() < 1e-6 * step { 0.0 } else { value }))
        };
        (0..=count).map(tick).filter(|(at, _)| *at <= length).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_magnified_with_the_first_row_at_the_bottom() {
        let cells = [[10, 0, 0], [20, 0, 0], [30, 0, 0], [40, 0, 0], [50, 0, 0], [60, 0, 0]];
        let view = GridView {
            title: "test".into(),
            labels: ["x [m]", "y [m]"],
            origin: [-1.0, 2.0],
            pixel: 0.5,
            size: [3, 2],
            cells: &cells,
            legend: vec![([10, 0, 0], "one".into())],
            ..GridView::default()
        };
        let picture = view.picture().unwrap();
        let at = |column: usize, row: usize| {
            let (x, y) = (MARGIN[0] as usize + column * 16 + 8, MARGIN[1] as usize + row * 16 + 8);
            picture.pixels[y * picture.size.width as usize + x]
        };
        assert_eq!((picture.size.width, picture.size.height), (3 * 16 + 112, 2 * 16 + 144));
        assert_eq!((at(0, 1), at(2, 1), at(0, 0), at(2, 0)), ([10, 0, 0], [30, 0, 0], [40, 0, 0], [60, 0, 0]));
    }

    #[test]
    fn lines_and_dots_are_drawn_at_their_coordinates() {
        let cells = [PAPER; 4];
        let line = Line { points: vec![[0.0, 1.0], [2.0, 1.0]], colour: [0, 0, 200], width: 3.0 };
        let dot = Dot { at: [1.5, 1.6], colour: [0, 200, 0], radius: 3.0 };
        let view = GridView { size: [2, 2], pixel: 1.0, cells: &cells, lines: vec![line], dots: vec![dot], ..GridView::default() };
        let picture = view.picture().unwrap();
        let at = |x: f64, y: f64| {
            picture.pixels[(MARGIN[1] as usize + 32 - (y * 16.0) as usize) * picture.size.width as usize + MARGIN[0] as usize + (x * 16.0) as usize]
        };
        assert_eq!((at(0.5, 1.0), at(1.5, 1.6), at(0.5, 0.5)), ([0, 0, 200], [0, 200, 0], PAPER));
    }

    #[test]
    fn impossible_views_are_rejected() {
        assert!(matches!(GridView { size: [2, 2], ..GridView::default() }.picture(), Err(EvalError::Length { expected: 4, .. })));
        assert!(matches!(GridView::default().picture(), Err(EvalError::Picture { .. })));
    }

    #[test]
    fn ticks_are_round_numbers_within_the_axis() {
        let frame = Frame { left: 0.0, top: 0.0, width: 700.0, height: 700.0, per_metre: 20.0 };
        let ticks = frame.ticks(-12.3, 700.0);
        assert!((3..=10).contains(&ticks.len()), "{ticks:?}");
        assert!(ticks.iter().all(|(at, _)| (0.0..=700.0).contains(at)));
        assert!(ticks.iter().any(|(_, text)| text == "0"), "{ticks:?}");
    }
}
