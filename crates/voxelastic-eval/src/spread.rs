//! A series of times or lengths in three numbers.

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_are_ranks() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(Spread::of(&values), Spread { median: Some(50.0), p95: Some(95.0), mean: Some(50.5) });
        assert_eq!(Spread::of(&[3.0]).p95, Some(3.0));
        assert_eq!(Spread::of(&[]), Spread::default());
    }
}
