//! Global search: A* over a [`Lattice`], and motions along its result.
//!
//! Random trees are slow to find the one door of a court; a lattice finds it soon, but is coarse, and a doorway may lie between its nodes. So nodes
//! where only a smaller ball fits are allowed at a higher cost. A sequence of nodes is not a path yet: [`LatticeSearch::find_path`] follows it by exact
//! motions and, where these end at tight nodes, connects across by two small trees (`rrt_connect.rs`). If that fails, the tight nodes are
//! marked blocked and the search is repeated.

use crate::points::{Point, distance};
use crate::search::lattice::Lattice;
use crate::search::rrt_connect::rrt_connect;
use crate::search::sampler::Sampler;
use crate::search::stop::StopCriterion;
use crate::search::tree::Tree;
use crate::space::{Fit, Space};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cost of a step to a tight node relative to one to a free node.
const TIGHT_COST: f32 = 4.0;
/// Expanded nodes that count as one sample.
const NODES_PER_SAMPLE: usize = 32;
/// Longest motion tried along a node sequence, nodes.
const MAX_MOTION: usize = 64;
/// Samples for connecting across a tight place.
const LOCAL_SAMPLES: usize = 120;
/// Length of the local trees' branches, metres.
const LOCAL_STEP: f64 = 1.0;
/// A local connection may be longer than the straight line by this much, metres.
const LOCAL_DETOUR: f64 = 2.0;
/// Number of free nodes beyond a tight place that are tried as targets.
const MAX_TARGETS: usize = 3;
/// Least number of nodes between two targets.
const TARGET_SPACING: usize = 4;

/// The middle of a doorway is searched for in steps of this share of the node spacing ..
const OFFSET_STEP: f64 = 1.0 / 32.0;
/// .. and this many steps to either side.
const MAX_OFFSETS: i32 = 28;

/// Sums of the same lengths in another order differ by less, metres.
const MIN_GAIN: f32 = 1e-2;

/// How to search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SearchParams {
    /// Weight of the heuristic: 1 for the shortest path, more to find any path sooner (weighted A*).
    pub heuristic_weight: f32,
    /// Nodes are skipped if even a straight line from them to the goal would make the path longer than this, metres.
    pub max_length: f64,
}

/// A search for paths between two states. What it learns about the space is kept for the next search.
pub(crate) struct LatticeSearch<'a, S> {
    space: &'a S,
    start: Point,
    goal: Point,
    lattice: Lattice<'a, S>,
}

/// Entry of the priority queue: estimated length of the path over the node, the node, and the length up to it when it was queued (as bits).
type QueueEntry = (Reverse<u32>, u32, u32);

impl<'a, S: Space> LatticeSearch<'a, S> {
    /// A search from `start` to `goal` for a robot of this radius.
    pub(crate) fn new(space: &'a S, start: Point, goal: Point, radius: f64) -> Self {
        Self { space, start, goal, lattice: Lattice::new(space, start, goal, radius) }
    }

    /// A path along which every motion is free; none if there is none within `params` or the search is stopped before.
    pub(crate) fn find_path(&mut self, sampler: &mut Sampler<'_, S>, params: SearchParams, stop: &StopCriterion) -> Option<Vec<Point>> {
        loop {
            let nodes = self.search(sampler, params, stop)?;
            match self.follow(sampler, &nodes, stop) {
                Ok(path) => return Some(path),
                Err(blocked) => blocked.iter().for_each(|node| self.lattice.set_fit(*node, Fit::Blocked)),
            }
            if nodes.len() == 1 || stop.is_reached(sampler.drawn) {
                return None;
            }
        }
    }

