//! Small statistics of series.

use serde::{Deserialize, Serialize};

/// Summary of a series; all `None` for an empty one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Half of the values are at most this.
    pub median: Option<f64>,
    /// 95 % are at most this.
    pub p95: Option<f64>,
    /// Arithmetic mean.
    pub mean: Option<f64>,
}

impl Spread {
    /// Summarises `values`, to the nearest rank.
    pub fn of(values: &[f64]) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let rank = |share: f64| sorted[((sorted.len() as f64 * share).ceil() as usize).clamp(1, sorted.len()) - 1];
        Self { median: Some(rank(0.5)), p95: Some(rank(0.95)), mean: Some(values.iter().sum::<f64>() / values.len() as f64) }
    }
}

/// Mean of a slice; none when it is empty.
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Mean of the last `count` values over that of the first; none where the two would overlap.
pub(crate) fn last_over_first(values: &[f64], count: usize) -> Option<f64> {
    if values.len() < 2 * count {
        return None;
    }
    Some(mean(&values[values.len() - count..])? / mean(&values[..count])?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_are_ranks() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(Spread::of(&values), Spread { median: Some(50.0), p95: Some(95.0), mean: Some(50.5) });
        assert_eq!(Spread::of(&[]), Spread::default());
    }

    #[test]
    fn the_end_is_compared_with_the_beginning() {
        let values: Vec<f64> = (0..10).map(|i| if i < 5 { 2.0 } else { 3.0 }).collect();
        assert_eq!(last_over_first(&values, 5), Some(1.5));
        assert_eq!(last_over_first(&values, 6), None);
    }
}
