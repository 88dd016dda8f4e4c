//! Space that a map knows to be free, all around.

use crate::field::occupancy::State;
use crate::query::{AtlasQuery, Sphere, UnknownAs};
use rayon::prelude::*;

/// Which of `points` (map frame, metres) have nothing but known free space within a `margin`, metres, of them; `states` are those at the points. Nothing is known with a
/// margin that is infinite.
pub(super) fn are_void<T: Copy + Into<f64> + Sync>(
    map: &AtlasQuery<'_>,
    points: &[[T; 3]],
    states: &[State],
    margin: impl Fn(&[f64; 3]) -> f64 + Sync,
) -> Vec<bool> {
    let is_void = |(p, state): (&[T; 3], &State)| {
        let centre = p.map(Into::into);
        let radius = margin(&centre);
        *state == State::Free && radius.is_finite() && map.is_free(&Sphere { centre, radius }.into(), UnknownAs::Blocked)
    };
    points.par_iter().zip(states).map(is_void).collect()
}
