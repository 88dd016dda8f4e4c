//! Figures of a node for viewers and other nodes, and a warning where scans come too fast.

use super::watch::Figures;
use std::time::{Duration, Instant};
use voxelastic_run::{Mapping, usage};

/// The figures of a node.
pub fn figures(state: &'static str, left_out: usize, delay_ms: Option<f64>, mapping: &Mapping) -> Figures {
    let atlas = mapping.atlas();
    Figures {
        state,
        scans: mapping.scans(),
        left_out,
        submaps: atlas.submaps().len(),
        map_mb: usage::megabytes(atlas.bytes() as u64),
        rss_mb: usage::resident_bytes().map(usage::megabytes),
        delay_ms,
    }
}

/// Warnings about scans that were left out are at least this far apart.
const WARNING_PERIOD: Duration = Duration::from_secs(10);

/// Says that scans are left out, now and then.
#[derive(Default)]
pub struct OverloadWarning {
    warned_of: usize,
    at: Option<Instant>,
}

impl OverloadWarning {
    pub fn check(&mut self, left_out: usize) {
        if left_out > self.warned_of && self.at.is_none_or(|at| at.elapsed() > WARNING_PERIOD) {
            tracing::warn!("scans come faster than they can be mapped: {left_out} left out so far; the newest win");
            (self.warned_of, self.at) = (left_out, Some(Instant::now()));
        }
    }
}
