//! Statistics of distances, with stable JSON keys.

use super::quantile::interpolated;
use rayon::prelude::*;
use serde::Serialize;

/// Statistics of distances. All lengths in metres.
///
/// A distance beyond the cut-off (infinite) is a miss: it counts as the largest in shares and percentiles and is left out of means. Undefined numbers
/// are `None` (`null` in JSON).
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DistanceStats {
    /// Distances measured, misses included.
    pub count: usize,
    /// Distances beyond the cut-off.
    pub missed: usize,
    /// NaN inputs, which are left out.
    pub invalid: usize,
    /// Mean without misses.
    pub mean: Option<f64>,
    /// Standard deviation without misses.
    pub std_dev: Option<f64>,
    /// Root mean square without misses.
    pub rmse: Option<f64>,
    /// Half of the distances are at most this.
    pub median: Option<f64>,
    /// 90 % of the distances are at most this.
    pub p90: Option<f64>,
    /// 95 % of the distances are at most this.
    pub p95: Option<f64>,
    /// 99 % of the distances are at most this.
    pub p99: Option<f64>,
    /// Largest without misses.
    pub max: Option<f64>,
    /// Share under 5 cm, 0 to 1.
    pub fraction_under_5cm: Option<f64>,
    /// Share under 10 cm.
    pub fraction_under_10cm: Option<f64>,
    /// Share under 20 cm.
    pub fraction_under_20cm: Option<f64>,
    /// Share under 50 cm.
    pub fraction_under_50cm: Option<f64>,
    /// Counts by distance, 1 cm per bin up to 1 m.
    pub histogram: Histogram,
}

/// Counts of distances in bins of equal width from zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Histogram {
    /// Width of a bin, metres.
    pub bin_m: f64,
    /// Distances in each bin; the first begins at zero.
    pub counts: Vec<u64>,
    /// Distances beyond the last bin, misses included.
    pub above: u64,
}

/// Bins of [`DistanceStats::histogram`]: 1 cm each, to 1 m.
const BIN_M: f64 = 0.01;
const BINS: usize = 100;

impl DistanceStats {
    /// Statistics of the absolute values of distances in metres.
    pub fn new(distances: &[f32]) -> Self {
        let mut sorted: Vec<f32> = distances.par_iter().map(|d| d.abs()).filter(|d| !d.is_nan()).collect();
        sorted.par_sort_unstable_by(f32::total_cmp);
        let invalid = distances.len() - sorted.len();
        let finite = &sorted[..sorted.partition_point(|d| d.is_finite())];
        let mut out =
            Self { count: sorted.len(), missed: sorted.len() - finite.len(), invalid, histogram: Histogram::of_sorted(&sorted), ..Self::default() };
        if let Some(&max) = finite.last() {
            // Serial sums over the sorted values: the same for any number of threads.
            let n = finite.len() as f64;
            let mean = finite.iter().map(|&d| f64::from(d)).sum::<f64>() / n;
            let square = finite.iter().map(|&d| f64::from(d).powi(2)).sum::<f64>() / n;
            let variance = finite.iter().map(|&d| (f64::from(d) - mean).powi(2)).sum::<f64>() / n;
            (out.mean, out.rmse, out.std_dev, out.max) = (Some(mean), Some(square.sqrt()), Some(variance.sqrt()), Some(f64::from(max)));
        }
        let at = |share: f64| interpolated(&sorted, share);
        (out.median, out.p90, out.p95, out.p99) = (at(0.5), at(0.9), at(0.95), at(0.99));
        let under = |limit: f32| (!sorted.is_empty()).then(|| sorted.partition_point(|d| *d < limit) as f64 / sorted.len() as f64);
        (out.fraction_under_5cm, out.fraction_under_10cm) = (under(0.05), under(0.1));
        (out.fraction_under_20cm, out.fraction_under_50cm) = (under(0.2), under(0.5));
        out
    }
}

impl Histogram {
    fn of_sorted(sorted: &[f32]) -> Self {
        let below = |i: usize| sorted.partition_point(|d| f64::from(*d) < i as f64 * BIN_M) as u64;
        let edges: Vec<u64> = (0..=BINS).map(below).collect();
        Self { bin_m: BIN_M, counts: edges.windows(2).map(|w| w[1] - w[0]).collect(), above: sorted.len() as u64 - edges[BINS] }
    }
}

/// Share of distances below a limit, 0 to 1. Misses count as above it, NaN is left out. None for no distances.
pub fn fraction_under(distances: &[f32], limit: f32) -> Option<f64> {
    let valid = distances.par_iter().filter(|d| !d.is_nan()).count();
    let under = distances.par_iter().filter(|d| d.abs() < limit).count();
    (valid > 0).then(|| under as f64 / valid as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_known_distances() {
        let distances: Vec<f32> = (0..=100).map(|i| i as f32 / 100.0).collect();
        let s = DistanceStats::new(&distances);
        let near = |a: Option<f64>, b: f64| (a.unwrap() - b).abs() < 1e-6;
        assert!(near(s.mean, 0.5) && near(s.median, 0.5) && near(s.p90, 0.9) && near(s.max, 1.0));
        assert!(near(s.fraction_under_10cm, 10.0 / 101.0) && near(s.rmse, (0.335f64).sqrt()));
        assert_eq!(s.histogram.counts.iter().sum::<u64>() + s.histogram.above, 101);
    }

    #[test]
    fn misses_are_largest_and_nan_is_left_out() {
        let s = DistanceStats::new(&[0.01, -0.02, f32::INFINITY, f32::INFINITY, f32::NAN]);
        assert_eq!((s.count, s.missed, s.invalid), (4, 2, 1));
        assert_eq!((s.p90, s.fraction_under_5cm), (None, Some(0.5)));
        assert!((s.mean.unwrap() - 0.015).abs() < 1e-6);
        assert_eq!(fraction_under(&[0.01, f32::INFINITY, f32::NAN], 0.05), Some(0.5));
    }

    #[test]
    fn undefined_numbers_are_null_in_json() {
        let json = serde_json::to_value(DistanceStats::new(&[])).unwrap();
        assert!(json["mean"].is_null() && json["p90"].is_null() && json["fraction_under_5cm"].is_null());
        assert_eq!(json["count"], 0);
    }
}
