//! A tree of states that the robot can reach, with what it costs to get to each.

use crate::nearest::{Found, Nearest};
use crate::points::{Point, distance};

const NONE: u32 = u32::MAX;

/// States, each but the first reached straight from its parent.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    places: Nearest,
    parents: Vec<u32>,
    children: Vec<Vec<u32>>,
    /// Length of the way from the root, metres.
    costs: Vec<f64>,
}

impl Tree {
    pub(crate) fn new(root: Point, dimensions: usize) -> Self {
        let mut places = Nearest::new(dimensions);
        places.push(root);
        Self { places, parents: vec![NONE], children: vec![Vec::new()], costs: vec![0.0] }
    }

    pub(crate) fn len(&self) -> usize {
        self.parents.len()
    }

    pub(crate) fn point(&self, node: u32) -> Point {
        self.places.point(node)
    }

    pub(crate) fn cost(&self, node: u32) -> f64 {
        self.costs[node as usize]
    }

    pub(crate) fn parent(&self, node: u32) -> Option<u32> {
        Some(self.parents[node as usize]).filter(|p| *p != NONE)
    }

    pub(crate) fn add(&mut self, parent: u32, p: Point) -> u32 {
        let node = self.len() as u32;
        self.costs.push(self.cost(parent) + distance(self.point(parent), p));
        self.places.push(p);
        self.parents.push(parent);
        self.children.push(Vec::new());
        self.children[parent as usize].push(node);
        node
    }

    pub(crate) fn nearest(&self, p: Point) -> u32 {
        self.places.nearest(p).map_or(0, |found| found.1)
    }

    pub(crate) fn several(&self, p: Point, count: usize, found: &mut Vec<Found>) {
        self.places.several(p, count, found);
    }

    /// Hangs `node` below another parent; the costs of all below follow. The parent must not be below the node, which a
    /// parent that makes the node cheaper never is.
    pub(crate) fn move_below(&mut self, node: u32, parent: u32) {
        let before = self.parents[node as usize];
        if before != NONE {
            self.children[before as usize].retain(|child| *child != node);
        }
        self.parents[node as usize] = parent;
        self.children[parent as usize].push(node);
        self.recount(node);
    }

    /// Costs of a node and all below it, from its parent's.
    fn recount(&mut self, node: u32) {
        let mut stack = vec![node];
        while let Some(node) = stack.pop() {
            if let Some(parent) = self.parent(node) {
                self.costs[node as usize] = self.cost(parent) + distance(self.point(parent), self.point(node));
            }
            stack.extend_from_slice(&self.children[node as usize]);
        }
    }

    /// The way from the root to `node`.
    pub(crate) fn way_to(&self, node: u32) -> Vec<Point> {
        let mut way: Vec<Point> = std::iter::successors(Some(node), |node| self.parent(*node)).map(|node| self.point(node)).collect();
        way.reverse();
        way
    }

    /// Hangs another tree, turned round so that `at` of it becomes its root, below `parent`, which is the same place. Returns what the
    /// nodes of the other became.
    pub(crate) fn graft(&mut self, parent: u32, other: &Tree, at: u32) -> Vec<u32> {
        let mut became = vec![NONE; other.len()];
        became[at as usize] = parent;
        let mut stack = vec![at];
        while let Some(node) = stack.pop() {
            for next in other.parent(node).into_iter().chain(other.children[node as usize].iter().copied()) {
                if became[next as usize] == NONE {
                    became[next as usize] = self.add(became[node as usize], other.point(next));
                    stack.push(next);
                }
            }
        }
        became
    }

    /// How far from the root the farthest node is, metres, in a straight line.
    pub(crate) fn reach(&self) -> f64 {
        (0..self.len() as u32).map(|node| distance(self.point(0), self.point(node))).fold(0.0, f64::max)
    }

    /// All nodes and their parents' indices.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = (Point, Option<u32>)> + '_ {
        (0..self.len() as u32).map(|node| (self.point(node), self.parent(node)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Costs and children follow from the parents.
    fn check(tree: &Tree) {
        for node in 0..tree.len() as u32 {
            let way = tree.way_to(node);
            assert!((crate::points::length(&way) - tree.cost(node)).abs() < 1e-9);
            assert_eq!(way[0], tree.point(0));
            if let Some(parent) = tree.parent(node) {
                assert_eq!(tree.children[parent as usize].iter().filter(|c| **c == node).count(), 1);
            }
        }
    }

    proptest! {
        #[test]
        fn costs_follow_the_parents_through_moves_and_grafts(points in prop::collection::vec((prop::array::uniform3(-9.0..9.0f64), any::<u32>()), 2..60)) {
            let mut trees = [Tree::new([0.0; 3], 3), Tree::new([1.0; 3], 3)];
            for (i, (p, parent)) in points.iter().enumerate() {
                let tree = &mut trees[i % 2];
                tree.add(parent % tree.len() as u32, *p);
                let (node, closer) = (tree.len() as u32 - 1, parent / 7 % tree.len() as u32);
                let cheaper = tree.cost(closer) + distance(tree.point(closer), tree.point(node));
                if closer != node && cheaper < tree.cost(node) {
                    tree.move_below(node, closer);
                }
                check(tree);
            }
            let [mut tree, other] = trees;
            let meeting = tree.add(0, other.point(other.len() as u32 - 1));
            let became = tree.graft(meeting, &other, other.len() as u32 - 1);
            check(&tree);
            for (node, is) in became.iter().enumerate() {
                prop_assert_eq!(tree.point(*is), other.point(node as u32));
            }
        }
    }
}
