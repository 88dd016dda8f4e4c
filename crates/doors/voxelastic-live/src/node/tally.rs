//! What is counted and timed in a run.

use super::delays::Delays;
use super::exploring::ExplorationSummary;
use crate::ros::messages::Health;
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
    /// Whether scans were left out since it was said how the node is.
    pub was_worse: bool,
    /// What was wrong when that was logged last.
    said: Option<(Health, String)>,
    /// What was planned, if the robot explores.
    pub exploration: Option<ExplorationSummary>,
}

impl Tally {
    /// Logs how the node is, when that has become better or worse.
    pub fn say(&mut self, health: Health, words: &str) {
        // Seconds that pass are nothing new.
        let what: String = words.chars().filter(|c| !c.is_ascii_digit()).collect();
        let is_new = self.said.as_ref().is_none_or(|(before, known)| *before != health || *known != what && health != Health::Ok);
        let was_well = self.said.as_ref().is_none_or(|(before, _)| *before == Health::Ok);
        if !is_new {
            return;
        }
        match health {
            Health::Ok if was_well => {}
            Health::Ok => tracing::info!("all is well again: {words}"),
            Health::Warning => tracing::warn!("{words}"),
            Health::Error => tracing::error!("{words}"),
        }
        self.said = Some((health, what));
    }

    /// Notes that viewers were told about a change of the surface.
    pub fn note_shown(&mut self) {
        let shown = std::mem::take(&mut self.in_work).min(self.unshown.len());
        self.unshown.drain(..shown).for_each(|came| self.shown_ms.push(came.elapsed().as_secs_f64() * 1e3));
    }
}
