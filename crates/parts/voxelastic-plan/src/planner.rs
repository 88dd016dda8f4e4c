//! From a request to a plan: checks of the endpoints, first path, alternative routes, RRT*, final shortening.

use crate::endpoint;
use crate::error::{Endpoint, PlanError};
use crate::flying::FlyingSpace;
use crate::ground::GroundSpace;
use crate::points::{Point, between, distance, length};
use crate::robot::Robot;
use crate::search::lattice_search::{LatticeSearch, SearchParams};
use crate::search::rrt_connect::rrt_connect;
use crate::search::rrt_star::RrtStar;
use crate::search::sampler::Sampler;
use crate::search::shorten::{Effort, shorten};
use crate::search::stop::StopCriterion;
use crate::search::tree::Tree;
use crate::space::Space;
use std::time::Duration;
use voxelastic::query::{AtlasQuery, UnknownAs};

/// Share of the time reserved for the final shortening.
const FINAL_SHORTENING: f64 = 0.1;
/// RRT-Connect searches for the first path up to this share of the time, the lattice after it up to [`LATTICE_UNTIL`].
const RRT_CONNECT_UNTIL: f64 = 0.03;
/// The lattice searches for the first path and for alternatives up to this share of the time.
const LATTICE_UNTIL: f64 = 0.8;
/// Heuristic weights of the lattice search, for the first path and then for alternatives.
const HEURISTIC_WEIGHTS: [f32; 3] = [2.0, 1.3, 1.0];
/// No alternatives are searched for if the path is shorter than this multiple of the straight line.
const NEARLY_STRAIGHT: f64 = 1.02;
/// Clearance is reported up to this much beyond the robot's radius, metres.
const MAX_CLEARANCE: f64 = 2.0;

/// A planning problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Position of the robot's centre, map frame, metres. For a wheeled robot any height above the floor.
    pub start: Point,
    /// Where it should go, likewise.
    pub goal: Point,
    /// The robot.
    pub robot: Robot,
    /// Corners of the box that the robot's centre must stay in, map frame, metres; none for the box around everything observed.
    pub bounds: Option<[Point; 2]>,
    /// Limit of time. It is used up to find shorter paths.
    pub time: Duration,
    /// Limit of samples, where 32 expanded nodes of the lattice count as one; none for no limit. If it is reached before the time limit, the result is
    /// the same on every machine.
    pub samples: Option<usize>,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Request {
    /// A request with a time limit of one second.
    pub fn new(start: Point, goal: Point, robot: Robot) -> Self {
        Self { start, goal, robot, bounds: None, time: Duration::from_secs(1), samples: None, seed: 1 }
    }
}

/// How the first path was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstPath {
    /// Time until then, seconds.
    pub seconds: f64,
    /// Samples until then: the same on every machine.
    pub samples: usize,
    /// Its length, metres.
    pub length: f64,
}

/// A path and how it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Waypoints of the robot's centre, joined by straight motions, map frame, metres.
    pub path: Vec<Point>,
    /// Its length, metres.
    pub length: f64,
    /// Distance of each waypoint to the nearest obstacle, including unknown space that counts as blocked, metres; at most 2 m beyond the radius.
    pub clearance: Vec<f64>,
    /// The least such distance anywhere along the path, metres, sampled at the voxel size.
    pub least_clearance: f64,
    /// The first path.
    pub first: FirstPath,
    /// Time spent, seconds.
    pub seconds: f64,
    /// Samples drawn.
    pub samples: usize,
    /// The search tree: states, and the index of the parent of each; the first is the start.
    pub tree: Vec<(Point, Option<u32>)>,
    /// Height of a wheeled robot's centre above the floor, metres.
    pub height: Option<f64>,
}

