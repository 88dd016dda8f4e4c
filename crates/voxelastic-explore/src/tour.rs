//! The order in which places are visited.

/// An order of places that gathers much soon: the sum of what the places are worth, discounted by the time of arrival, is as large as insertion, moves of single places and reversals make it.
/// `first[i]` is the time from the robot to place i, `between[i][j]` that from i to j, seconds; `horizon` is the time in which worth falls to a third.
pub(crate) fn order(worth: &[f64], first: &[f64], between: &[Vec<f64>], horizon: f64) -> Vec<usize> {
    let value = |order: &[usize]| {
        let (mut time, mut total, mut last) = (0.0, 0.0, None);
        for &place in order {
            time += last.map_or(first[place], |last: usize| between[last][place]);
            total += worth[place] * (-time / horizon).exp();
            last = Some(place);
        }
        total
    };
    let better = |best: Vec<usize>, next: Vec<usize>| if value(&next) > value(&best) { next } else { best };
    let mut by_worth: Vec<usize> = (0..worth.len()).collect();
    by_worth.sort_by(|a, b| (worth[*b] / (first[*b] + 1.0)).total_cmp(&(worth[*a] / (first[*a] + 1.0))).then(a.cmp(b)));
    // What cannot be improved by small changes may still be poor, so that the search begins once with each place in front.
    let begun = |first: usize| {
        by_worth.iter().filter(|place| **place != first).fold(vec![first], |tour, place| {
            let inserted = (1..=tour.len()).map(|at| {
                let mut tour = tour.clone();
                tour.insert(at, *place);
                tour
            });
            inserted.reduce(better).unwrap_or_default()
        })
    };
    let improved = |mut tour: Vec<usize>| loop {
        match changed(&tour).into_iter().reduce(better).filter(|best| value(best) > value(&tour) + 1e-9) {
            Some(best) => tour = best,
            None => return tour,
        }
    };
    by_worth.iter().map(|first| improved(begun(*first))).reduce(better).unwrap_or_default()
}

/// All orders that differ from one by the place of one element, or by a part that is turned round.
fn changed(tour: &[usize]) -> Vec<Vec<usize>> {
    let pairs = || (0..tour.len()).flat_map(|i| (0..tour.len()).map(move |j| (i, j)));
    let reversed = pairs().filter(|(i, j)| i < j).map(|(i, j)| {
        let mut tour = tour.to_vec();
        tour[i..=j].reverse();
        tour
    });
    let moved = pairs().filter(|(i, j)| i != j).map(|(i, j)| {
        let mut tour = tour.to_vec();
        let place = tour.remove(i);
        tour.insert(j, place);
        tour
    });
    reversed.chain(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// All orders of `n` places.
    fn orders(n: usize) -> Vec<Vec<usize>> {
        if n == 0 {
            return vec![vec![]];
        }
        orders(n - 1)
            .into_iter()
            .flat_map(|order| {
                (0..n).map(move |at| {
                    let mut order = order.clone();
                    order.insert(at, n - 1);
                    order
                })
            })
            .collect()
    }

    proptest! {
        #[test]
        fn a_tour_is_nearly_the_best_of_all(places in prop::collection::vec((0.0f64..50.0, 0.0f64..50.0, 1.0f64..100.0), 1..6)) {
            let off = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).hypot(a.1 - b.1);
            let at: Vec<(f64, f64)> = places.iter().map(|p| (p.0, p.1)).collect();
            let worth: Vec<f64> = places.iter().map(|p| p.2).collect();
            let first: Vec<f64> = at.iter().map(|p| off((0.0, 0.0), *p)).collect();
            let between: Vec<Vec<f64>> = at.iter().map(|a| at.iter().map(|b| off(*a, *b)).collect()).collect();
            let value = |order: &[usize]| {
                let (mut time, mut total) = (0.0, 0.0);
                for (k, &i) in order.iter().enumerate() {
                    time += if k == 0 { first[i] } else { between[order[k - 1]][i] };
                    total += worth[i] * (-time / 40.0).exp();
                }
                total
            };
            let tour = order(&worth, &first, &between, 40.0);
            let mut sorted = tour.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..places.len()).collect::<Vec<_>>(), "every place once");
            let best = orders(places.len()).iter().map(|order| value(order)).fold(0.0, f64::max);
            prop_assert!(value(&tour) > 0.93 * best, "{} of {}", value(&tour), best);
        }
    }
}