    /// The nodes of a path over the lattice; with a heuristic weight of 1 the cheapest.
    fn search(&mut self, sampler: &mut Sampler<'_, S>, params: SearchParams, stop: &StopCriterion) -> Option<Vec<usize>> {
        let first = self.lattice.node_at(self.start)?;
        self.lattice.set_height(first, self.start[2]);
        let steps = self.lattice.steps();
        // Zeroed pages that are never written cost nothing. Cost 0 means not reached.
        let (mut costs, mut parents) = (vec![0f32; self.lattice.len()], vec![0u32; self.lattice.len()]);
        costs[first] = f32::MIN_POSITIVE;
        let mut queue: BinaryHeap<QueueEntry> = BinaryHeap::from([(Reverse(0), first as u32, costs[first].to_bits())]);
        let mut expanded = 0;
        while let Some((_, entry, queued_cost)) = queue.pop() {
            let (node, cost) = (entry as usize, costs[entry as usize]);
            if cost.to_bits() != queued_cost {
                continue;
            }
            let p = self.lattice.point(node);
            if self.lattice.is_at_goal(p) {
                let mut nodes: Vec<usize> = std::iter::successors(Some(node), |at| (*at != first).then(|| parents[*at] as usize)).collect();
                nodes.reverse();
                return Some(nodes);
            }
            expanded += 1;
            if expanded == NODES_PER_SAMPLE {
                expanded = 0;
                sampler.drawn += 1;
                if stop.is_reached(sampler.drawn) {
                    return None;
                }
            }
            let c = self.lattice.coords(node);
            for &(by, length) in &steps {
                let Some((to, fit)) = self.lattice.neighbour(c, p, by) else { continue };
                let new_cost = cost + if fit == Fit::Free { length } else { TIGHT_COST * length };
                // With a weighted heuristic the first path to a node is kept.
                if costs[to] != 0.0 && (costs[to] <= new_cost + MIN_GAIN || params.heuristic_weight > 1.0) {
                    continue;
                }
                let position = self.lattice.point(to);
                let (remaining, straight) = self.lattice.remaining(position);
                if distance(position, self.start).max(0.9 * f64::from(new_cost)) + straight > params.max_length {
                    continue;
                }
                (costs[to], parents[to]) = (new_cost, entry);
                // The bits of non-negative floats are in the order of the floats.
                queue.push((Reverse((new_cost + params.heuristic_weight * remaining).to_bits()), to as u32, new_cost.to_bits()));
            }
        }
        None
    }

    /// A path of free motions along a sequence of nodes.
    ///
    /// # Errors
    /// The nodes at which the robot does not get through.
    fn follow(&mut self, sampler: &mut Sampler<'_, S>, nodes: &[usize], stop: &StopCriterion) -> Result<Vec<Point>, Vec<usize>> {
        let mut path = vec![self.start];
        // Number of nodes that the path has passed.
        let mut passed = 1;
        while passed <= nodes.len() {
            let at = path[path.len() - 1];
            if let Some((next, arrived)) = self.farthest_motion(at, nodes, passed) {
                path.push(arrived);
                passed = next;
                continue;
            }
            let targets = self.targets(nodes, passed);
            let connection = targets.iter().find_map(|&next| {
                let waypoints = self.doorway_middles(nodes, passed, next);
                Some((next, self.connect_locally(sampler, [at, self.node_or_goal(nodes, next)], &waypoints, stop)?))
            });
            let Some((next, part)) = connection else {
                let first = passed.min(nodes.len() - 1);
                return Err(nodes[first..targets[0].clamp(first + 1, nodes.len())].to_vec());
            };
            nodes[passed..=next.min(nodes.len() - 1)].iter().for_each(|node| self.lattice.set_fit(*node, Fit::Free));
            path.extend(&part[1..]);
            passed = next + 1;
        }
        Ok(path)
    }

    /// Position of the `i`-th node of a sequence; after the last comes the goal.
    fn node_or_goal(&self, nodes: &[usize], i: usize) -> Point {
        nodes.get(i).map_or(self.goal, |node| self.lattice.point(*node))
    }

    /// The farthest node of the sequence that a free motion from `at` was found to, by doubling the step: number of nodes passed then, and the state
    /// that the robot arrives at.
    fn farthest_motion(&self, at: Point, nodes: &[usize], passed: usize) -> Option<(usize, Point)> {
        let mut found = None;
        let mut step = 1;
        while step <= MAX_MOTION {
            let next = (passed + step - 1).min(nodes.len());
            let target = self.node_or_goal(nodes, next);
            let is_goal = next == nodes.len();
            let arrived = self.space.steer(at, target).filter(|arrived| !is_goal || self.space.is_same(*arrived, target));
            let Some(arrived) = arrived else { return found };
            found = Some((next + 1, if is_goal { target } else { arrived }));
            if is_goal {
                return found;
            }
            step *= 2;
        }
        found
    }

