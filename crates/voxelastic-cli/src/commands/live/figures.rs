//! How a node is: figures for viewers and other nodes, and a warning where scans come too fast.

use crate::mapping::Session;
use crate::usage;
use crate::watching::Figures;
use std::time::{Duration, Instant};
use voxelastic_live::ros::messages::Health;

/// How a node is, in words and figures. `is_worse` says that scans were left out since it was asked last.
pub fn diagnosis(figures: &Figures, is_worse: bool, is_paused: bool) -> (Health, String, Vec<(&'static str, String)>) {
    let (health, words) = match (is_paused, is_worse) {
        (true, _) => (Health::Warning, "paused"),
        (_, true) => (Health::Warning, "scans come faster than they can be mapped"),
        _ => (Health::Ok, figures.state),
    };
    let mut all = vec![
        ("scans", figures.scans.to_string()),
        ("scans_left_out", figures.left_out.to_string()),
        ("submaps", figures.submaps.to_string()),
        ("map_mb", format!("{:.1}", figures.map_mb)),
    ];
    all.extend(figures.rss_mb.map(|mb| ("rss_mb", format!("{mb:.1}"))));
    all.extend(figures.delay_ms.map(|ms| ("delay_ms", format!("{ms:.1}"))));
    (health, words.to_owned(), all)
}

/// The figures of a node.
pub fn figures(state: &'static str, left_out: usize, delay_ms: Option<f64>, session: &Session) -> Figures {
    let atlas = session.mapper().atlas();
    Figures {
        state,
        scans: session.scans(),
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
