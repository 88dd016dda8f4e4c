//! From a request to a path: the ends, the first path, other ways round, shorter paths, the shortest made round.

use crate::budget::Budget;
use crate::connect::connect;
use crate::ends;
use crate::error::{End, PlanError};
use crate::ground::Ground;
use crate::guide::{Guide, Wish};
use crate::points::{Point, between, distance, length};
use crate::robot::Robot;
use crate::sample::Sampler;
use crate::shorten::{Effort, shorten};
use crate::space::{Air, Space};
use crate::star::Star;
use crate::tree::Tree;
use std::time::Duration;
use voxelastic::query::{AtlasQuery, UnknownAs};

/// Share of the time that is left for the last shortening.
const LAST: f64 = 0.1;
/// Share of the time that two trees have for the first path before the lattice is asked, and that the lattice has, what is before it included.
const TREES: f64 = 0.03;
const LATTICE: f64 = 0.8;
/// How greedily the lattice is searched, for a first path and then for others.
const GREED: [f32; 3] = [2.0, 1.3, 1.0];
/// A path that is longer than the straight line by less than this needs no other way round.
const STRAIGHT: f64 = 1.02;
/// Clearance is told up to this much beyond the robot's radius, metres.
const CLEARANCE: f64 = 2.0;

/// What to plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Where the robot is: its centre, map frame, metres. On wheels, any height above the floor.
    pub start: Point,
    /// Where it is to go.
    pub goal: Point,
    /// The robot.
    pub robot: Robot,
    /// Corners of the box that the robot's centre must stay in, map frame, metres; none for all that is known.
    pub bounds: Option<[Point; 2]>,
    /// How long to look for shorter paths, and at most for one at all.
    pub time: Duration,
    /// Most samples to draw, 32 places of the lattice counting as one; none for as many as time allows. With a limit that is
    /// met before the time the result is the same on every machine.
    pub samples: Option<usize>,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Request {
    /// A request with a second of time.
    pub fn new(start: Point, goal: Point, robot: Robot) -> Self {
        Self { start, goal, robot, bounds: None, time: Duration::from_secs(1), samples: None, seed: 1 }
    }
}

/// The first path that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct First {
    /// After how many seconds.
    pub seconds: f64,
    /// After how many samples: the same on every machine.
    pub samples: usize,
    /// Its length, metres.
    pub length: f64,
}

/// A path, and how it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The way of the robot's centre, straight from point to point, map frame, metres.
    pub path: Vec<Point>,
    /// Its length, metres.
    pub length: f64,
    /// Distance of each point of the path to the nearest obstacle or unknown space that counts as one, metres; told up to 2 m beyond the radius.
    pub clearance: Vec<f64>,
    /// The least distance anywhere along the path, looked at in steps of a voxel.
    pub least_clearance: f64,
    /// The first path.
    pub first: First,
    /// Seconds spent.
    pub seconds: f64,
    /// Samples drawn.
    pub samples: usize,
    /// The states tried from the start on, with the index of the one each is reached from; the first is the start.
    pub tree: Vec<(Point, Option<u32>)>,
    /// Height over the floor that a wheeled robot was kept at, metres.
    pub height: Option<f64>,
}

/// Plans a path for a robot in a map.
///
/// The trees grow by samples drawn from [`Request::seed`]. The path found first is shortened, and then searched for better ones
/// until the time or the samples are used up.
///
/// # Errors
/// [`PlanError::NoOccupancy`] for a map without occupancy, [`PlanError::Setting`] for numbers that make no sense,
/// [`PlanError::OutsideMap`] and [`PlanError::Blocked`] for a start or goal where the robot cannot be, and
/// [`PlanError::NotFound`] when the time or the samples end without a path.
pub fn plan(map: &AtlasQuery<'_>, request: &Request) -> Result<Plan, PlanError> {
    let budget = Budget::new(request.time, request.samples);
    request.robot.check()?;
    if map.is_empty() {
        return Err(PlanError::NoOccupancy);
    }
    let known = known_box(map);
    let bounds = request.bounds.unwrap_or_else(|| with_ends(known, request));
    if request.robot.ground.is_some() {
        let space = Ground::new(map, &request.robot, request.start, bounds)?;
        let height = Some(space.height());
        Ok(Plan { height, ..Task { space: &space, map, request, known, budget }.run()? })
    } else {
        let space = Air::new(map, &request.robot, bounds);
        Task { space: &space, map, request, known, budget }.run()
    }
}

fn known_box(map: &AtlasQuery<'_>) -> [Point; 2] {
    let bounds = map.bounds();
    [bounds.min.map(f64::from), bounds.max.map(f64::from)]
}

/// Ends may be where nothing is known, if that counts as free.
fn with_ends(known: [Point; 2], request: &Request) -> [Point; 2] {
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

/// A path and the tree that it was found in, with its end there.
struct Way {
    path: Vec<Point>,
    tree: Tree,
    goal: u32,
}

impl Way {
    /// A path, hung into a tree with the same root.
    fn along(path: Vec<Point>, mut tree: Tree) -> Self {
        let goal = path.iter().skip(1).fold(0, |node, p| tree.add(node, *p));
        Self { path, tree, goal }
    }
}

/// A request in its space.
struct Task<'a, S> {
    space: &'a S,
    map: &'a AtlasQuery<'a>,
    request: &'a Request,
    known: [Point; 2],
    budget: Budget,
}

