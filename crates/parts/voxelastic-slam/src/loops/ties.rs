//! What ties places together: the path between them, and the closures that were found.
//!
//! A loop that is closed is known again: what a later closure may claim is counted from the nearest tie, not along the whole path.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use voxelastic::geometry::Pose;

/// The ties of all places, by their numbers.
#[derive(Debug, Default)]
pub(super) struct Ties {
    of: Vec<Vec<Tie>>,
}

/// A place that is tied to another, and how.
#[derive(Clone, Debug)]
struct Tie {
    to: usize,
    /// Pose of the other place in the frame of this one.
    t_this_other: Pose,
    metres: f64,
}

impl Ties {
    /// Ties two places: the pose of `second` in the frame of `first`, over so many metres of path.
    pub(super) fn add(&mut self, first: usize, second: usize, t_first_second: &Pose, metres: f64) {
        let places = self.of.len().max(first.max(second) + 1);
        self.of.resize(places, Vec::new());
        self.of[first].push(Tie { to: second, t_this_other: *t_first_second, metres });
        self.of[second].push(Tie { to: first, t_this_other: t_first_second.inverse(), metres });
    }

    /// Of each place, along the shortest way of ties, its pose in the frame of `from` and the metres; none if it is not tied to it.
    pub(super) fn from(&self, from: usize) -> Vec<Option<(Pose, f64)>> {
        let mut found: Vec<Option<(Pose, f64)>> = vec![None; self.of.len().max(from + 1)];
        let mut done = vec![false; found.len()];
        found[from] = Some((Pose::identity(), 0.0));
        // Lengths are not negative, so their bits are in their order.
        let mut due = BinaryHeap::from([Reverse((0u64, from))]);
        while let Some(Reverse((_, place))) = due.pop() {
            if std::mem::replace(&mut done[place], true) {
                continue;
            }
            let Some((t_from_place, metres)) = found[place] else { continue };
            for tie in self.of.get(place).into_iter().flatten() {
                let there = metres + tie.metres;
                if found[tie.to].is_none_or(|(_, known)| there < known) {
                    found[tie.to] = Some((t_from_place * tie.t_this_other, there));
                    due.push(Reverse((there.to_bits(), tie.to)));
                }
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closure_shortens_the_way() {
        let mut ties = Ties::default();
        let step = Pose::translation(10.0, 0.0, 0.0);
        (0..5).for_each(|k| ties.add(k, k + 1, &step, 10.0));
        let far = ties.from(5)[0].unwrap();
        assert_eq!((far.0.translation.x, far.1), (-50.0, 50.0));
        // The last place is beside the second.
        ties.add(1, 5, &Pose::translation(1.0, 0.0, 0.0), 2.0);
        let near = ties.from(5)[0].unwrap();
        assert_eq!((near.0.translation.x, near.1), (-11.0, 12.0));
        assert!(ties.from(7)[0].is_none());
    }
}
