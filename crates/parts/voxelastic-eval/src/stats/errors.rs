//! Statistics of trajectory errors.

use super::quantile::interpolated;
use super::series::mean;
use serde::Serialize;

/// Statistics of errors that are all finite, in the unit of the errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ErrorStats {
    /// Root mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Standard deviation.
    pub std_dev: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl ErrorStats {
    /// Statistics of finite values; all zero for none.
    pub fn new(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max), Some(mean)) = (sorted.first(), sorted.last(), mean(&sorted)) else { return Self::default() };
        let square = sorted.iter().map(|v| v * v).sum::<f64>() / sorted.len() as f64;
        let median = interpolated(&sorted, 0.5).unwrap_or(mean);
        Self { rmse: square.sqrt(), mean, median, std_dev: (square - mean * mean).max(0.0).sqrt(), min, max }
    }
}
