//! What is counted and timed in a run.

use super::delays::Delays;
use super::exploring::ExplorationSummary;
use std::time::Instant;

/// Counts of a run.
#[derive(Debug, Default)]
pub struct Tally {
    /// Whether a signal ended the run.
    pub interrupted: bool,
    /// Scans that were ignored, because mapping was paused.
    pub paused: usize,
    /// Scans whose place in the map of before was not found until the end.
    pub not_located: usize,
    /// Scans that had been left out when figures were published last.
    pub left_out: usize,
    /// From the coming of each scan to the end of its integration, milliseconds.
    pub delays_ms: Delays,
    /// From the coming of each scan to the first change of the surface after it that viewers were told, milliseconds.
    pub shown_ms: Delays,
    /// When the scans came whose change viewers were not told yet, and how many of them are in the tiles that are being made.
    pub unshown: Vec<Instant>,
    pub in_work: usize,
    /// What was planned, if the robot explores.
    pub exploration: Option<ExplorationSummary>,
}

impl Tally {
    /// Notes that viewers were told about a change of the surface.
    pub fn note_shown(&mut self) {
        let shown = std::mem::take(&mut self.in_work).min(self.unshown.len());
        self.unshown.drain(..shown).for_each(|came| self.shown_ms.push(came.elapsed().as_secs_f64() * 1e3));
    }
}
