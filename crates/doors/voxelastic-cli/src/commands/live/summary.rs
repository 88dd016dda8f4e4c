//! The results of `voxelastic live`, as lines and as JSON.

use serde::Serialize;
use std::path::PathBuf;
use voxelastic_eval::SeriesStats;
use voxelastic_live::node::{ExplorationSummary, Played};
use voxelastic_run::corrections::ClosureSummary;
use voxelastic_run::keep::CheckpointSummary;
use voxelastic_run::mapping::TimeSummary;
use voxelastic_run::poses::OdometrySummary;
use voxelastic_run::{Warning, usage};

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// The map.
    #[serde(serialize_with = "crate::output::path")]
    output: PathBuf,
    /// Scans integrated.
    scans: usize,
    /// Of these, scans that an earlier process had mapped, with whose run this one has gone on.
    scans_resumed: usize,
    /// Scans that came, with those that came to an earlier process.
    scans_came: usize,
    /// Scans that were left out, because newer ones came before they could be mapped.
    scans_left_out: usize,
    /// Scans that could not be used.
    scans_skipped: usize,
    /// Whether the run was ended by Ctrl-C or a termination request.
    interrupted: bool,
    /// Submaps in the map.
    submaps: usize,
    /// Loop edges.
    loops: usize,
    /// Pose corrections.
    corrections: usize,
    /// Root poses moved by corrections.
    submap_moves: usize,
    /// From the coming of a scan to the end of its integration, milliseconds.
    delay_ms: SeriesStats,
    /// The same: 99 of 100 scans are within it; `null` without scans.
    delay_p99_ms: Option<f64>,
    /// From the coming of a scan to the first change of the surface after it in the viewer's server, milliseconds; empty without `--view`.
    shown_ms: SeriesStats,
    /// The same: 99 of 100 scans are within it; `null` without `--view`.
    shown_p99_ms: Option<f64>,
    /// How much later than its time stamp says a scan was read, at most, milliseconds: decoding that cannot keep up; 0 with `--rate max`.
    late_ms: f64,
    /// Scans that were ignored, because mapping was paused on request.
    scans_paused: usize,
    /// Messages of topics that were not looked at, because those before them took too long.
    messages_lost: usize,
    /// Figures of the odometry; `null` where the data have poses.
    odometry: Option<OdometrySummary>,
    /// Loop closures that were tried; `null` where none were looked for.
    closures: Option<ClosureSummary>,
    /// What was planned; `null` without `--explore`.
    exploration: Option<ExplorationSummary>,
    /// Checkpoints that were written.
    checkpoints: CheckpointSummary,
    /// Threads of the mapper.
    threads: usize,
    #[serde(flatten)]
    times: TimeSummary,
    /// From the start to the last scan, seconds.
    played_s: f64,
    /// From start to saved map, seconds.
    total_s: f64,
    /// Peak resident memory, megabytes (10^6 bytes); `null` where the system does not report it.
    peak_rss_mb: Option<f64>,
    /// Memory of the fields of the map, megabytes.
    map_mb: f64,
    /// Size of the map on disk, megabytes.
    file_mb: f64,
    /// What the run had to say that is no error, each with a stable `code`, `text`, `remedy` and `count`.
    warnings: Vec<Warning>,
}

impl Summary {
    /// The results of a node whose map was saved with so many bytes.
    pub fn of(played: &Played, bytes: u64) -> Self {
        let (run, mapping) = (&played.run, played.run.mapping());
        let (log, atlas, delays, shown) = (mapping.log(), mapping.atlas(), played.delays(), played.delays_to_viewers());
        Self {
            output: run.target().map(|target| target.path().to_owned()).unwrap_or_default(),
            scans: run.scans(),
            scans_resumed: run.scans_resumed(),
            scans_came: played.scans_came,
            scans_left_out: played.scans_left_out,
            scans_skipped: played.scans_skipped,
            interrupted: played.is_interrupted(),
            submaps: atlas.submaps().len(),
            loops: log.loops.len(),
            corrections: log.corrections.len(),
            submap_moves: log.submap_moves,
            delay_ms: delays.stats,
            delay_p99_ms: delays.p99,
            shown_ms: shown.stats,
            shown_p99_ms: shown.p99,
            late_ms: played.late_ms,
            scans_paused: played.scans_paused(),
            messages_lost: played.messages_lost,
            odometry: run.odometry(),
            closures: run.closures(),
            exploration: played.exploration(),
            checkpoints: run.checkpoints(),
            threads: mapping.threads(),
            times: mapping.times(),
            played_s: played.played_s,
            total_s: played.start.elapsed().as_secs_f64(),
            peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
            map_mb: usage::megabytes(atlas.bytes() as u64),
            file_mb: usage::megabytes(bytes),
            warnings: run.warnings().all().to_vec(),
        }
    }

    /// Logs the results in a few lines.
    pub fn log(&self) {
        let skipped = if self.scans_skipped > 0 { format!(", {} skipped", self.scans_skipped) } else { String::new() };
        let resumed = if self.scans_resumed > 0 { format!(", {} of them by an earlier process,", self.scans_resumed) } else { String::new() };
        tracing::info!(
            "{} of {} scans mapped{skipped}{resumed} in {:.1} s; {} submaps, {:.0} MB in memory",
            self.scans,
            self.scans_came,
            self.played_s,
            self.submaps,
            self.map_mb
        );
        if self.scans_left_out > 0 {
            tracing::warn!("{} scans came faster than they could be mapped and were left out: the newest win", self.scans_left_out);
        }
        if let (Some(median), Some(p99)) = (self.delay_ms.median, self.delay_p99_ms) {
            tracing::info!("from a scan's coming to its being in the map: median {median:.1} ms, 99 % within {p99:.1} ms, {} threads", self.threads);
        }
        tracing::info!("map: {} ({:.1} MB)", self.output.display(), self.file_mb);
    }
}
