//! Nearest neighbours in a growing set of points: a k-d tree without rebalancing.
//!
//! A search inserts a point between any two queries, so the tree has to grow; and its results must not depend on the machine, so ties are broken by
//! index.

use crate::points::Point;

const NONE: u32 = u32::MAX;

/// Points in a k-d tree. Points inserted in random order keep it about as deep as a balanced one; sorted points make it slow, not wrong.
#[derive(Clone, Debug)]
pub(crate) struct KdTree {
    points: Vec<Point>,
    children: Vec<[u32; 2]>,
    dimensions: usize,
}

/// A point found: squared distance in square metres, and index.
pub(crate) type Neighbour = (f64, u32);

impl KdTree {
    /// An empty tree; distances use the first `dimensions` coordinates.
    pub(crate) fn new(dimensions: usize) -> Self {
        Self { points: Vec::new(), children: Vec::new(), dimensions: dimensions.clamp(1, 3) }
    }

    /// The point with an index.
    pub(crate) fn point(&self, index: u32) -> Point {
        self.points[index as usize]
    }

    /// Inserts a point; its index is the number of points before.
    pub(crate) fn push(&mut self, p: Point) {
        let new = self.points.len() as u32;
        self.points.push(p);
        self.children.push([NONE; 2]);
        let (mut at, mut axis) = (0u32, 0);
        while at != new {
            let side = usize::from(p[axis] >= self.points[at as usize][axis]);
            let next = self.children[at as usize][side];
            if next == NONE {
                self.children[at as usize][side] = new;
                return;
            }
            at = next;
            axis = (axis + 1) % self.dimensions;
        }
    }

    fn squared(&self, index: u32, p: Point) -> f64 {
        let q = self.points[index as usize];
        (0..self.dimensions).map(|k| (p[k] - q[k]) * (p[k] - q[k])).sum()
    }

    /// The point nearest to `p`, of equally near ones the first; none in an empty tree.
    pub(crate) fn nearest(&self, p: Point) -> Option<Neighbour> {
        let mut best = Vec::with_capacity(2);
        self.nearest_n(p, 1, &mut best);
        best.first().copied()
    }

    /// Fills `best` with the `count` points nearest to `p`, the nearest first.
    pub(crate) fn nearest_n(&self, p: Point, count: usize, best: &mut Vec<Neighbour>) {
        best.clear();
        if !self.points.is_empty() && count > 0 {
            self.search(0, 0, p, count, best);
        }
    }

    fn search(&self, at: u32, axis: usize, p: Point, count: usize, best: &mut Vec<Neighbour>) {
        let found = (self.squared(at, p), at);
        let is_full = best.len() == count;
        if !is_full || found < best[count - 1] {
            if is_full {
                best.pop();
            }
            best.insert(best.partition_point(|b| *b < found), found);
        }
        let off = p[axis] - self.points[at as usize][axis];
        let near = usize::from(off >= 0.0);
        let next = (axis + 1) % self.dimensions;
        let [first, second] = [self.children[at as usize][near], self.children[at as usize][1 - near]];
        if first != NONE {
            self.search(first, next, p, count, best);
        }
        // Ties are broken by index, so points at the same distance on the other side have to be visited.
        if second != NONE && (best.len() < count || off * off <= best[count - 1].0) {
            self.search(second, next, p, count, best);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_a_sorted_list(
            points in prop::collection::vec(prop::array::uniform3(-4i32..4), 1..200), p in prop::array::uniform3(-5.0..5.0f64), count in 1usize..20, dimensions in 2usize..=3,
        ) {
            let mut tree = KdTree::new(dimensions);
            points.iter().for_each(|c| tree.push(c.map(f64::from)));
            let mut all: Vec<Neighbour> = (0..points.len() as u32).map(|i| (tree.squared(i, p), i)).collect();
            all.sort_by(|a, b| a.partial_cmp(b).unwrap());
            all.truncate(count);
            let mut found = Vec::new();
            tree.nearest_n(p, count, &mut found);
            prop_assert_eq!(&found, &all);
            prop_assert_eq!(tree.nearest(p), all.first().copied());
        }
    }
}
