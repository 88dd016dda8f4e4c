//! RRT-Connect (Kuffner and LaValle, 2000): two trees, rooted in the start and in the goal, grow towards random states and towards each other.

use crate::points::{Point, between};
use crate::search::sampler::Sampler;
use crate::search::stop::StopCriterion;
use crate::search::tree::Tree;
use crate::space::Space;

/// Share of the samples drawn by the bridge test, which finds doorways.
const BRIDGE_SHARE: f64 = 0.3;
/// Share of the samples that are doorways found before and not reached yet.
const RETRY_SHARE: f64 = 0.2;
/// Number of nearest nodes that try to reach a doorway: the motion from most of them meets the wall next to it.
const DOORWAY_NEIGHBOURS: usize = 6;
/// Where a full step is not free, it is halved, down to this share of it.
const MIN_STEP_SHARE: f64 = 0.2;

/// The node of each tree at which the trees met.
pub(crate) struct Meeting {
    pub from_start: u32,
    pub from_goal: u32,
}

/// Result of growing a tree towards a state.
enum Growth {
    /// The state was reached; its node.
    Reached(u32),
    /// The tree grew towards it; the last node.
    Advanced(u32),
    /// No motion was free.
    Trapped,
}

/// Grows the trees, rooted in the start and in the goal, by motions of at most `max_step` metres until they meet; none when the search is stopped
/// before. `doorways` are states that the path probably passes.
pub(crate) fn rrt_connect<S: Space>(
    sampler: &mut Sampler<'_, S>,
    space: &S,
    trees: &mut [Tree; 2],
    max_step: f64,
    doorways: &[Point],
    stop: &StopCriterion,
) -> Option<Meeting> {
    let [start, goal] = trees;
    let mut near = Vec::new();
    if let Growth::Reached(node) = grow(space, start, 0, goal.point(0), max_step, false) {
        return Some(Meeting { from_start: node, from_goal: 0 });
    }
    let mut pending = doorways.to_vec();
    let mut from_goal_side = false;
    while !stop.is_reached(sampler.drawn) {
        // The trees alternate, also when one cannot grow.
        from_goal_side = !from_goal_side;
        let draw = sampler.uniform();
        let is_retry = draw < RETRY_SHARE && !pending.is_empty();
        let is_doorway = is_retry || draw < RETRY_SHARE + BRIDGE_SHARE;
        let sample = if is_retry {
            let index = sampler.index_below(pending.len());
            Some(pending.swap_remove(index))
        } else if is_doorway {
            sampler.bridge_state()
        } else {
            sampler.uniform_state()
        };
        let Some(sample) = sample else { continue };
        let [growing, other] = trees;
        let (growing, other) = if from_goal_side { (other, growing) } else { (growing, other) };
        growing.nearest_n(sample, if is_doorway { DOORWAY_NEIGHBOURS } else { 1 }, &mut near);
        let (mut new, mut is_reached) = (None, false);
        for &(_, from) in &near {
            match grow(space, growing, from, sample, max_step, from_goal_side) {
                Growth::Reached(node) => (new, is_reached) = (Some(node), true),
                Growth::Advanced(node) => new = Some(node),
                Growth::Trapped => continue,
            }
            break;
        }
        if is_doorway && !is_reached {
            pending.push(sample);
        }
        let Some(new) = new else { continue };
        let to = growing.point(new);
        if let Growth::Reached(met) = grow(space, other, other.nearest(to), to, max_step, !from_goal_side) {
            let (from_start, from_goal) = if from_goal_side { (met, new) } else { (new, met) };
            return Some(Meeting { from_start, from_goal });
        }
    }
    None
}

/// Grows a tree from one of its nodes towards `to` as far as motions are free. `is_reversed`: paths in this tree lead to its root.
fn grow<S: Space>(space: &S, tree: &mut Tree, from: u32, to: Point, max_step: f64, is_reversed: bool) -> Growth {
    let (mut node, mut growth) = (from, Growth::Trapped);
    let mut step = max_step;
    loop {
        let from = tree.point(node);
        let remaining = space.metric(from, to);
        let is_last = remaining <= step;
        let target = if is_last { to } else { between(from, to, step / remaining) };
        // The motion must be free in the direction in which the robot will take it.
        let arrived = space.steer(from, target).filter(|arrived| !is_reversed || space.is_reversible(from, *arrived));
        let Some(arrived) = arrived else {
            step = 0.5 * step.min(remaining);
            if step < MIN_STEP_SHARE * max_step {
                return growth;
            }
            continue;
        };
        let is_reached = is_last && space.is_same(arrived, to);
        // Equal states are stored as the same point.
        node = tree.add(node, if is_reached { to } else { arrived });
        if is_reached {
            return Growth::Reached(node);
        }
        growth = Growth::Advanced(node);
        if is_last || step < max_step {
            return growth;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::length;
    use std::time::Duration;

    /// A plane with a wall along x = 0 that has a gap around y = `gap`, if it has one.
    struct Wall {
        gap: Option<f64>,
    }

    const HALF: f64 = 0.25;

    impl Space for Wall {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            let inside = to.iter().all(|c| c.abs() <= 10.0);
            let crosses = (from[0] > 0.0) != (to[0] > 0.0);
            let y = from[1] + (to[1] - from[1]) * from[0] / (from[0] - to[0]);
            (inside && (!crosses || self.gap.is_some_and(|gap| (y - gap).abs() < HALF))).then_some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            let is_wall = p[0].abs() < 0.1 && self.gap.is_none_or(|gap| (p[1] - gap).abs() >= HALF);
            (!is_wall).then_some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-10.0, -10.0, 0.0], [10.0, 10.0, 0.1]]
        }
    }

    fn search(wall: &Wall, samples: usize) -> ([Tree; 2], Option<Meeting>, usize) {
        let mut sampler = Sampler::new(wall, 7);
        let mut trees = [Tree::new([-5.0, -8.0, 0.0], 3), Tree::new([5.0, -8.0, 0.0], 3)];
        let stop = StopCriterion::new(Duration::from_secs(60), Some(samples));
        let met = rrt_connect(&mut sampler, wall, &mut trees, 1.5, &[], &stop);
        (trees, met, sampler.drawn)
    }

    #[test]
    fn trees_meet_through_a_gap() {
        let wall = Wall { gap: Some(6.0) };
        let ([mut tree, other], met, _) = search(&wall, 20_000);
        let met = met.expect("there is a gap");
        let index = tree.graft(met.from_start, &other, met.from_goal);
        let path = tree.path_to(index[0]);
        assert_eq!((path[0], path[path.len() - 1]), ([-5.0, -8.0, 0.0], [5.0, -8.0, 0.0]));
        assert!(path.windows(2).all(|w| wall.connects(w[0], w[1])));
        assert!(length(&path) > 2.0 * 14f64.hypot(5.0) * 0.97);
    }

    #[test]
    fn trees_that_cannot_meet_stop_at_the_sample_limit() {
        let ([start, goal], met, drawn) = search(&Wall { gap: None }, 500);
        assert!(met.is_none() && drawn == 500);
        assert!(start.extent() > 8.0 && goal.extent() > 8.0);
    }
}
