//! The first path: two trees, from the start and from the goal, that grow towards random states and towards each other
//! (RRT-Connect, Kuffner and LaValle, 2000).

use crate::budget::Budget;
use crate::points::{Point, between, distance};
use crate::sample::Sampler;
use crate::space::Space;
use crate::tree::Tree;

/// Share of the samples that look for doorways.
const BRIDGES: f64 = 0.3;
/// Share of the samples that are doorways found before to which no way was found yet.
const AGAIN: f64 = 0.2;
/// A doorway is tried from this many of a tree's nearest nodes: most of them see only the wall beside it.
const TRIES: usize = 6;
/// Where a whole stride is not free, half of it is tried, and so on down to this share.
const LEAST_STRIDE: f64 = 0.2;

/// Two trees that met: the nodes of each where they did.
pub(crate) struct Meeting {
    pub from_start: u32,
    pub from_goal: u32,
}

/// How far a tree grew towards a state.
enum Growth {
    /// To the state itself: this node.
    Arrived(u32),
    /// To this node.
    Closer(u32),
    /// Not at all.
    Stuck,
}

/// Grows the trees, rooted in the start and in the goal, in steps of `stride` metres until they meet; none when the budget ends
/// before. `doorways` are states that are known to be on the way, likely.
pub(crate) fn connect<S: Space>(
    sampler: &mut Sampler<'_, S>,
    space: &S,
    trees: &mut [Tree; 2],
    stride: f64,
    doorways: &[Point],
    budget: &Budget,
) -> Option<Meeting> {
    let [start, goal] = trees;
    let mut near = Vec::new();
    if let Growth::Arrived(node) = grow(space, start, 0, goal.point(0), stride, false) {
        return Some(Meeting { from_start: node, from_goal: 0 });
    }
    let mut waiting = doorways.to_vec();
    let mut turned = false;
    while !budget.is_spent(sampler.drawn) {
        // By turns: a tree that cannot grow must not keep the other from it.
        turned = !turned;
        let turn = sampler.share();
        let is_again = turn < AGAIN && !waiting.is_empty();
        let is_bridge = is_again || turn < AGAIN + BRIDGES;
        let sample = if is_again {
            let place = sampler.below(waiting.len());
            Some(waiting.swap_remove(place))
        } else if is_bridge {
            sampler.bridge()
        } else {
            sampler.anywhere()
        };
        let Some(sample) = sample else { continue };
        let [growing, other] = trees;
        let (growing, other) = if turned { (other, growing) } else { (growing, other) };
        growing.several(sample, if is_bridge { TRIES } else { 1 }, &mut near);
        let (mut new, mut has_arrived) = (None, false);
        for &(_, from) in &near {
            match grow(space, growing, from, sample, stride, turned) {
                Growth::Arrived(node) => (new, has_arrived) = (Some(node), true),
                Growth::Closer(node) => new = Some(node),
                Growth::Stuck => continue,
            }
            break;
        }
        if is_bridge && !has_arrived {
            waiting.push(sample);
        }
        let Some(new) = new else { continue };
        let to = growing.point(new);
        if let Growth::Arrived(met) = grow(space, other, other.nearest(to), to, stride, !turned) {
            let (from_start, from_goal) = if turned { (met, new) } else { (new, met) };
            return Some(Meeting { from_start, from_goal });
        }
    }
    None
}

/// Steps from a node of the tree towards `to` as far as nothing is in the way. `turned`: ways in this tree lead to its root.
fn grow<S: Space>(space: &S, tree: &mut Tree, from: u32, to: Point, stride: f64, turned: bool) -> Growth {
    let (mut node, mut growth) = (from, Growth::Stuck);
    let mut step = stride;
    loop {
        let from = tree.point(node);
        let left = flat_distance(space, from, to);
        let is_last = left <= step;
        let target = if is_last { to } else { between(from, to, step / left) };
        // The way must hold in the direction in which it is gone.
        let arrived = space.reach(from, target).filter(|arrived| !turned || space.leads_back(from, *arrived));
        let Some(arrived) = arrived else {
            step = 0.5 * step.min(left);
            if step < LEAST_STRIDE * stride {
                return growth;
            }
            continue;
        };
        let joins = is_last && space.is_same(arrived, to);
        // What is the same for all purposes is the same place.
        node = tree.add(node, if joins { to } else { arrived });
        if joins {
            return Growth::Arrived(node);
        }
        growth = Growth::Closer(node);
        if is_last || step < stride {
            return growth;
        }
    }
}

/// Distance in the coordinates that can be chosen.
pub(crate) fn flat_distance<S: Space>(space: &S, a: Point, b: Point) -> f64 {
    if space.dimensions() == 2 { (a[0] - b[0]).hypot(a[1] - b[1]) } else { distance(a, b) }
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
        fn reach(&self, from: Point, to: Point) -> Option<Point> {
            let inside = to.iter().all(|c| c.abs() <= 10.0);
            let crosses = (from[0] > 0.0) != (to[0] > 0.0);
            let y = from[1] + (to[1] - from[1]) * from[0] / (from[0] - to[0]);
            (inside && (!crosses || self.gap.is_some_and(|gap| (y - gap).abs() < HALF))).then_some(to)
        }

        fn settle(&self, p: Point) -> Option<Point> {
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
        let budget = Budget::new(Duration::from_secs(60), Some(samples));
        let met = connect(&mut sampler, wall, &mut trees, 1.5, &[], &budget);
        (trees, met, sampler.drawn)
    }

    #[test]
    fn trees_meet_through_a_gap() {
        let wall = Wall { gap: Some(6.0) };
        let ([mut tree, other], met, _) = search(&wall, 20_000);
        let met = met.expect("there is a gap");
        let became = tree.graft(met.from_start, &other, met.from_goal);
        let way = tree.way_to(became[0]);
        assert_eq!((way[0], way[way.len() - 1]), ([-5.0, -8.0, 0.0], [5.0, -8.0, 0.0]));
        assert!(way.windows(2).all(|w| wall.joins(w[0], w[1])));
        assert!(length(&way) > 2.0 * 14f64.hypot(5.0) * 0.97);
    }

    #[test]
    fn trees_that_cannot_meet_stop_with_the_budget() {
        let ([start, goal], met, drawn) = search(&Wall { gap: None }, 500);
        assert!(met.is_none() && drawn == 500);
        assert!(start.reach() > 8.0 && goal.reach() > 8.0);
    }
}
