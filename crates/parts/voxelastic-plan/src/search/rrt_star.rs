//! RRT* (Karaman and Frazzoli, 2011): shortens paths as long as there is time, with the number of neighbours that its optimality proof requires.
//!
//! Three additions: nodes that cannot be part of a shorter path are rejected (Gammell and others, 2014); half of the samples are drawn near the
//! best path; and every better path is shortened (`shorten.rs`) and inserted into the tree, which tightens the bound on useful nodes.

use crate::points::{Point, between, distance, length};
use crate::search::kd_tree::Neighbour;
use crate::search::sampler::Sampler;
use crate::search::shorten::{self, Effort};
use crate::search::stop::StopCriterion;
use crate::search::tree::Tree;
use crate::space::Space;

/// Share of the samples drawn near the best path.
const NEAR_PATH_SHARE: f64 = 0.5;
/// Share of the samples drawn by the bridge test.
const BRIDGE_SHARE: f64 = 0.1;
/// Scale of the offsets of samples near the best path, metres.
const NEAR_PATH_SPREAD: f64 = 1.0;
/// The tree's path is shortened again when its length is below this share of that when it was last shortened.
const SHORTEN_RATIO: f64 = 0.995;

/// A search for shorter paths in a tree that has one.
pub(crate) struct RrtStar<'a, S> {
    space: &'a S,
    tree: &'a mut Tree,
    goal: u32,
    max_step: f64,
    best: Vec<Point>,
    best_length: f64,
    /// Length of the tree's path when it was last shortened, metres.
    shortened_at: f64,
    neighbours: Vec<Neighbour>,
    candidates: Vec<(f64, u32)>,
}

impl<'a, S: Space> RrtStar<'a, S> {
    /// A search from the root of `tree` to its node `goal`, by motions of at most `max_step` metres. `best` is a path that was shortened already.
    pub(crate) fn new(space: &'a S, tree: &'a mut Tree, goal: u32, max_step: f64, best: Vec<Point>) -> Self {
        let best_length = length(&best);
        let (shortened_at, neighbours, candidates) = (f64::INFINITY, Vec::new(), Vec::new());
        let mut star = Self { space, tree, goal, max_step, best, best_length, shortened_at, neighbours, candidates };
        star.insert_best_path();
        star.shortened_at = star.tree.cost(star.goal);
        star
    }

    /// Searches until stopped and returns the best path.
    pub(crate) fn run(mut self, sampler: &mut Sampler<'_, S>, stop: &StopCriterion) -> Vec<Point> {
        sampler.restrict_to_ellipsoid([self.tree.point(0), self.tree.point(self.goal)], self.best_length);
        while !stop.is_reached(sampler.drawn) {
            if let Some(sample) = self.sample(sampler) {
                self.extend(sample);
            }
            if self.tree.cost(self.goal) < SHORTEN_RATIO * self.shortened_at {
                self.shorten();
                sampler.restrict_to_ellipsoid([self.tree.point(0), self.tree.point(self.goal)], self.best_length);
            }
        }
        if self.tree.cost(self.goal) < self.shortened_at {
            self.shorten();
        }
        self.best
    }

    fn sample(&self, sampler: &mut Sampler<'_, S>) -> Option<Point> {
        let draw = sampler.uniform();
        let sample = if draw < NEAR_PATH_SHARE {
            sampler.state_near(&self.best, NEAR_PATH_SPREAD)
        } else if draw < NEAR_PATH_SHARE + BRIDGE_SHARE {
            sampler.bridge_state()
        } else {
            sampler.uniform_state()
        };
        let (start, goal) = (self.tree.point(0), self.tree.point(self.goal));
        sample.filter(|p| self.space.metric(start, *p) + self.space.metric(*p, goal) < self.best_length)
    }

    /// Adds a node towards `sample` with the parent of least cost, and rewires neighbours to it where that lowers their cost.
    fn extend(&mut self, sample: Point) {
        let from = self.tree.point(self.tree.nearest(sample));
        let off = self.space.metric(from, sample);
        let target = if off <= self.max_step { sample } else { between(from, sample, self.max_step / off) };
        if off < 1e-3 {
            return;
        }
        self.find_neighbours(target);
        let Some((new, p)) = self.add_cheapest(target) else { return };
        for i in 0..self.neighbours.len() {
            let node = self.neighbours[i].1;
            let cost = self.tree.cost(new) + distance(p, self.tree.point(node));
            if cost < self.tree.cost(node) - 1e-9 && self.space.connects(p, self.tree.point(node)) {
                self.tree.reparent(node, new);
            }
        }
    }

    /// Collects the e (1 + 1 / d) ln n nodes nearest to `p`.
    fn find_neighbours(&mut self, p: Point) {
        let d = self.space.dimensions() as f64;
        let count = (std::f64::consts::E * (1.0 + 1.0 / d) * (self.tree.len() as f64 + 1.0).ln()).ceil() as usize;
        self.tree.nearest_n(p, count, &mut self.neighbours);
    }

    /// Adds a node at `target` below the neighbour over which its cost is least; none when no neighbour reaches it or no shorter path can lead over it.
    fn add_cheapest(&mut self, target: Point) -> Option<(u32, Point)> {
        let goal = self.tree.point(self.goal);
        self.candidates.clear();
        for &(_, node) in &self.neighbours {
            let cost = self.tree.cost(node) + distance(self.tree.point(node), target);
            if cost + self.space.metric(target, goal) < self.best_length {
                self.candidates.push((cost, node));
            }
        }
        self.candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let reached = self.candidates.iter().find_map(|&(_, node)| Some((node, self.space.steer(self.tree.point(node), target)?)));
        let (parent, arrived) = reached?;
        Some((self.tree.add(parent, arrived), arrived))
    }

    fn shorten(&mut self) {
        self.shortened_at = self.tree.cost(self.goal);
        let found = shorten::shorten(self.space, self.tree.path_to(self.goal), Effort::Quick);
        if length(&found) < self.best_length {
            self.best_length = length(&found);
            self.best = found;
            self.insert_best_path();
            self.shortened_at = self.tree.cost(self.goal);
        }
    }

    /// Inserts the best path into the tree, in motions of at most `max_step`, and makes the goal a child of its end if that lowers the goal's cost.
    fn insert_best_path(&mut self) {
        let mut node = 0;
        for i in 1..self.best.len() {
            let (from, to) = (self.best[i - 1], self.best[i]);
            let motions = (distance(from, to) / self.max_step).ceil().max(1.0) as usize;
            let mut last = self.tree.point(node);
            for k in 1..=motions {
                let target = between(from, to, k as f64 / motions as f64);
                let is_goal = i + 1 == self.best.len() && k == motions;
                let Some(arrived) = self.space.steer(last, target) else { return };
                if is_goal {
                    let cost = self.tree.cost(node) + distance(last, self.tree.point(self.goal));
                    if cost < self.tree.cost(self.goal) && self.space.is_same(arrived, self.tree.point(self.goal)) {
                        self.tree.reparent(self.goal, node);
                    }
                    return;
                }
                node = self.tree.add(node, arrived);
                last = arrived;
            }
        }
    }
}
