//! Results of a suite, and the machine they were measured on.

use crate::goal::Goal;
use crate::run::Run;
use crate::special::Special;
use crate::workspace::load;
use serde::Serialize;

/// The machine.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Machine {
    /// Name of the processor; empty where the system does not report it.
    pub cpu: String,
    /// Available processors.
    pub cores: usize,
    /// Load at the start.
    pub load_before: Option<f64>,
    /// Load at the end.
    pub load_after: Option<f64>,
}

/// Results of a suite. The keys of `bench.json` are stable; more may be added.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Suite {
    /// Version of the format: 1.
    pub format: u32,
    /// Program and version.
    pub generator: String,
    /// The machine.
    pub machine: Machine,
    /// Whether it was a quick suite.
    pub quick: bool,
    /// One run per configuration.
    pub runs: Vec<Run>,
    /// Pose updates, second laps, mesh extraction.
    #[serde(rename = "elastic")]
    pub special: Special,
    /// Goals and measured values.
    pub goals: Vec<Goal>,
    /// What was skipped, and why.
    pub skipped: Vec<String>,
    /// Duration, seconds.
    pub total_s: f64,
}

/// The program and its version.
pub(crate) fn generator() -> String {
    concat!("voxelastic ", env!("CARGO_PKG_VERSION")).to_owned()
}

/// The machine as reported by the system, before a suite.
pub(crate) fn machine() -> Machine {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':')).map(|(_, name)| name.trim().to_owned());
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    Machine { cpu: name.unwrap_or_default(), cores, load_before: load(), load_after: None }
}
