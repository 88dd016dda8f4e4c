//! Space that a map knows to be free, all around.

use crate::field::occupancy::State;
use crate::query::{AtlasQuery, Sphere, UnknownAs};
use rayon::prelude::*;

/// Which of `points` (map frame, metres) have nothing but known free space within `margin` metres of them; `states` are those at the points.
pub(super) fn are_void<T: Copy + Into<f64> + Sync>(map: &AtlasQuery<'_>, points: &[[T; 3]], states: &[State], margin: f64) -> Vec<bool> {
    let is_void = |(p, state): (&[T; 3], &State)| {
        let sphere = Sphere { centre: p.map(Into::into), radius: margin };
        *state == State::Free && map.is_free(&sphere.into(), UnknownAs::Blocked)
    };
    points.par_iter().zip(states).map(is_void).collect()
}