    /// Positions in the sequence from `passed` on that are not tight, as targets of a local connection; the goal is the last candidate.
    fn targets(&self, nodes: &[usize], passed: usize) -> Vec<usize> {
        let is_free = |i: &usize| nodes.get(*i).is_none_or(|node| self.lattice.fit(*node) == Some(Fit::Free));
        let mut targets: Vec<usize> = Vec::new();
        for i in (passed..=nodes.len()).filter(is_free) {
            if targets.last().is_none_or(|last| i > last + TARGET_SPACING) && targets.len() < MAX_TARGETS {
                targets.push(i);
            }
        }
        targets
    }

    /// For each tight node before position `end`, the middle of the widest free interval on the line through it across the path: the middle of a
    /// doorway.
    fn doorway_middles(&self, nodes: &[usize], passed: usize, end: usize) -> Vec<Point> {
        let spacing = self.lattice.spacing();
        let tight = (passed..end.min(nodes.len())).filter(|i| self.lattice.fit(nodes[*i]) == Some(Fit::Tight));
        let middle = |i: usize| {
            let (before, after) = (self.node_or_goal(nodes, i.saturating_sub(2)), self.node_or_goal(nodes, (i + 2).min(nodes.len())));
            let (x, y) = (after[0] - before[0], after[1] - before[1]);
            let across = if x.hypot(y) > 0.0 { [-y / x.hypot(y), x / x.hypot(y)] } else { [1.0, 0.0] };
            let p = self.lattice.point(nodes[i]);
            let rises: &[f64] = if self.lattice.is_flat() { &[0.0] } else { &[0.0, 0.5, -0.5] };
            rises.iter().find_map(|rise| {
                let offset = |k: i32| {
                    let by = f64::from(k) * OFFSET_STEP * spacing[0];
                    self.space.state_at([p[0] + by * across[0], p[1] + by * across[1], p[2] + rise * spacing[2]])
                };
                let free: Vec<Option<Point>> = (-MAX_OFFSETS..=MAX_OFFSETS).map(offset).collect();
                let widest = free.split(|p| p.is_none()).max_by_key(|run| run.len())?;
                *widest.get(widest.len() / 2)?
            })
        };
        tight.filter_map(middle).collect()
    }

