//! What came of a node: its map, to be saved, and its figures.

use super::exploring::ExplorationSummary;
use super::figures;
use super::tally::Tally;
use super::watch::Watch;
use std::time::Instant;
use voxelastic_eval::SeriesStats;
use voxelastic_report::RunLog;
use voxelastic_run::keep::Target;
use voxelastic_run::{MappingRun, Result};

/// A node whose input has ended.
pub struct Played {
    /// The run, with the map.
    pub run: MappingRun,
    /// Scans that came, with those that came to an earlier process.
    pub scans_came: usize,
    /// Scans that were left out, because newer ones came before they could be mapped, with those of an earlier process.
    pub scans_left_out: usize,
    /// Scans that could not be used.
    pub scans_skipped: usize,
    /// How much later than its time stamp says a scan was read, at most, milliseconds.
    pub late_ms: f64,
    /// Messages of topics that were not looked at.
    pub messages_lost: usize,
    /// Whether a decoder failed in a way that is a mistake of this program.
    pub is_broken: bool,
    /// From the start to the last scan, seconds.
    pub played_s: f64,
    /// When it began.
    pub start: Instant,
    pub(super) is_robot: bool,
    pub(super) left_out_now: usize,
    pub(super) tally: Tally,
    pub(super) watch: Option<Watch>,
}

/// Delays, milliseconds.
#[derive(Clone, Copy, Debug)]
pub struct DelayFigures {
    /// Median, 95th percentile and mean.
    pub stats: SeriesStats,
    /// 99 of 100 are within it; none without delays.
    pub p99: Option<f64>,
}

impl Played {
    /// Whether it was stopped before its input ended.
    pub fn is_interrupted(&self) -> bool {
        self.tally.interrupted
    }

    /// Scans that were ignored, because mapping was paused on request.
    pub fn scans_paused(&self) -> usize {
        self.tally.paused
    }

    /// From the coming of a scan to the end of its integration.
    pub fn delays(&self) -> DelayFigures {
        DelayFigures { stats: self.tally.delays_ms.stats(), p99: self.tally.delays_ms.quantile(0.99) }
    }

    /// From the coming of a scan to the first change of the surface after it in the viewer's server.
    pub fn delays_to_viewers(&self) -> DelayFigures {
        DelayFigures { stats: self.tally.shown_ms.stats(), p99: self.tally.shown_ms.quantile(0.99) }
    }

    /// What was planned, if the robot explores.
    pub fn exploration(&self) -> Option<ExplorationSummary> {
        self.tally.exploration.clone()
    }

    /// Saves the map with the log of the run. Returns the size of the map on disk, bytes.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&mut self) -> Result<u64> {
        let saved = self.run.save()?;
        let total_s = self.start.elapsed().as_secs_f64();
        let log = RunLog { total_s, interrupted: self.is_interrupted(), scans_skipped: self.scans_skipped, ..self.run.log() };
        self.run.save_log(&log);
        Ok(saved.bytes)
    }

    /// Whether a run was ended that can be gone on with. Nothing but an interrupt ends a robot's topics, so that is no such end.
    pub fn can_go_on(&self) -> bool {
        self.is_interrupted() && !self.is_robot
    }

    /// Whether the map was saved in another folder than it was asked for.
    pub fn is_elsewhere(&self) -> bool {
        self.run.target().is_some_and(Target::is_elsewhere)
    }

    /// Removes what was kept to go on, and shows the map of a recording that has ended until it `is_stopped`. Nobody looks at that of a robot, which only an
    /// interrupt ends.
    pub fn end(&mut self, is_stopped: fn() -> bool) {
        if !self.can_go_on() {
            self.run.discard_checkpoints();
        }
        if let Some(mut watch) = self.watch.take().filter(|_| !self.is_robot && !self.tally.interrupted) {
            let mapping = self.run.mapping();
            watch.publisher.note(mapping.mapper(), None);
            let figures = figures::figures("finished", self.left_out_now, self.tally.delays_ms.last(), mapping);
            watch.stay(mapping.atlas(), mapping.pool(), figures, is_stopped);
        }
    }
}
