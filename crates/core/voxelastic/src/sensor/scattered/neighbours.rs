//! The nearest neighbours of every return.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Neighbours of a return, itself included. Fewer make planes uncertain, more smooth over edges.
pub(super) const NEIGHBOURS: usize = 13;

/// Returns of one task.
const CHUNK: usize = 256;

/// The nearest neighbours of each point, nearest first: itself, as a rule.
#[derive(Clone, Debug, Default)]
pub(super) struct Neighbours {
    /// [`NEIGHBOURS`] for each point, or as many as there are points.
    all: Vec<u32>,
    each: usize,
    /// Distance to the farthest of them, metres.
    pub(super) reach: Vec<f32>,
}

impl Neighbours {
    /// Finds the neighbours of all `points`, which must be finite.
    pub(super) fn find(&mut self, points: &[[f32; 3]]) {
        self.each = NEIGHBOURS.min(points.len());
        self.all.clear();
        self.reach.clear();
        let Some(each) = NonZero::new(self.each) else { return };
        // The tree cannot hold more points that coincide than fit a leaf; such a cloud has no planes either.
        let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(points) else {
            self.each = 0;
            return;
        };
        self.all.resize(points.len() * self.each, 0);
        self.reach.resize(points.len(), 0.0);
        let outputs = self.all.par_chunks_mut(CHUNK * self.each).zip(self.reach.par_chunks_mut(CHUNK));
        outputs.zip(points.par_chunks(CHUNK)).for_each(|((all, reach), points)| {
            for ((all, reach), point) in all.chunks_exact_mut(each.get()).zip(reach).zip(points) {
                let mut found: Vec<(f32, u32)> =
                    tree.query(point).nearest_n::<SquaredEuclidean<f32>>(each).execute().into_iter().map(|n| (n.distance, n.item)).collect();
                // Equal distances in the order of the points.
                found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                all.iter_mut().zip(&found).for_each(|(to, from)| *to = from.1);
                *reach = found.last().map_or(0.0, |last| last.0.sqrt());
            }
        });
    }

    /// The neighbours of point `i`; none if there are too few points.
    pub(super) fn of(&self, i: usize) -> &[u32] {
        self.all.get(i * self.each..(i + 1) * self.each).unwrap_or(&[])
    }

    /// The neighbours of the neighbours of point `i`, themselves included, each once, in the order of the points.
    pub(super) fn of_neighbours(&self, i: usize) -> Vec<u32> {
        let mut all: Vec<u32> = self.of(i).iter().flat_map(|&j| self.of(j as usize)).copied().collect();
        all.sort_unstable();
        all.dedup();
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn they_are_those_of_a_search_through_all(points in prop::collection::vec(prop::array::uniform3(-20f32..20.0), 1..200)) {
            let mut neighbours = Neighbours::default();
            neighbours.find(&points);
            for (i, p) in points.iter().enumerate() {
                let square = |q: &[f32; 3]| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>();
                let mut all: Vec<f32> = points.iter().map(square).collect();
                all.sort_by(f32::total_cmp);
                let found: Vec<f32> = neighbours.of(i).iter().map(|&j| square(&points[j as usize])).collect();
                prop_assert_eq!(found.len(), NEIGHBOURS.min(points.len()));
                prop_assert!(found.iter().zip(&all).all(|(a, b)| (a - b).abs() <= 1e-4 * b.max(1.0)), "{found:?} are not {all:?}");
            }
        }
    }
}
