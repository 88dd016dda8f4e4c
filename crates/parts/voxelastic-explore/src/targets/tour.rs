//! Stops on the way to a place: what is beside the way now is far from it later.

/// Lengths of ways between stops, metres; the place that the tour leads to comes last.
pub(crate) struct Lengths {
    /// From the start to each.
    pub first: Vec<f64>,
    /// From each stop to each.
    pub between: Vec<Vec<f64>>,
}

impl Lengths {
    /// The place that the tour leads to.
    fn target(&self) -> usize {
        self.first.len() - 1
    }

    /// Length of the tour from the start over the stops, in order, to its target.
    fn of(&self, stops: &[usize]) -> f64 {
        let legs: f64 = stops.windows(2).map(|leg| self.between[leg[0]][leg[1]]).sum();
        match (stops.first(), stops.last()) {
            (Some(first), Some(last)) => self.first[*first] + legs + self.between[*last][self.target()],
            _ => self.first[self.target()],
        }
    }

    /// The tour with one more stop where that makes it least longer, and by how much.
    fn with(&self, stops: &[usize], stop: usize) -> (Vec<usize>, f64) {
        let inserted = (0..=stops.len()).map(|at| [&stops[..at], &[stop], &stops[at..]].concat());
        let longer = inserted.map(|tour| (self.of(&tour) - self.of(stops), tour));
        longer.min_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(|| (stops.to_vec(), f64::INFINITY), |(detour, tour)| (tour, detour))
    }
}

/// The stops that are worth it, in order: each makes the tour longer by at most `most[stop]` metres where it is inserted. Those first in `most` are tried first.
pub(crate) fn stops(lengths: &Lengths, most: &[f64]) -> Vec<usize> {
    (0..most.len()).fold(Vec::new(), |tour, stop| match lengths.with(&tour, stop) {
        (longer, detour) if detour <= most[stop] => longer,
        _ => tour,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Straight ways between places in the plane; the last is the target.
    fn straight(start: [f64; 2], places: &[[f64; 2]]) -> Lengths {
        let off = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let from = |a: [f64; 2]| places.iter().map(|b| off(a, *b)).collect::<Vec<f64>>();
        Lengths { first: from(start), between: places[..places.len() - 1].iter().map(|a| from(*a)).collect() }
    }

    #[test]
    fn what_is_beside_the_way_is_visited_before_the_target_and_nothing_else() {
        let places = [[8.0, 1.0], [3.0, -1.0], [5.0, 9.0], [-6.0, 0.0], [10.0, 0.0]];
        assert_eq!(stops(&straight([0.0, 0.0], &places), &[3.0; 4]), [1, 0], "in the order of the way");
        assert_eq!(stops(&straight([0.0, 0.0], &places), &[3.0, 0.1, 3.0, 3.0]), [0], "shows too little");
        assert_eq!(stops(&straight([0.0, 0.0], &places), &[3.0, 3.0, 3.0, 12.5]), [3, 1, 0], "shows enough for a way back");
        assert_eq!(stops(&straight([0.0, 0.0], &places[4..]), &[]), [0; 0]);
        let mut unreachable = straight([0.0, 0.0], &places);
        (unreachable.first[1], unreachable.between[0][1], unreachable.between[1]) = (f64::INFINITY, f64::INFINITY, vec![f64::INFINITY; 5]);
        assert_eq!(stops(&unreachable, &[3.0; 4]), [0]);
    }

    proptest! {
        #[test]
        fn no_order_of_the_stops_is_much_shorter_and_none_is_twice(
            places in prop::collection::vec(prop::array::uniform2(0.0f64..50.0), 1..6),
            most in prop::collection::vec(0.0f64..30.0, 5),
        ) {
            let lengths = straight([0.0, 0.0], &places);
            let most = &most[..places.len() - 1];
            let tour = stops(&lengths, most);
            let mut sorted = tour.clone();
            sorted.sort_unstable();
            sorted.dedup();
            prop_assert_eq!(sorted.len(), tour.len());
            let allowed: f64 = tour.iter().map(|stop| most[*stop]).sum();
            prop_assert!(lengths.of(&tour) <= lengths.first[places.len() - 1] + allowed + 1e-9);
            let best = orders(&sorted).iter().map(|order| lengths.of(order)).fold(f64::INFINITY, f64::min);
            prop_assert!(lengths.of(&tour) <= 1.5 * best, "{} of {}", lengths.of(&tour), best);
        }
    }

    /// All orders of some stops.
    fn orders(stops: &[usize]) -> Vec<Vec<usize>> {
        let Some((last, others)) = stops.split_last() else { return vec![vec![]] };
        let insert = |order: Vec<usize>| (0..=order.len()).map(move |at| [&order[..at], &[*last], &order[at..]].concat());
        orders(others).into_iter().flat_map(insert).collect()
    }
}
