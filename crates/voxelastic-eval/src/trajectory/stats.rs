//! Statistics of a list of errors.

use serde::Serialize;

/// Statistics of errors that are all there (no misses); the unit is that of the errors.
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
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else { return Self::default() };
        let n = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / n;
        let square = sorted.iter().map(|v| v * v).sum::<f64>() / n;
        let middle = sorted.len() / 2;
        let median = if sorted.len() % 2 == 1 { sorted[middle] } else { 0.5 * (sorted[middle - 1] + sorted[middle]) };
        Self { rmse: square.sqrt(), mean, median, std_dev: (square - mean * mean).max(0.0).sqrt(), min, max }
    }
}
