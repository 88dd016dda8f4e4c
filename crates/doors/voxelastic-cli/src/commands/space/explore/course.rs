//! What happened on the way, and its summary.

use super::args::ExploreArgs;
use super::evenly::Evenly;
use super::periods::{Period, Periods, Times};
use super::robot::SimulatedRobot;
use super::truth::SurfaceError;
use nalgebra::Point3;
use serde::Serialize;
use std::time::Duration;
use voxelastic::event::NodeId;
use voxelastic::query::AtlasQuery;
use voxelastic::{Mapper, Pose};
use voxelastic_explore::{Decision, Explorer, FrontierCluster, Purpose};
use voxelastic_plan::Point;
use voxelastic_report::content::{Exploration, ExplorationStep, KnownShare};
use voxelastic_sim::ReachableSpace;

/// What is known is compared with the world at this interval, seconds of the simulation.
const INTERVAL: f64 = 10.0;
/// A report has at most this many decisions, evenly taken from all.
const MOST_STEPS: usize = 500;

/// How much was known when.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Moment {
    time_s: f64,
    distance_m: f64,
    /// Share of the space that could be known.
    known_share: f64,
    /// Explored volume as TARE measures it, cubic metres.
    tare_volume_m3: f64,
    /// Distance between where the robot was and where it believed to be.
    error_m: f64,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    world: String,
    seed: u64,
    ground: bool,
    drift_m_per_100_m: f64,
    pub time_s: f64,
    pub distance_m: f64,
    /// Volume of the space that could be known, cubic metres.
    pub reachable_m3: f64,
    /// Share of it that is known at the end.
    pub known_share: f64,
    /// Distance travelled until nine tenths, and 95 %, of what is known at the end was known.
    distance_to_90_percent_m: Option<f64>,
    distance_to_95_percent_m: Option<f64>,
    /// Explored volume as TARE measures it, cubic metres, at true poses.
    tare_volume_m3: f64,
    /// Of the final map; none without obstacles in the box.
    surface_error_m: Option<SurfaceError>,
    pub is_home: bool,
    pub collisions: usize,
    scans: usize,
    loop_closures: usize,
    submaps: usize,
    plans: usize,
    places: usize,
    /// All decisions; those that planned a path; bringing the frontier up to date and clustering it.
    pub decision_ms: Times,
    plan_ms: Times,
    frontier_ms: Times,
    course: Vec<Moment>,
    periods: Vec<Period>,
}

/// A decision, for the report.
struct Step {
    /// Of the last scan, and where the robot believed that it took it.
    node: NodeId,
    t_map_lidar: Pose,
    /// Map frame at that time.
    decided: ExplorationStep,
}

/// What happened so far.
pub struct Course {
    pub moments: Vec<Moment>,
    /// More than a report has would be most of the memory of a long run.
    steps: Evenly<Step>,
    last_step: Option<Step>,
    decisions: Vec<(Duration, Duration, bool)>,
    periods: Periods,
    pub frontier: Vec<FrontierCluster>,
    last_purpose: Option<Purpose>,
    is_home: bool,
    places: usize,
}

impl Step {
    fn in_map(&self, mapper: &Mapper) -> ExplorationStep {
        let correction = mapper.pose(self.node).map_or_else(Pose::identity, |now| now * self.t_map_lidar.inverse());
        let moved = |p: Point| <Point>::from((correction * Point3::from(p)).coords).map(|c| (c * 100.0).round() / 100.0);
        let ExplorationStep { time_s, distance_m, position, frontier, path } = &self.decided;
        ExplorationStep {
            time_s: *time_s,
            distance_m: *distance_m,
            position: moved(*position),
            frontier: frontier.iter().map(|(centre, area)| (moved(*centre), *area)).collect(),
            path: path.iter().map(|p| moved(*p)).collect(),
        }
    }
}

impl Course {
    /// Of a robot that has so many seconds.
    pub fn new(seconds: f64) -> Self {
        Self {
            moments: Vec::new(),
            steps: Evenly::new(MOST_STEPS),
            last_step: None,
            decisions: Vec::new(),
            periods: Periods::new(seconds),
            frontier: Vec::new(),
            last_purpose: None,
            is_home: false,
            places: 0,
        }
    }

