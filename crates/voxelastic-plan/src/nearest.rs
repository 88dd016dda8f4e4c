//! The nearest of a growing set of points: a k-d tree that points are hung into as they come.

use crate::points::Point;

const NONE: u32 = u32::MAX;

/// Points by place. Those of random trees come in random order, which keeps the tree about as deep as a balanced one; sorted
/// ones make it slow, never wrong.
#[derive(Clone, Debug)]
pub(crate) struct Nearest {
    points: Vec<Point>,
    below: Vec<[u32; 2]>,
    dimensions: usize,
}

/// A point found: squared distance, index.
pub(crate) type Found = (f64, u32);

impl Nearest {
    /// An empty set; distances take the first `dimensions` coordinates.
    pub(crate) fn new(dimensions: usize) -> Self {
        Self { points: Vec::new(), below: Vec::new(), dimensions: dimensions.clamp(1, 3) }
    }

    pub(crate) fn point(&self, index: u32) -> Point {
        self.points[index as usize]
    }

    pub(crate) fn push(&mut self, p: Point) {
        let new = self.points.len() as u32;
        self.points.push(p);
        self.below.push([NONE; 2]);
        let (mut at, mut axis) = (0u32, 0);
        while at != new {
            let side = usize::from(p[axis] >= self.points[at as usize][axis]);
            let next = self.below[at as usize][side];
            if next == NONE {
                self.below[at as usize][side] = new;
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

    /// The point nearest to `p`; the first of equals. None in an empty set.
    pub(crate) fn nearest(&self, p: Point) -> Option<Found> {
        let mut best = Vec::with_capacity(2);
        self.several(p, 1, &mut best);
        best.first().copied()
    }

    /// Fills `best` with the `count` points nearest to `p`, the nearest first.
    pub(crate) fn several(&self, p: Point, count: usize, best: &mut Vec<Found>) {
        best.clear();
        if !self.points.is_empty() && count > 0 {
            self.look(0, 0, p, count, best);
        }
    }

    fn look(&self, at: u32, axis: usize, p: Point, count: usize, best: &mut Vec<Found>) {
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
        let [first, second] = [self.below[at as usize][near], self.below[at as usize][1 - near]];
        if first != NONE {
            self.look(first, next, p, count, best);
        }
        // Equal distances count by index, so that the other side is looked at for them, too.
        if second != NONE && (best.len() < count || off * off <= best[count - 1].0) {
            self.look(second, next, p, count, best);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_are_those_of_a_sorted_list(
            points in prop::collection::vec(prop::array::uniform3(-4i32..4), 1..200), p in prop::array::uniform3(-5.0..5.0f64), count in 1usize..20, dimensions in 2usize..=3,
        ) {
            let mut tree = Nearest::new(dimensions);
            points.iter().for_each(|c| tree.push(c.map(f64::from)));
            let mut all: Vec<Found> = (0..points.len() as u32).map(|i| (tree.squared(i, p), i)).collect();
            all.sort_by(|a, b| a.partial_cmp(b).unwrap());
            all.truncate(count);
            let mut found = Vec::new();
            tree.several(p, count, &mut found);
            prop_assert_eq!(&found, &all);
            prop_assert_eq!(tree.nearest(p), all.first().copied());
        }
    }
}
