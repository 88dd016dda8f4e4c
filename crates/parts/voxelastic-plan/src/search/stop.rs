//! When a search stops: limits of time and of samples.

use std::time::{Duration, Instant};

/// Limits of a search, whichever is reached first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StopCriterion {
    started: Instant,
    time: Duration,
    samples: usize,
}

impl StopCriterion {
    /// Starts the clock. No limit of samples if `samples` is none.
    pub(crate) fn new(time: Duration, samples: Option<usize>) -> Self {
        Self { started: Instant::now(), time, samples: samples.unwrap_or(usize::MAX) }
    }

    /// The same start with a fraction (0 to 1) of the time and of the samples.
    pub(crate) fn fraction(&self, fraction: f64) -> Self {
        let samples = if self.samples == usize::MAX { self.samples } else { (self.samples as f64 * fraction) as usize };
        Self { time: self.time.mul_f64(fraction), samples, ..*self }
    }

    /// The same time limit with another limit of samples.
    pub(crate) fn with_samples(&self, samples: usize) -> Self {
        Self { samples, ..*self }
    }

    /// Whether a limit is reached after this many samples.
    pub(crate) fn is_reached(&self, samples: usize) -> bool {
        samples >= self.samples || self.started.elapsed() >= self.time
    }

    /// Seconds since the start.
    pub(crate) fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}