    /// Notes a decision.
    pub fn record(&mut self, robot: &SimulatedRobot, explorer: &Explorer, decision: &Decision, truth: &ReachableSpace, is_last: bool) {
        let (&t_map_lidar, _) = robot.last_scan();
        let step = || {
            let frontier = decision.frontier.iter().map(|cluster| (cluster.centre, cluster.area)).collect();
            let (time_s, distance_m, position) = (robot.time(), robot.distance(), robot.position());
            let decided = ExplorationStep { time_s, distance_m, position, frontier, path: decision.path.clone() };
            Step { node: robot.node(), t_map_lidar, decided }
        };
        if is_last {
            self.last_step = Some(step());
        } else {
            self.steps.add(step);
        }
        self.decisions.push((decision.time, decision.frontier_time, decision.is_new));
        if self.last_purpose != Some(decision.purpose) {
            self.last_purpose = Some(decision.purpose);
            let reason = explorer.reason_to_return().filter(|_| decision.purpose == Purpose::Return);
            tracing::debug!("{:?} after {:.0} s{}", decision.purpose, robot.time(), reason.map_or_else(String::new, |reason| format!(": {reason}")));
        }
        let is_due = self.moments.last().is_none_or(|last| robot.time() >= last.time_s + INTERVAL);
        if is_due || is_last {
            let known_share = truth.known_share(&AtlasQuery::new(robot.atlas()));
            self.moments.push(Moment {
                time_s: robot.time(),
                distance_m: robot.distance(),
                known_share,
                tare_volume_m3: robot.tare_volume(),
                error_m: robot.error(),
            });
        }
        self.periods.record(robot, explorer, decision, self.share() * truth.volume(), is_last);
        if is_last {
            self.frontier.clone_from(&decision.frontier);
            let (start, last) = (robot.start(), robot.track.last().copied().unwrap_or_default());
            self.is_home = voxelastic_plan::distance(start, last) < 2.0 * explorer.settings().spacing;
            self.places = explorer.places();
        }
    }

    /// Share of the space known at the last comparison.
    pub fn share(&self) -> f64 {
        self.moments.last().map_or(0.0, |moment| moment.known_share)
    }

    /// Share of the space known, by time in seconds.
    pub fn shares(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.moments.iter().map(|moment| (moment.time_s, moment.known_share))
    }

    fn distance_to(&self, share: f64) -> Option<f64> {
        let least = share * self.share();
        self.moments.iter().find(|moment| moment.known_share >= least).map(|moment| moment.distance_m)
    }

    /// What a report shows of it, with everything where the scans are now that it was seen from.
    pub fn replay(&self, mapper: &Mapper) -> Exploration {
        let moment = |m: &Moment| KnownShare { time_s: m.time_s, distance_m: m.distance_m, known_share: m.known_share };
        let steps = self.steps.iter().chain(&self.last_step).map(|step| step.in_map(mapper)).collect();
        Exploration { moments: self.moments.iter().map(moment).collect(), steps }
    }

    /// The summary at the end.
    pub fn summary(&self, args: &ExploreArgs, robot: &SimulatedRobot, truth: &ReachableSpace, bounds: [Point; 2]) -> Summary {
        Summary {
            world: args.world.clone(),
            seed: args.seed,
            ground: args.ground,
            drift_m_per_100_m: args.drift,
            time_s: robot.time(),
            distance_m: robot.distance(),
            reachable_m3: truth.volume(),
            known_share: self.share(),
            distance_to_90_percent_m: self.distance_to(0.9),
            distance_to_95_percent_m: self.distance_to(0.95),
            tare_volume_m3: robot.tare_volume(),
            surface_error_m: SurfaceError::new(robot.world(), &AtlasQuery::new(robot.atlas()), bounds),
            is_home: self.is_home,
            collisions: robot.collisions,
            scans: robot.track.len(),
            loop_closures: robot.closures,
            submaps: robot.atlas().submaps().len(),
            plans: self.decisions.iter().filter(|decision| decision.2).count(),
            places: self.places,
            decision_ms: Times::of(self.decisions.iter().map(|decision| decision.0)),
            plan_ms: Times::of(self.decisions.iter().filter(|decision| decision.2).map(|decision| decision.0)),
            frontier_ms: Times::of(self.decisions.iter().map(|decision| decision.1)),
            course: self.moments.clone(),
            periods: self.periods.done().to_vec(),
        }
    }
}
