//! Delays of a run of any length, in memory of a fixed size.

use std::collections::BTreeMap;
use voxelastic_eval::SeriesStats;

/// Delays that are kept as they are; of more, those within a hundredth are counted together.
const EXACT: usize = 4096;
/// The ratio of the ends of a class of delays.
const CLASS: f64 = 1.01;
/// Shorter delays are in one class, milliseconds.
const SHORTEST_MS: f64 = 1e-3;

/// Delays, milliseconds.
#[derive(Clone, Debug, Default)]
pub struct Delays {
    exact: Vec<f64>,
    /// How many are in each class.
    classes: BTreeMap<i32, usize>,
    count: usize,
    sum: f64,
    last: Option<f64>,
}

impl Delays {
    /// Adds one.
    pub fn push(&mut self, ms: f64) {
        (self.count, self.sum, self.last) = (self.count + 1, self.sum + ms, Some(ms));
        if self.classes.is_empty() {
            self.exact.push(ms);
            if self.exact.len() > EXACT {
                std::mem::take(&mut self.exact).into_iter().for_each(|ms| self.count_in_class(ms));
            }
        } else {
            self.count_in_class(ms);
        }
    }

    fn count_in_class(&mut self, ms: f64) {
        let class = (ms.max(SHORTEST_MS).ln() / CLASS.ln()).floor() as i32;
        *self.classes.entry(class).or_default() += 1;
    }

    /// The last one.
    pub fn last(&self) -> Option<f64> {
        self.last
    }

    /// The delay that a share of them does not exceed, of many to half a hundredth; none without delays.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let rank = ((self.count as f64 * share).ceil() as usize).max(1);
        if self.classes.is_empty() {
            let mut sorted = self.exact.clone();
            sorted.sort_unstable_by(f64::total_cmp);
            return sorted.get(rank - 1).copied();
        }
        let mut below = 0;
        let class = self.classes.iter().find(|(_, count)| {
            below += **count;
            below >= rank
        });
        class.map(|(class, _)| CLASS.powf(f64::from(*class) + 0.5))
    }

    /// Median, 95th percentile and mean.
    pub fn stats(&self) -> SeriesStats {
        let mean = (self.count > 0).then(|| self.sum / self.count as f64);
        SeriesStats { median: self.quantile(0.5), p95: self.quantile(0.95), mean }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn delays(count: usize) -> (Delays, Vec<f64>) {
        // All different, in no order.
        let all: Vec<f64> = (0..count).map(|k| 5.0 + (k * 7919 % count) as f64 * 200.0 / count as f64).collect();
        let mut delays = Delays::default();
        all.iter().for_each(|ms| delays.push(*ms));
        (delays, all)
    }

    #[test]
    fn few_delays_are_exact_and_many_within_a_hundredth() {
        assert_eq!((Delays::default().stats(), Delays::default().quantile(0.99)), (SeriesStats::default(), None));
        for count in [1, 100, EXACT, EXACT + 1, 50_000] {
            let (delays, all) = delays(count);
            let expected = SeriesStats::new(&all);
            if count <= EXACT {
                assert_eq!(delays.stats(), expected, "{count}");
            }
            let is_near = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| (a / b - 1.0).abs() < 0.01);
            let stats = delays.stats();
            assert!(is_near(stats.median, expected.median) && is_near(stats.p95, expected.p95) && is_near(stats.mean, expected.mean), "{count}");
            assert_eq!(delays.last(), all.last().copied());
            assert!(delays.exact.capacity() <= 2 * EXACT && delays.classes.len() < 1000, "bounded");
        }
    }
}
