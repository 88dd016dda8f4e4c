//! Statistics of a series of times or sizes.

use super::quantile::nearest_rank;
use serde::{Deserialize, Serialize};

/// Median, 95th percentile and mean of a series; all `None` for an empty one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SeriesStats {
    /// Half of the values are at most this.
    pub median: Option<f64>,
    /// 95 % of the values are at most this.
    pub p95: Option<f64>,
    /// Arithmetic mean.
    pub mean: Option<f64>,
}

impl SeriesStats {
    /// Statistics of `values`. Percentiles are to the nearest rank, so each is a value that was measured.
    pub fn new(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        Self { median: nearest_rank(&sorted, 0.5), p95: nearest_rank(&sorted, 0.95), mean: mean(values) }
    }
}

/// Arithmetic mean; none for no values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Mean of the last `count` values over that of the first `count`: how a cost grew. None where the two would overlap.
pub fn last_over_first(values: &[f64], count: usize) -> Option<f64> {
    if values.len() < 2 * count {
        return None;
    }
    Some(mean(&values[values.len() - count..])? / mean(&values[..count])?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_ranks() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(SeriesStats::new(&values), SeriesStats { median: Some(50.0), p95: Some(95.0), mean: Some(50.5) });
        assert_eq!(SeriesStats::new(&[3.0]).p95, Some(3.0));
        assert_eq!(SeriesStats::new(&[]), SeriesStats::default());
    }

    #[test]
    fn last_values_are_compared_with_the_first() {
        let values: Vec<f64> = (0..10).map(|i| if i < 5 { 2.0 } else { 3.0 }).collect();
        assert_eq!(last_over_first(&values, 5), Some(1.5));
        assert_eq!(last_over_first(&values, 6), None);
    }
}