/// Plans a path for a robot in a map.
///
/// Random samples are drawn from [`Request::seed`]. The search for shorter paths goes on until the time or the samples are used up.
///
/// # Errors
/// [`PlanError::NoOccupancy`] for a map without occupancy, [`PlanError::Setting`] for numbers out of range,
/// [`PlanError::OutsideMap`] and [`PlanError::Blocked`] for a start or goal where the robot does not fit, and
/// [`PlanError::NotFound`] when no path was found within the limits.
pub fn plan(map: &AtlasQuery<'_>, request: &Request) -> Result<Plan, PlanError> {
    let stop = StopCriterion::new(request.time, request.samples);
    request.robot.check()?;
    if map.is_empty() {
        return Err(PlanError::NoOccupancy);
    }
    let known = known_box(map);
    let bounds = request.bounds.unwrap_or_else(|| with_endpoints(known, request));
    if request.robot.ground.is_some() {
        let space = GroundSpace::new(map, &request.robot, request.start, bounds)?;
        let height = Some(space.height());
        Ok(Plan { height, ..Task { space: &space, map, request, known, stop }.run()? })
    } else {
        let space = FlyingSpace::new(map, &request.robot, bounds);
        Task { space: &space, map, request, known, stop }.run()
    }
}

fn known_box(map: &AtlasQuery<'_>) -> [Point; 2] {
    let bounds = map.bounds();
    [bounds.min.map(f64::from), bounds.max.map(f64::from)]
}

/// If unknown space counts as free, the box of known space is extended to the endpoints.
fn with_endpoints(known: [Point; 2], request: &Request) -> [Point; 2] {
    if request.robot.unknown == UnknownAs::Blocked {
        return known;
    }
    let ends = [request.start, request.goal];
    let margin = 2.0 * request.robot.radius + 1.0;
    [
        std::array::from_fn(|k| ends.iter().fold(known[0][k], |low, p| low.min(p[k] - margin))),
        std::array::from_fn(|k| ends.iter().fold(known[1][k], |high, p| high.max(p[k] + margin))),
    ]
}

/// A path, the tree it belongs to, and the node of its goal.
struct TreePath {
    path: Vec<Point>,
    tree: Tree,
    goal: u32,
}

impl TreePath {
    /// Adds a path to a tree with the same root.
    fn add_to(path: Vec<Point>, mut tree: Tree) -> Self {
        let goal = path.iter().skip(1).fold(0, |node, p| tree.add(node, *p));
        Self { path, tree, goal }
    }
}

/// A request in its configuration space.
struct Task<'a, S> {
    space: &'a S,
    map: &'a AtlasQuery<'a>,
    request: &'a Request,
    known: [Point; 2],
    stop: StopCriterion,
}

