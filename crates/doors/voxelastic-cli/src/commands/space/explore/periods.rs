//! What a run took in each twelfth of its time: whether times and memory grow with the way.

use super::robot::SimulatedRobot;
use serde::Serialize;
use std::time::Duration;
use voxelastic_explore::{Decision, Explorer};
use voxelastic_run::usage;

/// A run has so many periods ...
const PERIODS: f64 = 12.0;
/// ... of at least so many seconds of the simulation.
const SHORTEST: f64 = 10.0;

/// Statistics of times, milliseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Times {
    pub median: f64,
    pub p95: f64,
    pub p99: f64,
    pub most: f64,
}

impl Times {
    pub fn of(times: impl Iterator<Item = Duration>) -> Self {
        let mut sorted: Vec<f64> = times.map(|time| 1e3 * time.as_secs_f64()).collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted.get((share * sorted.len().saturating_sub(1) as f64).round() as usize).copied().unwrap_or_default();
        Self { median: at(0.5), p95: at(0.95), p99: at(0.99), most: at(1.0) }
    }
}

/// A part of a run: what it took, and where it stood at the end of it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Period {
    /// Its end, seconds of the simulation, and the path so far.
    time_s: f64,
    distance_m: f64,
    /// Volume of the space that could be known and is, cubic metres.
    known_m3: f64,
    scans: usize,
    plans: usize,
    /// Wall time to map a scan, of the frontier after it, of decisions that planned a path, and of all.
    mapping_ms: Times,
    frontier_ms: Times,
    plan_ms: Times,
    decision_ms: Times,
    /// Of the roadmap, of the map, and of the process.
    places: usize,
    submaps: usize,
    map_mb: f64,
    resident_mb: Option<f64>,
}

/// Times after one scan.
struct Step {
    mapping: Duration,
    frontier: Duration,
    decision: Duration,
    is_plan: bool,
}

/// The periods of a run.
pub struct Periods {
    /// Seconds of the simulation.
    length: f64,
    done: Vec<Period>,
    /// Of the period that has not ended yet.
    steps: Vec<Step>,
}

impl Periods {
    /// Of a run of so many seconds.
    pub fn new(seconds: f64) -> Self {
        Self { length: (seconds / PERIODS).max(SHORTEST), done: Vec::new(), steps: Vec::new() }
    }

    /// Those that have ended.
    pub fn done(&self) -> &[Period] {
        &self.done
    }

    /// Notes a decision; `known_m3` is the volume known by now.
    pub fn record(&mut self, robot: &SimulatedRobot, explorer: &Explorer, decision: &Decision, known_m3: f64, is_last: bool) {
        let step = Step { mapping: robot.mapping(), frontier: decision.frontier_time, decision: decision.time, is_plan: decision.is_new };
        self.steps.push(step);
        let end = (self.done.len() + 1) as f64 * self.length;
        if robot.time() < end && !is_last {
            return;
        }
        let steps = std::mem::take(&mut self.steps);
        let plans = || steps.iter().filter(|step| step.is_plan);
        let period = Period {
            time_s: robot.time(),
            distance_m: robot.distance(),
            known_m3,
            scans: steps.len(),
            plans: plans().count(),
            mapping_ms: Times::of(steps.iter().map(|step| step.mapping)),
            frontier_ms: Times::of(steps.iter().map(|step| step.frontier)),
            plan_ms: Times::of(plans().map(|step| step.decision)),
            decision_ms: Times::of(steps.iter().map(|step| step.decision)),
            places: explorer.places(),
            submaps: robot.atlas().submaps().len(),
            map_mb: usage::megabytes(robot.atlas().bytes() as u64),
            resident_mb: usage::resident_bytes().map(usage::megabytes),
        };
        tracing::debug!(
            "{:.0} s, {:.0} m: {:.0} m3 known; a scan took {:.1} ms, its frontier {:.1}, a plan {:.0} (median) and {:.0} (99 %); map {:.0} MB, {:.0} MB in all",
            period.time_s,
            period.distance_m,
            period.known_m3,
            period.mapping_ms.median,
            period.frontier_ms.median,
            period.plan_ms.median,
            period.plan_ms.p99,
            period.map_mb,
            period.resident_mb.unwrap_or_default()
        );
        self.done.push(period);
    }
}
