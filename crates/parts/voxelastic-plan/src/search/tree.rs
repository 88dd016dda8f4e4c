//! A tree of states, with the cost of the path to each.

use crate::points::{Point, distance};
use crate::search::kd_tree::{KdTree, Neighbour};

const NONE: u32 = u32::MAX;

/// States; each but the root is reached from its parent by a straight motion.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    states: KdTree,
    parents: Vec<u32>,
    children: Vec<Vec<u32>>,
    /// Length of the path from the root, metres.
    costs: Vec<f64>,
}

impl Tree {
    /// A tree with only a root; distances use the first `dimensions` coordinates.
    pub(crate) fn new(root: Point, dimensions: usize) -> Self {
        let mut states = KdTree::new(dimensions);
        states.push(root);
        Self { states, parents: vec![NONE], children: vec![Vec::new()], costs: vec![0.0] }
    }

    /// Number of nodes.
    pub(crate) fn len(&self) -> usize {
        self.parents.len()
    }

    /// The state of a node.
    pub(crate) fn point(&self, node: u32) -> Point {
        self.states.point(node)
    }

    /// Length of the path from the root to a node, metres.
    pub(crate) fn cost(&self, node: u32) -> f64 {
        self.costs[node as usize]
    }

    /// Parent of a node; none for the root.
    pub(crate) fn parent(&self, node: u32) -> Option<u32> {
        Some(self.parents[node as usize]).filter(|p| *p != NONE)
    }

    /// Adds a child and returns its index.
    pub(crate) fn add(&mut self, parent: u32, p: Point) -> u32 {
        let node = self.len() as u32;
        self.costs.push(self.cost(parent) + distance(self.point(parent), p));
        self.states.push(p);
        self.parents.push(parent);
        self.children.push(Vec::new());
        self.children[parent as usize].push(node);
        node
    }

    /// The node nearest to `p`.
    pub(crate) fn nearest(&self, p: Point) -> u32 {
        self.states.nearest(p).map_or(0, |neighbour| neighbour.1)
    }

    /// Fills `nearest` with the `count` nodes nearest to `p`, the nearest first.
    pub(crate) fn nearest_n(&self, p: Point, count: usize, nearest: &mut Vec<Neighbour>) {
        self.states.nearest_n(p, count, nearest);
    }

    /// Gives `node` another parent and updates the costs of its subtree. The parent must not be a descendant of the node; one that lowers the node's
    /// cost never is.
    pub(crate) fn reparent(&mut self, node: u32, parent: u32) {
        let before = self.parents[node as usize];
        if before != NONE {
            self.children[before as usize].retain(|child| *child != node);
        }
        self.parents[node as usize] = parent;
        self.children[parent as usize].push(node);
        self.update_costs(node);
    }

    /// Recomputes the costs of a node and its descendants from its parent's.
    fn update_costs(&mut self, node: u32) {
        let mut stack = vec![node];
        while let Some(node) = stack.pop() {
            if let Some(parent) = self.parent(node) {
                self.costs[node as usize] = self.cost(parent) + distance(self.point(parent), self.point(node));
            }
            stack.extend_from_slice(&self.children[node as usize]);
        }
    }

    /// The states from the root to `node`.
    pub(crate) fn path_to(&self, node: u32) -> Vec<Point> {
        let mut path: Vec<Point> = std::iter::successors(Some(node), |node| self.parent(*node)).map(|node| self.point(node)).collect();
        path.reverse();
        path
    }

    /// Adds the nodes of another tree, re-rooted at its node `at`, which is the same state as `parent` of this one. Returns the new index of each node
    /// of the other tree.
    pub(crate) fn graft(&mut self, parent: u32, other: &Tree, at: u32) -> Vec<u32> {
        let mut index = vec![NONE; other.len()];
        index[at as usize] = parent;
        let mut stack = vec![at];
        while let Some(node) = stack.pop() {
            for next in other.parent(node).into_iter().chain(other.children[node as usize].iter().copied()) {
                if index[next as usize] == NONE {
                    index[next as usize] = self.add(index[node as usize], other.point(next));
                    stack.push(next);
                }
            }
        }
        index
    }

    /// Straight distance from the root to the farthest node, metres.
    pub(crate) fn extent(&self) -> f64 {
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
            let path = tree.path_to(node);
            assert!((crate::points::length(&path) - tree.cost(node)).abs() < 1e-9);
            assert_eq!(path[0], tree.point(0));
            if let Some(parent) = tree.parent(node) {
                assert_eq!(tree.children[parent as usize].iter().filter(|c| **c == node).count(), 1);
            }
        }
    }

    proptest! {
        #[test]
        fn costs_match_paths_after_reparenting_and_grafting(points in prop::collection::vec((prop::array::uniform3(-9.0..9.0f64), any::<u32>()), 2..60)) {
            let mut trees = [Tree::new([0.0; 3], 3), Tree::new([1.0; 3], 3)];
            for (i, (p, parent)) in points.iter().enumerate() {
                let tree = &mut trees[i % 2];
                tree.add(parent % tree.len() as u32, *p);
                let (node, closer) = (tree.len() as u32 - 1, parent / 7 % tree.len() as u32);
                let cheaper = tree.cost(closer) + distance(tree.point(closer), tree.point(node));
                if closer != node && cheaper < tree.cost(node) {
                    tree.reparent(node, closer);
                }
                check(tree);
            }
            let [mut tree, other] = trees;
            let meeting = tree.add(0, other.point(other.len() as u32 - 1));
            let index = tree.graft(meeting, &other, other.len() as u32 - 1);
            check(&tree);
            for (node, new) in index.iter().enumerate() {
                prop_assert_eq!(tree.point(*new), other.point(node as u32));
            }
        }
    }
}