impl<S: Space> Task<'_, S> {
    fn run(&self) -> Result<Plan, PlanError> {
        let Request { robot, seed, .. } = *self.request;
        let settle = |end, place| ends::settle(self.space, self.map, self.known, robot.unknown, end, place);
        let (start, goal) = (settle(End::Start, self.request.start)?, settle(End::Goal, self.request.goal)?);
        let mut sampler = Sampler::new(self.space, seed);
        let mut guide = Guide::new(self.space, [start, goal], robot.radius);
        let found = self.first(&mut sampler, &mut guide, [start, goal]);
        let mut way = found.map_err(|reach| PlanError::NotFound { samples: sampler.drawn, seconds: self.budget.seconds(), reach })?;
        let first = First { seconds: self.budget.seconds(), samples: sampler.drawn, length: length(&way.path) };
        way.path = shorten(self.space, way.path, Effort::Quick);
        self.look_elsewhere(&mut sampler, &mut guide, &mut way);
        let until = self.budget.part(1.0 - LAST);
        let best = Star::new(self.space, &mut way.tree, way.goal, self.stride(), way.path).run(&mut sampler, &until);
        let best = shorten(self.space, best, Effort::Thorough);
        Ok(self.finish(&best, &way.tree, first, sampler.drawn))
    }

    /// A way between two places: of two trees that meet soon, or else over the lattice, or else of trees that meet late. How far they reached
    /// when the budget ends before that.
    fn first(&self, sampler: &mut Sampler<'_, S>, guide: &mut Guide<'_, S>, ends: [Point; 2]) -> Result<Way, [f64; 2]> {
        let mut trees = ends.map(|end| Tree::new(end, self.space.dimensions()));
        let mut met = connect(sampler, self.space, &mut trees, self.stride(), &[], &self.budget.part(TREES));
        if met.is_none() {
            let wish = Wish { greed: GREED[0], longest: f64::INFINITY };
            if let Some(path) = guide.path(sampler, wish, &self.budget.part(LATTICE)) {
                let [tree, _] = trees;
                return Ok(Way::along(path, tree));
            }
            met = connect(sampler, self.space, &mut trees, self.stride(), &[], &self.budget);
        }
        let Some(meeting) = met else { return Err(trees.map(|tree| tree.reach())) };
        let [mut tree, from_goal] = trees;
        let goal = tree.graft(meeting.from_start, &from_goal, meeting.from_goal)[0];
        Ok(Way { path: tree.way_to(goal), tree, goal })
    }

    /// The lattice may know a shorter way round, through another door, which a tree that has grown seldom finds. Soon any shorter one, so that
    /// the search for the shortest has less to look at.
    fn look_elsewhere(&self, sampler: &mut Sampler<'_, S>, guide: &mut Guide<'_, S>, way: &mut Way) {
        let ends = [way.path[0], way.path[way.path.len() - 1]];
        let until = self.budget.part(LATTICE);
        for greed in GREED {
            let longest = length(&way.path);
            if longest < STRAIGHT * distance(ends[0], ends[1]) || until.is_spent(sampler.drawn) {
                return;
            }
            let Some(path) = guide.path(sampler, Wish { greed, longest }, &until) else { continue };
            let path = shorten(self.space, path, Effort::Quick);
            if length(&path) < longest {
                *way = Way::along(path, Tree::new(ends[0], self.space.dimensions()));
            }
        }
    }

    /// Length of the trees' branches: short against the space, long against what is in it.
    fn stride(&self) -> f64 {
        let [low, high] = self.space.bounds();
        (distance(low, high) / 50.0).clamp(0.5, self.space.longest())
    }

    fn finish(&self, best: &[Point], tree: &Tree, first: First, samples: usize) -> Plan {
        let mut path: Vec<Point> = best.first().copied().into_iter().collect();
        for w in best.windows(2) {
            // On wheels the last piece may have ended a little above or below this one's start: go on from there if that is free as well.
            let at = path.last().copied().filter(|at| self.space.reach(*at, w[1]).is_some());
            if at.is_none() {
                path.push(w[0]);
            }
            self.space.trace(at.unwrap_or(w[0]), w[1], &mut path);
        }
        let Robot { radius, unknown, .. } = self.request.robot;
        // Where submaps share space the query is careful by a voxel; the path was checked for the radius itself.
        let ask = |p: Point| self.map.clearance(p, radius + CLEARANCE, unknown).max(radius);
        let clearance: Vec<f64> = path.iter().map(|p| ask(*p)).collect();
        let mut least = clearance.iter().copied().fold(f64::INFINITY, f64::min);
        for w in path.windows(2) {
            let all = distance(w[0], w[1]);
            let mut at = 0.0;
            while at < all {
                let here = ask(between(w[0], w[1], at / all));
                least = least.min(here);
                // Within this distance nothing can be nearer than the least.
                at += (here - least).max(self.map.voxel());
            }
        }
        let (length, tree) = (length(&path), tree.nodes().collect());
        Plan { length, path, clearance, least_clearance: least, first, seconds: self.budget.seconds(), samples, tree, height: None }
    }
}
