//! Counter-based random numbers: they do not depend on the order of use, so results are the same for any number of threads.

/// A stream of random numbers identified by a seed and a few counters (scan, pixel, purpose).
///
/// Each draw is a hash of the stream's identity and the number of the draw (the finaliser of SplitMix64, Steele et al.,
/// OOPSLA 2014), so that threads share no state.
#[derive(Clone, Debug)]
pub struct Stream {
    state: u64,
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Stream {
    /// The stream with counters `path` and a seed.
    pub fn new(seed: u64, path: &[u64]) -> Self {
        let state = path.iter().fold(mix(seed.wrapping_add(GOLDEN)), |s, &p| mix(s ^ mix(p.wrapping_add(GOLDEN))));
        Self { state }
    }

    /// The stream with one more counter; does not advance this stream.
    #[inline]
    pub fn fork(&self, counter: u64) -> Self {
        Self { state: mix(self.state ^ mix(counter.wrapping_add(GOLDEN))) }
    }

    /// 64 random bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN);
        mix(self.state)
    }

    /// Uniform in 0..1.
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `low..high`.
    #[inline]
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform among `0..count`; 0 when `count` is 0.
    pub fn index(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Nearly Gaussian with mean 0 and variance 1: the sum of four uniform numbers of 16 bits, which ends at 3.5 sigma.
    ///
    /// Needs one hash and no transcendental function, so that every platform draws the same number.
    #[inline]
    pub fn normal(&mut self) -> f64 {
        let bits = self.bits();
        let sum = (bits & 0xffff) + ((bits >> 16) & 0xffff) + ((bits >> 32) & 0xffff) + (bits >> 48);
        // Four uniform numbers on 0..=65535: mean 2 * 65535, variance 4 * (65536^2 - 1) / 12.
        (sum as f64 - 131_070.0) / 37_837.227_2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_a_gaussian() {
        let mut stream = Stream::new(7, &[1, 2]);
        let n = 200_000;
        let draws: Vec<f64> = (0..n).map(|_| stream.normal()).collect();
        let mean = draws.iter().sum::<f64>() / f64::from(n);
        let variance = draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / f64::from(n);
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.01, "{mean} {variance}");
        assert!(draws.iter().all(|d| d.abs() < 3.47));
    }

    #[test]
    fn streams_with_different_counters_differ() {
        let draw = |path: &[u64]| Stream::new(1, path).bits();
        assert_eq!(draw(&[3, 4]), draw(&[3, 4]));
        assert_ne!(draw(&[3, 4]), draw(&[4, 3]));
        assert_ne!(draw(&[3]), draw(&[3, 0]));
        let parent = Stream::new(1, &[3]);
        assert_eq!(parent.fork(4).bits(), draw(&[3, 4]));
        assert_ne!(parent.fork(4).uniform(), parent.fork(5).uniform());
    }
}
