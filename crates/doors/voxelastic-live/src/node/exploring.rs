//! Where to go next, while the map grows.

use super::delays::Delays;
use crate::planner::{Command, LivePlanner, Plan, PlanState, PlannerSettings};
use crate::ros::output::Outputs;
use crate::ros::services::{Request, Response};
use serde::Serialize;
use std::time::Duration;
use voxelastic::Settings;
use voxelastic::event::Scan;
use voxelastic_eval::SeriesStats;
use voxelastic_run::error::one_line;
use voxelastic_run::{Error, Mapping, Result};

/// Threads of the planner.
const THREADS: usize = 2;

/// The figures of a run, for `--json`.
#[derive(Clone, Debug, Serialize)]
pub struct ExplorationSummary {
    /// `waiting`, `exploring`, `returning`, `done` or `paused`.
    state: &'static str,
    /// Why the robot does not explore any more.
    reason: Option<String>,
    /// Distance from home at the last plan, metres.
    from_home_m: Option<f64>,
    /// How often the planner looked at the map, and how often that gave a new path.
    looks: usize,
    paths: usize,
    /// Looks that failed.
    failures: usize,
    /// Copying what changed in the map, in the mapper's thread; and what 99 of 100 copies do not exceed.
    copy_ms: SeriesStats,
    copy_p99_ms: Option<f64>,
    /// Bringing the frontier up to date and clustering it; looks that gave a new path; all looks. In the planner's thread.
    frontier_ms: SeriesStats,
    plan_ms: SeriesStats,
    plan_p99_ms: Option<f64>,
    look_ms: SeriesStats,
    look_p99_ms: Option<f64>,
}

/// How often the planner looked at the map, how often that gave a new path, and how often it failed.
#[derive(Default)]
struct Counts {
    looks: usize,
    paths: usize,
    failures: usize,
}

/// The planner of a node, and what it said.
pub struct Exploring {
    planner: LivePlanner,
    last: Plan,
    /// The last problem.
    problem: Option<String>,
    copies: Delays,
    frontiers: Delays,
    paths: Delays,
    looks: Delays,
    counts: Counts,
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

impl Exploring {
    /// Begins to explore.
    pub fn start(settings: PlannerSettings) -> Result<Self> {
        let planner = LivePlanner::start(settings, THREADS).map_err(|problem| Error::usage(problem.to_string(), "see `voxelastic live --help`"))?;
        Ok(Self {
            planner,
            last: Plan::default(),
            problem: None,
            copies: Delays::default(),
            frontiers: Delays::default(),
            paths: Delays::default(),
            looks: Delays::default(),
            counts: Counts::default(),
        })
    }

    /// A scan is going to be mapped.
    pub fn add_scan(&mut self, scan: &Scan, settings: &Settings) {
        self.planner.add_scan(scan, settings.min_range);
    }

    /// The map has changed.
    pub fn note(&mut self) {
        self.planner.note();
    }

    /// Whether a plan is being made.
    pub fn is_busy(&self) -> bool {
        self.planner.is_busy()
    }

    /// Publishes the plan that was made, and has the next one made if no scan waits: the map is copied for that.
    pub fn step(&mut self, mapping: &Mapping, outputs: &mut Outputs, scans_wait: bool) {
        let atlas = mapping.atlas();
        match self.planner.plan() {
            Some(Ok(plan)) => {
                outputs.publish_plan(atlas, &plan);
                self.take(plan);
            }
            Some(Err(problem)) => {
                self.counts.failures += 1;
                outputs.stop_exploring();
                if self.problem.as_ref() != Some(&problem) {
                    tracing::warn!("nothing is planned: {problem}");
                }
                self.problem = Some(problem);
            }
            None => {}
        }
        if !scans_wait && let Some(took) = self.planner.step(atlas) {
            self.copies.push(ms(took));
        }
    }

    fn take(&mut self, plan: Plan) {
        self.counts.looks += 1;
        self.looks.push(ms(plan.took));
        self.frontiers.push(ms(plan.frontier_took));
        if plan.is_new {
            self.counts.paths += 1;
            self.paths.push(ms(plan.took));
        }
        if plan.state != self.last.state {
            let why = plan.reason.map_or_else(String::new, |reason| format!(": {reason}"));
            let from_home = plan.from_home.map_or_else(String::new, |off| format!(", {off:.1} m from home"));
            tracing::info!("{}{why}{from_home}", plan.state.word());
        }
        self.problem = None;
        self.last = plan;
    }

    /// Does what is asked of the robot.
    pub fn answer(&mut self, request: &Request, outputs: &mut Outputs) -> Response {
        let words = match request {
            Request::Explore(true) => {
                // Who was held on the way home goes on.
                if self.state() == PlanState::Returning || self.last.state == PlanState::Done {
                    self.planner.command(Command::Explore);
                }
                self.planner.pause(false);
                "the robot explores"
            }
            Request::Explore(false) => {
                self.planner.pause(true);
                outputs.stop_exploring();
                "the robot is to stay where it is"
            }
            _ => {
                self.planner.command(Command::Return);
                "the robot goes home"
            }
        };
        tracing::info!("on request: {words}");
        Response::Done(Ok(words.to_owned()))
    }

    /// The map begins anew, and so does this.
    pub fn restart(&mut self) {
        match LivePlanner::start(*self.planner.settings(), THREADS) {
            Ok(planner) => (self.planner, self.last) = (planner, Plan::default()),
            Err(problem) => tracing::warn!("nothing is planned: {}", one_line(&problem)),
        }
    }

    fn state(&self) -> PlanState {
        if self.planner.is_paused() { PlanState::Paused } else { self.last.state }
    }

    fn reason(&self) -> Option<String> {
        self.problem.clone().or_else(|| self.last.reason.map(|reason| reason.to_string()))
    }

    /// How it is, for other nodes.
    pub fn figures(&self) -> Vec<(&'static str, String)> {
        let path: f64 = voxelastic_plan::length(&self.last.path);
        let area: f64 = self.last.frontier.iter().map(|cluster| cluster.area).sum();
        let mut all = vec![("explore_state", self.state().word().to_owned())];
        all.extend(self.reason().map(|reason| ("explore_reason", reason)));
        all.extend(self.last.from_home.map(|off| ("explore_from_home_m", format!("{off:.1}"))));
        all.push(("explore_path_m", format!("{path:.1}")));
        all.push(("explore_frontiers", self.last.frontier.len().to_string()));
        all.push(("explore_frontier_m2", format!("{area:.1}")));
        all.push(("explore_plan_ms", format!("{:.1}", ms(self.last.took))));
        all
    }

    /// The figures of the run.
    pub fn summary(&self) -> ExplorationSummary {
        ExplorationSummary {
            state: self.state().word(),
            reason: self.reason(),
            from_home_m: self.last.from_home,
            looks: self.counts.looks,
            paths: self.counts.paths,
            failures: self.counts.failures,
            copy_ms: self.copies.stats(),
            copy_p99_ms: self.copies.quantile(0.99),
            frontier_ms: self.frontiers.stats(),
            plan_ms: self.paths.stats(),
            plan_p99_ms: self.paths.quantile(0.99),
            look_ms: self.looks.stats(),
            look_p99_ms: self.looks.quantile(0.99),
        }
    }
}
