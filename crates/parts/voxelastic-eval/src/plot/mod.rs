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

mod axis;
mod layout;
mod legend;
mod marks;
mod model;
mod output;
#[cfg(test)]
mod tests;

pub use model::{Limit, Plot, Series, SeriesStyle};
