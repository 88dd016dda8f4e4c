//! How a node is: figures for viewers and other nodes, and a warning where scans come too fast.

use super::watch::Figures;
use crate::ros::messages::Health;
use std::time::{Duration, Instant};
use voxelastic_run::{Mapping, Warning, usage};

/// How a node is, in words and figures, with what its run has said, by code. `is_worse` says that scans were left out since it was asked last.
pub fn diagnosis(figures: &Figures, warnings: &[Warning], is_worse: bool, is_paused: bool) -> (Health, String, Vec<(String, String)>) {
    let (health, words) = match (is_paused, is_worse) {
        (true, _) => (Health::Warning, "paused"),
        (_, true) => (Health::Warning, "scans come faster than they can be mapped"),
        _ => (Health::Ok, figures.state),
    };
    let pair = |key: &str, value: String| (key.to_owned(), value);
    let mut all = vec![
        pair("scans", figures.scans.to_string()),
        pair("scans_left_out", figures.left_out.to_string()),
        pair("submaps", figures.submaps.to_string()),
        pair("map_mb", format!("{:.1}", figures.map_mb)),
    ];
    all.extend(figures.rss_mb.map(|mb| pair("rss_mb", format!("{mb:.1}"))));
    all.extend(figures.delay_ms.map(|ms| pair("delay_ms", format!("{ms:.1}"))));
    all.extend(warnings.iter().map(|w| (format!("warning {}", w.code), format!("{} x: {}", w.count, w.text))));
    (health, words.to_owned(), all)
}

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
