//! When to stop.

use std::time::{Duration, Instant};

/// Time and samples that a search may take.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    begun: Instant,
    time: Duration,
    samples: usize,
}

impl Budget {
    /// Begins now.
    pub(crate) fn new(time: Duration, samples: Option<usize>) -> Self {
        Self { begun: Instant::now(), time, samples: samples.unwrap_or(usize::MAX) }
    }

    /// The same with a share of the time and of the samples.
    pub(crate) fn part(&self, share: f64) -> Self {
        let samples = if self.samples == usize::MAX { self.samples } else { (self.samples as f64 * share) as usize };
        Self { time: self.time.mul_f64(share), samples, ..*self }
    }

    /// The same time with this many samples, counted anew.
    pub(crate) fn samples(&self, samples: usize) -> Self {
        Self { samples, ..*self }
    }

    pub(crate) fn is_spent(&self, samples: usize) -> bool {
        samples >= self.samples || self.begun.elapsed() >= self.time
    }

    /// Seconds since the beginning.
    pub(crate) fn seconds(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }
}
