//! A column of voxels, and the rule by which a band of it becomes a cell of a 2-D map.

use voxelastic::field::occupancy::State;

/// A part of a column with one state, metres in the map frame. What is in no span is unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
    /// Occupied, or else free.
    pub occupied: bool,
}

/// Ends that are as near as this touch, metres.
const TOUCH: f64 = 1e-6;

/// The state of a column between two heights: occupied if anything in it is, free only where all of it is known to be free, else unknown. What is below `seen_through` counts as
/// free unless it is occupied.
///
/// `spans` are sorted by height and do not overlap. This is the rule of every 2-D map that is made of a map, exported or published.
pub fn band(spans: impl Iterator<Item = Span>, [from, to]: [f64; 2], seen_through: f64) -> State {
    let mut free_to = from.max(seen_through);
    for span in spans.filter(|span| span.high > from + TOUCH && span.low < to - TOUCH) {
        if span.occupied {
            return State::Occupied;
        }
        if span.low <= free_to + TOUCH {
            free_to = free_to.max(span.high);
        }
    }
    if free_to >= to - TOUCH { State::Free } else { State::Unknown }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against a walk through the column voxel by voxel.
        #[test]
        fn a_band_is_what_its_voxels_are(states in prop::collection::vec(0..3u8, 0..20), from in 0..20usize, count in 1..10usize, seen in 0..4usize) {
            let spans = states.chunk_by(|a, b| a == b).scan(0usize, |low, run| {
                let start = *low;
                *low += run.len();
                Some((run[0], start as f64 * 0.1, *low as f64 * 0.1))
            });
            let spans: Vec<Span> = spans.filter(|(s, ..)| *s > 0).map(|(s, low, high)| Span { low, high, occupied: s == 2 }).collect();
            let state = |k: usize| states.get(k).copied().unwrap_or(0);
            let voxels: Vec<u8> = (from..from + count).map(|k| if k < from + seen { state(k).max(1) } else { state(k) }).collect();
            let expected = if voxels.contains(&2) {
                State::Occupied
            } else if voxels.contains(&0) {
                State::Unknown
            } else {
                State::Free
            };
            prop_assert_eq!(band(spans.into_iter(), [from as f64 * 0.1, (from + count) as f64 * 0.1], (from + seen) as f64 * 0.1), expected);
        }
    }
}
