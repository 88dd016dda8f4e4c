//! What the planner's thread does: it keeps its copy of the map and its explorer up to date, and decides.

use super::copy::{MapChanges, MapCopy};
use super::plan::{Command, Plan, PlanState};
use super::settings::PlannerSettings;
use crate::near_scans::{Beams, NearScan};
use std::time::{Duration, Instant};
use voxelastic_explore::{ExploreError, Explorer, Purpose};
use voxelastic_plan::{Point, anchor_path, distance};

/// A path grows old with each decision, of which there is one for so much of the way, metres ...
const STEP: f64 = 1.0;
/// ... or of the time. Between them the robot only looks whether the path is still good.
const PERIOD: Duration = Duration::from_secs(1);

/// A robot stands if it has not moved farther than this, metres ...
const STANDING: f64 = 0.1;
/// ... for so long.
const STOPPED: Duration = Duration::from_secs(2);

/// What the planner is to work on.
#[derive(Debug)]
pub struct Order {
    /// What has changed in the map.
    pub changes: MapChanges,
    /// Scans that came since the last order, in order.
    pub scans: Vec<NearScan>,
    /// Those of the first scan.
    pub beams: Option<Beams>,
    /// Time until the robot must be at home, seconds.
    pub seconds_left: Option<f64>,
    /// What was asked of it since the last order.
    pub command: Option<Command>,
}

/// The planner.
#[derive(Debug)]
pub struct Worker {
    settings: PlannerSettings,
    map: MapCopy,
    /// Once there is a scan.
    explorer: Option<Explorer>,
    /// Where and when it decided last, and not only looked.
    decided: Option<(Point, Instant)>,
    /// Where it came to that it has not left since, and when.
    stopped: Option<(Point, Instant)>,
    is_done: bool,
}

impl Worker {
    /// One that knows nothing yet.
    pub fn new(settings: PlannerSettings) -> Self {
        Self { settings, map: MapCopy::new(), explorer: None, decided: None, stopped: None, is_done: false }
    }

    /// Takes what has changed, and plans; none without a scan.
    ///
    /// # Errors
    /// Those of [`Explorer::decide`], in words.
    pub fn work(&mut self, order: Order) -> Option<Result<Plan, String>> {
        let clock = Instant::now();
        self.map.apply(order.changes);
        let atlas = self.map.atlas();
        let robot: Point = atlas.newest_scan().and_then(|node| atlas.scan_pose(node))?.translation.vector.into();
        let explorer = match &mut self.explorer {
            Some(explorer) => explorer,
            explorer => match Explorer::new(self.settings.explorer(robot, order.beams, f64::from(atlas.voxel_size()))) {
                Ok(new) => explorer.insert(new),
                Err(problem) => return Some(Err(problem.to_string())),
            },
        };
        match order.command {
            Some(Command::Explore) => explorer.resume(),
            Some(Command::Return) => explorer.return_home(),
            None => {}
        }
        self.is_done &= order.command.is_none();
        for scan in &order.scans {
            if let Some(pose) = atlas.scan_pose(scan.node) {
                explorer.see(&pose, &scan.cloud);
            }
        }
        Some(self.decide(robot, order.seconds_left, clock).map_err(|problem| problem.to_string()))
    }

    fn decide(&mut self, robot: Point, seconds_left: Option<f64>, clock: Instant) -> Result<Plan, ExploreError> {
        let (atlas, Some(explorer)) = (self.map.atlas(), &mut self.explorer) else { return Ok(Plan::default()) };
        if self.is_done {
            let from_home = explorer.home().map(|home| distance(home, robot));
            return Ok(Plan { state: PlanState::Done, reason: explorer.reason_to_return(), from_home, took: clock.elapsed(), ..Plan::default() });
        }
        let stopped = self.stopped.filter(|(at, _)| distance(*at, robot) < STANDING).unwrap_or_else(|| (robot, Instant::now()));
        self.stopped = Some(stopped);
        explorer.keep_up(atlas, robot, stopped.1.elapsed() >= STOPPED);
        let is_due = self.decided.is_none_or(|(at, when)| distance(at, robot) >= STEP || when.elapsed() >= PERIOD);
        let mut decision = if is_due { explorer.decide(atlas, robot, seconds_left)? } else { explorer.look(atlas, robot, seconds_left)? };
        // Nothing waits for this thread, and a robot that stands may give no more scans.
        while decision.is_unfinished {
            let has_planned = decision.is_new;
            decision = explorer.look(atlas, robot, seconds_left)?;
            decision.is_new |= has_planned;
        }
        if is_due || decision.is_new {
            self.decided = Some((robot, Instant::now()));
        }
        self.is_done = decision.purpose == Purpose::Done;
        let state = match decision.purpose {
            Purpose::Explore => PlanState::Exploring,
            Purpose::Return => PlanState::Returning,
            Purpose::Done => PlanState::Done,
        };
        Ok(Plan {
            state,
            reason: explorer.reason_to_return().filter(|_| state != PlanState::Exploring),
            anchors: anchor_path(atlas, &decision.path),
            path: decision.path,
            frontier: decision.frontier,
            is_new: decision.is_new,
            from_home: explorer.home().map(|home| distance(home, robot)),
            places: explorer.places(),
            frontier_took: decision.frontier_time,
            took: clock.elapsed(),
        })
    }
}