impl<S: Space> Task<'_, S> {
    fn run(&self) -> Result<Plan, PlanError> {
        let Request { robot, seed, .. } = *self.request;
        let validate = |endpoint, position| endpoint::validate(self.space, self.map, self.known, robot.unknown, endpoint, position);
        let (start, goal) = (validate(Endpoint::Start, self.request.start)?, validate(Endpoint::Goal, self.request.goal)?);
        let mut sampler = Sampler::new(self.space, seed);
        let mut lattice = LatticeSearch::new(self.space, start, goal, robot.radius);
        let found = self.first_path(&mut sampler, &mut lattice, [start, goal]);
        let mut route = found.map_err(|reach| PlanError::NotFound { samples: sampler.drawn, seconds: self.stop.seconds(), reach })?;
        let first = FirstPath { seconds: self.stop.seconds(), samples: sampler.drawn, length: length(&route.path) };
        route.path = shorten(self.space, route.path, Effort::Quick);
        self.search_alternatives(&mut sampler, &mut lattice, &mut route);
        let until = self.stop.fraction(1.0 - FINAL_SHORTENING);
        let best = RrtStar::new(self.space, &mut route.tree, route.goal, self.max_step(), route.path).run(&mut sampler, &until);
        let best = shorten(self.space, best, Effort::Thorough);
        Ok(self.finish(&best, &route.tree, first, sampler.drawn))
    }

    /// A first path: of RRT-Connect if it finds one soon, else of the lattice search, else of RRT-Connect with the remaining time. The error is how far
    /// the two trees got from their roots, metres.
    fn first_path(&self, sampler: &mut Sampler<'_, S>, lattice: &mut LatticeSearch<'_, S>, ends: [Point; 2]) -> Result<TreePath, [f64; 2]> {
        let mut trees = ends.map(|end| Tree::new(end, self.space.dimensions()));
        let mut met = rrt_connect(sampler, self.space, &mut trees, self.max_step(), &[], &self.stop.fraction(RRT_CONNECT_UNTIL));
        if met.is_none() {
            let params = SearchParams { heuristic_weight: HEURISTIC_WEIGHTS[0], max_length: f64::INFINITY };
            if let Some(path) = lattice.find_path(sampler, params, &self.stop.fraction(LATTICE_UNTIL)) {
                let [tree, _] = trees;
                return Ok(TreePath::add_to(path, tree));
            }
            met = rrt_connect(sampler, self.space, &mut trees, self.max_step(), &[], &self.stop);
        }
        let Some(meeting) = met else { return Err(trees.map(|tree| tree.extent())) };
        let [mut tree, from_goal] = trees;
        let goal = tree.graft(meeting.from_start, &from_goal, meeting.from_goal)[0];
        Ok(TreePath { path: tree.path_to(goal), tree, goal })
    }

    /// Searches the lattice for a shorter route, for instance through another door, which a grown tree seldom finds. The first searches are greedy:
    /// any shorter path limits the nodes of the next.
    fn search_alternatives(&self, sampler: &mut Sampler<'_, S>, lattice: &mut LatticeSearch<'_, S>, route: &mut TreePath) {
        let [start, goal] = [route.path[0], route.path[route.path.len() - 1]];
        let until = self.stop.fraction(LATTICE_UNTIL);
        for heuristic_weight in HEURISTIC_WEIGHTS {
            let max_length = length(&route.path);
            if max_length < NEARLY_STRAIGHT * distance(start, goal) || until.is_reached(sampler.drawn) {
                return;
            }
            let Some(path) = lattice.find_path(sampler, SearchParams { heuristic_weight, max_length }, &until) else { continue };
            let path = shorten(self.space, path, Effort::Quick);
            if length(&path) < max_length {
                *route = TreePath::add_to(path, Tree::new(start, self.space.dimensions()));
            }
        }
    }

    /// Longest motion of the search trees: short relative to the space, long relative to the objects in it, metres.
    fn max_step(&self) -> f64 {
        let [low, high] = self.space.bounds();
        (distance(low, high) / 50.0).clamp(0.5, self.space.max_step())
    }

    fn finish(&self, best: &[Point], tree: &Tree, first: FirstPath, samples: usize) -> Plan {
        let mut path: Vec<Point> = best.first().copied().into_iter().collect();
        for w in best.windows(2) {
            // On the ground the previous motion may have ended slightly above or below this one's start: continue from there if that is free, too.
            let at = path.last().copied().filter(|at| self.space.steer(*at, w[1]).is_some());
            if at.is_none() {
                path.push(w[0]);
            }
            self.space.trace(at.unwrap_or(w[0]), w[1], &mut path);
        }
        let Robot { radius, unknown, .. } = self.request.robot;
        // Where submaps overlap, the query underestimates by up to a voxel; the path was checked for the radius itself.
        let clearance_at = |p: Point| self.map.clearance(p, radius + MAX_CLEARANCE, unknown).max(radius);
        let clearance: Vec<f64> = path.iter().map(|p| clearance_at(*p)).collect();
        let mut least = clearance.iter().copied().fold(f64::INFINITY, f64::min);
        for w in path.windows(2) {
            let length = distance(w[0], w[1]);
            let mut at = 0.0;
            while at < length {
                let here = clearance_at(between(w[0], w[1], at / length));
                least = least.min(here);
                // Clearance changes by at most the distance moved, so none in between is below the least.
                at += (here - least).max(self.map.voxel_size());
            }
        }
        let (length, tree) = (length(&path), tree.nodes().collect());
        Plan { length, path, clearance, least_clearance: least, first, seconds: self.stop.seconds(), samples, tree, height: None }
    }
}
