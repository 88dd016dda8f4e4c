//! What is measured, and what comes out.

use super::score::{ClosureScore, PathScore};
use crate::results::Machine;
use serde::Serialize;

/// A recording with true poses.
#[derive(Debug)]
pub(crate) struct Recording {
    pub name: &'static str,
    /// Its true poses, a part of a file name.
    pub truth: &'static str,
    /// Odometry in the data, from which closures are looked for.
    pub odometry: Option<&'static str>,
    /// Whether its scans are sweeps whose points have times, with an inertial measurement unit.
    pub sweeps: bool,
}

/// A system on a recording.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SlamRun {
    /// Name and version.
    pub system: String,
    /// The recording.
    pub data: String,
    /// What it did: `odometry`, `odometry and closures`, `closures`.
    pub task: &'static str,
    /// Scans that it took, and scans offered.
    pub scans: usize,
    /// See `scans`.
    pub scans_offered: usize,
    /// Processor time of a scan, without reading, milliseconds: mean. None where it is not measured apart from mapping.
    pub cpu_ms: Option<f64>,
    /// Peak memory of the process, megabytes (10^6 bytes).
    pub peak_rss_mb: Option<f64>,
    /// Lines of code that a user of a peer writes; `null` for ours, which is a command.
    pub user_lines: Option<usize>,
    /// Errors of its poses.
    pub path: Option<PathScore>,
    /// Its closures.
    pub closures: Option<ClosureScore>,
    /// The command, as one would type it.
    pub command: String,
    /// What was different from usual; empty if nothing.
    pub note: String,
}

/// All results.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SlamBench {
    /// Version of this structure.
    pub format: u32,
    /// The program.
    pub generator: String,
    /// The machine.
    pub machine: Machine,
    /// Runs, by recording.
    pub runs: Vec<SlamRun>,
    /// What was left out, and why.
    pub skipped: Vec<String>,
    /// Duration of it all, seconds.
    pub total_s: f64,
}
