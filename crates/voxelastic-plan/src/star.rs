//! Shorter paths as long as time lasts: RRT* (Karaman and Frazzoli, 2011) with as many neighbours as its proof asks for.
//!
//! Three things are added to the textbook's. Nodes that cannot be part of a shorter path are not added (Gammell and others, 2014).
//! Samples are drawn near the best path half of the time. And each better path is shortened at once (`shorten.rs`) and goes back
//! into the tree, so that the tree knows how short it has to be.

use crate::budget::Budget;
use crate::connect::flat_distance;
use crate::nearest::Found;
use crate::points::{Point, between, distance, length};
use crate::sample::Sampler;
use crate::shorten::{self, Effort};
use crate::space::Space;
use crate::tree::Tree;

/// Share of the samples that are drawn near the best path, and that look for doorways.
const NEAR: f64 = 0.5;
const BRIDGES: f64 = 0.1;
/// Spread of the samples near the best path, metres.
const SPREAD: f64 = 1.0;
/// A path through the tree counts as a better one when it is this much shorter than the last that was shortened.
const WORTHWHILE: f64 = 0.995;

/// A search for the shortest path in a tree that has one.
pub(crate) struct Star<'a, S> {
    space: &'a S,
    tree: &'a mut Tree,
    goal: u32,
    stride: f64,
    best: Vec<Point>,
    best_length: f64,
    /// Length of the tree's path when it was last shortened.
    shortened: f64,
    near: Vec<Found>,
    order: Vec<(f64, u32)>,
}

impl<'a, S: Space> Star<'a, S> {
    /// A search from the root of `tree` to its node `goal`, in steps of at most `stride` metres. `best` is a path already shortened.
    pub(crate) fn new(space: &'a S, tree: &'a mut Tree, goal: u32, stride: f64, best: Vec<Point>) -> Self {
        let best_length = length(&best);
        let mut star = Self { space, tree, goal, stride, best, best_length, shortened: f64::INFINITY, near: Vec::new(), order: Vec::new() };
        star.teach();
        star.shortened = star.tree.cost(star.goal);
        star
    }

    /// Searches until the budget ends; the best path.
    pub(crate) fn run(mut self, sampler: &mut Sampler<'_, S>, budget: &Budget) -> Vec<Point> {
        sampler.keep_within([self.tree.point(0), self.tree.point(self.goal)], self.best_length);
        while !budget.is_spent(sampler.drawn) {
            if let Some(sample) = self.sample(sampler) {
                self.extend(sample);
            }
            if self.tree.cost(self.goal) < WORTHWHILE * self.shortened {
                self.shorten();
                sampler.keep_within([self.tree.point(0), self.tree.point(self.goal)], self.best_length);
            }
        }
        if self.tree.cost(self.goal) < self.shortened {
            self.shorten();
        }
        self.best
    }

    fn sample(&self, sampler: &mut Sampler<'_, S>) -> Option<Point> {
        let turn = sampler.share();
        let sample = if turn < NEAR {
            sampler.near(&self.best, SPREAD)
        } else if turn < NEAR + BRIDGES {
            sampler.bridge()
        } else {
            sampler.anywhere()
        };
        let (start, goal) = (self.tree.point(0), self.tree.point(self.goal));
        sample.filter(|p| self.flat(start, *p) + self.flat(*p, goal) < self.best_length)
    }

    fn flat(&self, a: Point, b: Point) -> f64 {
        flat_distance(self.space, a, b)
    }

    /// Grows the tree by a node towards `sample`, below the parent that makes it cheapest, and moves neighbours below the new
    /// node where that makes them cheaper.
    fn extend(&mut self, sample: Point) {
        let from = self.tree.point(self.tree.nearest(sample));
        let off = self.flat(from, sample);
        let target = if off <= self.stride { sample } else { between(from, sample, self.stride / off) };
        if off < 1e-3 {
            return;
        }
        self.neighbours(target);
        let Some((new, p)) = self.add_cheapest(target) else { return };
        for i in 0..self.near.len() {
            let node = self.near[i].1;
            let cost = self.tree.cost(new) + distance(p, self.tree.point(node));
            if cost < self.tree.cost(node) - 1e-9 && self.space.joins(p, self.tree.point(node)) {
                self.tree.move_below(node, new);
            }
        }
    }

    /// The nodes around `p`, e (1 + 1 / d) ln n of them.
    fn neighbours(&mut self, p: Point) {
        let d = self.space.dimensions() as f64;
        let count = (std::f64::consts::E * (1.0 + 1.0 / d) * (self.tree.len() as f64 + 1.0).ln()).ceil() as usize;
        self.tree.several(p, count, &mut self.near);
    }

    /// Adds a node at `target` below the neighbour from which the way is shortest; none when no neighbour reaches it, or the
    /// way is too long to be of use.
    fn add_cheapest(&mut self, target: Point) -> Option<(u32, Point)> {
        let goal = self.tree.point(self.goal);
        self.order.clear();
        for &(_, node) in &self.near {
            let cost = self.tree.cost(node) + distance(self.tree.point(node), target);
            if cost + self.flat(target, goal) < self.best_length {
                self.order.push((cost, node));
            }
        }
        self.order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let reached = self.order.iter().find_map(|&(_, node)| Some((node, self.space.reach(self.tree.point(node), target)?)));
        let (parent, arrived) = reached?;
        Some((self.tree.add(parent, arrived), arrived))
    }

    fn shorten(&mut self) {
        self.shortened = self.tree.cost(self.goal);
        let found = shorten::shorten(self.space, self.tree.way_to(self.goal), Effort::Quick);
        if length(&found) < self.best_length {
            self.best_length = length(&found);
            self.best = found;
            self.teach();
            self.shortened = self.tree.cost(self.goal);
        }
    }

    /// Puts the best path into the tree, in pieces no longer than a stride, and its neighbours below it where that helps.
    fn teach(&mut self) {
        let mut node = 0;
        for i in 1..self.best.len() {
            let (from, to) = (self.best[i - 1], self.best[i]);
            let pieces = (distance(from, to) / self.stride).ceil().max(1.0) as usize;
            let mut last = self.tree.point(node);
            for k in 1..=pieces {
                let target = between(from, to, k as f64 / pieces as f64);
                let is_goal = i + 1 == self.best.len() && k == pieces;
                let Some(arrived) = self.space.reach(last, target) else { return };
                if is_goal {
                    let cost = self.tree.cost(node) + distance(last, self.tree.point(self.goal));
                    if cost < self.tree.cost(self.goal) && self.space.is_same(arrived, self.tree.point(self.goal)) {
                        self.tree.move_below(self.goal, node);
                    }
                    return;
                }
                node = self.tree.add(node, arrived);
                last = arrived;
            }
        }
    }
}
