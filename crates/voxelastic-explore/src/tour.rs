//! The order in which places are visited.

/// An order of places that gathers much soon: the sum of what the places are worth, discounted by the time of arrival, is as large as insertion and reversals make it.
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
    let mut tour: Vec<usize> = Vec::new();
    let mut by_worth: Vec<usize> = (0..worth.len()).collect();
    by_worth.sort_by(|a, b| (worth[*b] / (first[*b] + 1.0)).total_cmp(&(worth[*a] / (first[*a] + 1.0))).then(a.cmp(b)));
    for place in by_worth {
        let inserted = (0..=tour.len()).map(|at| {
            let mut tour = tour.clone();
            tour.insert(at, place);
            tour
        });
        tour = inserted.reduce(|best, next| if value(&next) > value(&best) { next } else { best }).unwrap_or_default();
    }
    loop {
        let now = value(&tour);
        let pairs = (0..tour.len()).flat_map(|i| (i + 1..tour.len()).map(move |j| (i, j)));
        let reversed = pairs.map(|(i, j)| {
            let mut tour = tour.clone();
            tour[i..=j].reverse();
            tour
        });
        match reversed.reduce(|best, next| if value(&next) > value(&best) { next } else { best }).filter(|best| value(best) > now + 1e-9) {
            Some(better) => tour = better,
            None => return tour,
        }
    }
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
