//! Small plots for reports: lines, points and histograms, as SVG text or PNG, drawn from the same marks.
//!
//! ```
//! use voxelastic_eval::plot::{Plot, Series};
//! let times: Vec<f64> = (0..50).map(|i| 6.0 + (f64::from(i) * 0.3).sin()).collect();
//! let mut plot = Plot::new("Time per scan", "scan", "ms");
//! plot.series.push(Series::line("TSDF", times.iter().enumerate().map(|(i, t)| [i as f64, *t]).collect()));
//! plot.mark_y(100.0, "sensor period");
//! assert!(plot.to_svg().starts_with("<svg"));
//! ```

mod axes;
mod marks;
#[cfg(test)]
mod tests;

use crate::colour::{Rgb, palette};
use crate::error::Result;
use crate::render::Size;
use crate::stats::Histogram;
use crate::{EvalError, canvas::Canvas};
use std::path::Path;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Look {
    /// A line through the points, in their order.
    Line,
    /// A dot at each point.
    Dots,
    /// Bars from zero, this wide in units of x, centred on the points.
    Bars(f64),
}

/// One set of points.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the key; none when empty.
    pub label: String,
    /// x, y. A point that is not finite interrupts a line.
    pub points: Vec<[f64; 2]>,
    /// How it is drawn.
    pub look: Look,
    /// Colour; from the palette by position when absent.
    pub colour: Option<Rgb>,
}

impl Series {
    /// A line.
    pub fn line(label: &str, points: Vec<[f64; 2]>) -> Self {
        Self { label: label.into(), points, look: Look::Line, colour: None }
    }

    /// Dots.
    pub fn dots(label: &str, points: Vec<[f64; 2]>) -> Self {
        Self { label: label.into(), points, look: Look::Dots, colour: None }
    }

    /// The bars of an error histogram: x in centimetres, y in percent of all distances. Empty bins at the end are left out.
    pub fn histogram(label: &str, histogram: &Histogram) -> Self {
        let all = (histogram.counts.iter().sum::<u64>() + histogram.above).max(1) as f64;
        let bin = histogram.bin_m * 100.0;
        let used = histogram.counts.iter().rposition(|c| *c > 0).map_or(0, |last| last + 1).max(10).min(histogram.counts.len());
        let points = histogram.counts[..used].iter().enumerate().map(|(i, c)| [(i as f64 + 0.5) * bin, 100.0 * *c as f64 / all]).collect();
        Self { label: label.into(), points, look: Look::Bars(bin), colour: None }
    }
}

/// A horizontal line that stands for a limit.
#[derive(Clone, Debug)]
pub struct Limit {
    /// Its value on the y axis.
    pub y: f64,
    /// What it is.
    pub label: String,
}

/// A plot. Its axes start at zero where the values are positive, and end at round numbers.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Heading.
    pub title: String,
    /// What x is, with unit.
    pub x_label: String,
    /// What y is, with unit.
    pub y_label: String,
    /// What is drawn.
    pub series: Vec<Series>,
    /// Limits drawn as dashed lines.
    pub limits: Vec<Limit>,
    /// Size in pixels (PNG) or user units (SVG). Default 720 x 400.
    pub size: Size,
}

impl Plot {
    /// An empty plot.
    pub fn new(title: &str, x_label: &str, y_label: &str) -> Self {
        Self {
            title: title.into(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            series: Vec::new(),
            limits: Vec::new(),
            size: Size { width: 720, height: 400 },
        }
    }

    /// Adds a dashed line at a value of y.
    pub fn mark_y(&mut self, y: f64, label: &str) {
        self.limits.push(Limit { y, label: label.into() });
    }

    /// The plot as an SVG element that stands alone or inside HTML.
    pub fn to_svg(&self) -> String {
        marks::svg(&axes::layout(self), self.size)
    }

    /// Writes an SVG file.
    ///
    /// # Errors
    /// [`EvalError::Write`].
    pub fn write_svg(&self, path: &Path) -> Result<()> {
        std::fs::write(path, self.to_svg()).map_err(|source| EvalError::Write { path: path.to_owned(), source })
    }

    /// Writes a PNG file, twice as many pixels as [`Plot::size`] each way so that it is sharp in print.
    ///
    /// # Errors
    /// [`EvalError::Write`], and [`EvalError::Picture`] for a size of zero or beyond memory.
    pub fn write_png(&self, path: &Path) -> Result<()> {
        let size = Size { width: self.size.width.saturating_mul(2), height: self.size.height.saturating_mul(2) };
        let mut canvas = Canvas::new(size, [255; 3])?;
        marks::draw(&mut canvas, &axes::layout(self), 2.0);
        canvas.write_png(path)
    }

    fn colour(&self, series: usize) -> Rgb {
        self.series[series].colour.unwrap_or_else(|| palette(series))
    }
}
