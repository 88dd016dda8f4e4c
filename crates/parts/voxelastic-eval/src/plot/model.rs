//! What a plot shows.

use crate::colour::{Rgb, palette};
use crate::picture::Size;
use crate::stats::Histogram;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SeriesStyle {
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
    /// Name in the legend; not listed when empty.
    pub label: String,
    /// Points x, y. One that is not finite interrupts a line.
    pub points: Vec<[f64; 2]>,
    /// How it is drawn.
    pub style: SeriesStyle,
    /// Colour; from the palette by position when absent.
    pub colour: Option<Rgb>,
}

impl Series {
    /// A line.
    pub fn line(label: &str, points: Vec<[f64; 2]>) -> Self {
        Self { label: label.into(), points, style: SeriesStyle::Line, colour: None }
    }

    /// Dots.
    pub fn dots(label: &str, points: Vec<[f64; 2]>) -> Self {
        Self { label: label.into(), points, style: SeriesStyle::Dots, colour: None }
    }

    /// The bars of an error histogram: x in centimetres, y in percent of all distances. Empty bins at the end are left out.
    pub fn histogram(label: &str, histogram: &Histogram) -> Self {
        let all = (histogram.counts.iter().sum::<u64>() + histogram.above).max(1) as f64;
        let bin = histogram.bin_m * 100.0;
        let used = histogram.counts.iter().rposition(|c| *c > 0).map_or(0, |last| last + 1).max(10).min(histogram.counts.len());
        let points = histogram.counts[..used].iter().enumerate().map(|(i, c)| [(i as f64 + 0.5) * bin, 100.0 * *c as f64 / all]).collect();
        Self { label: label.into(), points, style: SeriesStyle::Bars(bin), colour: None }
    }
}

/// A limit, drawn as a dashed horizontal line.
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
    /// Title.
    pub title: String,
    /// What x is, with unit.
    pub x_label: String,
    /// What y is, with unit.
    pub y_label: String,
    /// The series.
    pub series: Vec<Series>,
    /// The limits.
    pub limits: Vec<Limit>,
    /// Size in user units with a legend of one row; further rows are added to the height. Default 720 x 400.
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

    /// Colour of a series.
    pub(super) fn colour(&self, series: usize) -> Rgb {
        self.series[series].colour.unwrap_or_else(|| palette(series))
    }
}