    /// A short path between two states: straight through the waypoints if that is free, else by two trees that sample them first.
    fn connect_locally(&self, sampler: &mut Sampler<'_, S>, [from, to]: [Point; 2], waypoints: &[Point], stop: &StopCriterion) -> Option<Vec<Point>> {
        let to = if to == self.goal { to } else { self.space.state_at(to)? };
        let direct = waypoints.iter().try_fold(vec![from], |mut path, p| {
            path.push(self.space.steer(path[path.len() - 1], *p)?);
            Some(path)
        });
        if let Some(mut path) = direct.filter(|path| self.space.connects(path[path.len() - 1], to)) {
            path.push(to);
            return Some(path);
        }
        let mut local = sampler.fork();
        local.restrict_to_ellipsoid([from, to], distance(from, to) + LOCAL_DETOUR);
        let mut trees = [from, to].map(|end| Tree::new(end, self.space.dimensions()));
        let met = rrt_connect(&mut local, self.space, &mut trees, LOCAL_STEP, waypoints, &stop.with_samples(LOCAL_SAMPLES));
        sampler.drawn += local.drawn;
        let [mut tree, other] = trees;
        let met = met?;
        let end = tree.graft(met.from_start, &other, met.from_goal)[0];
        Some(tree.path_to(end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::{between, length};
    use std::time::Duration;

    const RADIUS: f64 = 0.35;

    /// A plane with a thin wall along x = 0 that has gaps: middle and width.
    struct Wall(Vec<[f64; 2]>);

    impl Wall {
        fn clearance(&self, p: Point) -> f64 {
            let nearest = |gap: &[f64; 2]| {
                let inside = 0.5 * gap[1] - (p[1] - gap[0]).abs();
                if inside > 0.0 { p[0].hypot(inside) } else { p[0].abs() }
            };
            self.0.iter().map(nearest).fold(p[0].abs(), f64::max)
        }
    }

    impl Space for Wall {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            let count = (distance(from, to) / 0.02).ceil().max(1.0) as usize;
            (0..=count).all(|i| self.state_at(between(from, to, i as f64 / count as f64)).is_some()).then_some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            (p[0].abs() <= 10.0 && p[1].abs() <= 10.0 && self.clearance(p) >= RADIUS).then_some(p)
        }

        fn fit(&self, p: Point, margin: f64) -> Fit {
            let clearance = self.clearance(p);
            if clearance >= RADIUS {
                Fit::Free
            } else if clearance >= RADIUS - margin {
                Fit::Tight
            } else {
                Fit::Blocked
            }
        }

        fn bounds(&self) -> [Point; 2] {
            [[-10.0, -10.0, 0.0], [10.0, 10.0, 0.01]]
        }
    }

    const ENDS: [Point; 2] = [[-5.0, -8.03, 0.0], [5.0, -8.0, 0.0]];

    fn search(gaps: &[[f64; 2]], params: SearchParams) -> (Option<Vec<Point>>, usize) {
        let wall = Wall(gaps.to_vec());
        let mut sampler = Sampler::new(&wall, 3);
        let stop = StopCriterion::new(Duration::from_secs(60), Some(20_000));
        let path = LatticeSearch::new(&wall, ENDS[0], ENDS[1], RADIUS).find_path(&mut sampler, params, &stop);
        if let Some(path) = &path {
            assert_eq!((path[0], path[path.len() - 1]), (ENDS[0], ENDS[1]));
            assert!(path.windows(2).all(|w| wall.connects(w[0], w[1])));
        }
        (path, sampler.drawn)
    }

    const SHORTEST: SearchParams = SearchParams { heuristic_weight: 1.0, max_length: f64::INFINITY };

    #[test]
    fn finds_a_gap_between_lattice_nodes() {
        // The robot's centre has 2 cm of room.
        for middle in [6.0, 6.03, 6.08, 6.12, 6.17, 6.21] {
            let (path, _) = search(&[[middle, 2.0 * RADIUS + 0.02]], SHORTEST);
            let path = path.expect("there is a gap");
            assert!(path.iter().any(|p| p[1] > middle - 0.5));
            assert!(length(&path) < 1.2 * 2.0 * 14f64.hypot(5.0), "{}", length(&path));
        }
    }

    #[test]
    fn avoids_a_gap_that_is_too_narrow() {
        let (narrow, wide) = ([-7.0, 2.0 * RADIUS - 0.03], [8.0, 1.2]);
        let (path, _) = search(&[narrow, wide], SHORTEST);
        assert!(path.expect("there is a gap").iter().any(|p| p[1] > 7.5));
        // Of two gaps the nearer; with a weighted heuristic any.
        let (path, _) = search(&[[-2.0, 1.0], wide], SHORTEST);
        assert!(path.expect("there are gaps").iter().all(|p| p[1] < 0.0));
        assert!(search(&[[-2.0, 1.0], wide], SearchParams { heuristic_weight: 3.0, ..SHORTEST }).0.is_some());
    }

    #[test]
    fn ends_when_no_path_satisfies_the_parameters() {
        let (path, drawn) = search(&[], SHORTEST);
        assert!(path.is_none() && drawn < 1000, "{drawn}");
        let (path, drawn) = search(&[[6.0, 1.0]], SearchParams { max_length: 20.0, ..SHORTEST });
        assert!(path.is_none() && drawn < 1000, "{drawn}");
        let (path, drawn) = search(&[[-7.0, 2.0 * RADIUS - 0.03]], SHORTEST);
        assert!(path.is_none() && drawn < 3000, "{drawn}");
    }
}
