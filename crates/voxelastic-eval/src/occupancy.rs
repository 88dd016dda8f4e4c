//! Free, occupied, unknown: how often a map is right, against a world whose distance function is known.

use rayon::prelude::*;
use serde::Serialize;

/// What a map says about a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Nothing is there.
    Free,
    /// Something is there.
    Occupied,
    /// Never observed.
    Unknown,
}

/// How often one state is said rightly.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Points at which the map says so.
    pub said: usize,
    /// Points at which it is so.
    pub is: usize,
    /// Points at which the map says so and it is so.
    pub both: usize,
    /// Share of what is said that is right; `None` when nothing is said.
    pub precision: Option<f64>,
    /// Share of what is so that is said; `None` when nothing is so.
    pub recall: Option<f64>,
}

/// Result of [`score`], with stable JSON keys.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OccupancyScores {
    /// Points judged: finite ones that are not within the margin of a surface on its free side.
    pub points: usize,
    /// Of these, how many the map does not know.
    pub unknown: usize,
    /// How well free space is known. The precision is what keeps a robot whole.
    pub free: Score,
    /// How well what is occupied is known.
    pub occupied: Score,
    /// Points that the map calls free inside of something, deeper than the margin: the dangerous ones.
    pub deep_false_free: usize,
}

/// Judges a map at `points` (metres, of space that the sensor could see: along beams, and on surfaces).
///
/// `distance` is the world's signed distance, negative inside. At or inside a surface (`distance <= 0`) a point is occupied; farther than `margin`
/// (metres; about a voxel) outside it is free; between the two a voxel may be called either, and the point is not judged.
pub fn score<M, W>(points: &[[f32; 3]], map: M, distance: W, margin: f32) -> OccupancyScores
where
    M: Fn([f32; 3]) -> State + Sync,
    W: Fn([f32; 3]) -> f32 + Sync,
{
    let judge = |p: &[f32; 3]| {
        let d = if p.iter().all(|c| c.is_finite()) { distance(*p) } else { f32::NAN };
        if d.is_nan() || (d > 0.0 && d <= margin) { None } else { Some((map(*p), d)) }
    };
    let judged: Vec<(State, f32)> = points.par_iter().filter_map(judge).collect();
    let count = |f: &dyn Fn(State, f32) -> bool| judged.iter().filter(|(s, d)| f(*s, *d)).count();
    let score = |state: State, inside: bool| {
        let (said, is) = (count(&|s, _| s == state), count(&|_, d| (d <= 0.0) == inside));
        let both = count(&|s, d| s == state && (d <= 0.0) == inside);
        let share = |of: usize| (of > 0).then(|| both as f64 / of as f64);
        Score { said, is, both, precision: share(said), recall: share(is) }
    };
    OccupancyScores {
        points: judged.len(),
        unknown: count(&|s, _| s == State::Unknown),
        free: score(State::Free, false),
        occupied: score(State::Occupied, true),
        deep_false_free: count(&|s, d| s == State::Free && d < -margin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_mistakes_are_counted() {
        // The world is solid below z = 0; the map has the floor 0.25 m too low, and knows nothing beyond x = 5.
        let world = |p: [f32; 3]| p[2];
        let map = |p: [f32; 3]| match p {
            [x, ..] if x > 5.0 => State::Unknown,
            [_, _, z] if z <= -0.25 => State::Occupied,
            _ => State::Free,
        };
        let column = |x: f32| [-0.5, -0.2, 0.05, 0.5].map(|z| [x, 0.0, z]);
        let points: Vec<[f32; 3]> = [1.0, 9.0].into_iter().flat_map(column).chain([[f32::NAN; 3]]).collect();
        let s = score(&points, map, world, 0.1);
        assert_eq!((s.points, s.unknown, s.deep_false_free), (6, 3, 1));
        assert_eq!((s.free.precision, s.free.recall), (Some(0.5), Some(0.5)));
        assert_eq!((s.occupied.precision, s.occupied.recall), (Some(1.0), Some(0.25)));
        let nothing = score(&[], map, world, 0.1);
        assert_eq!((nothing.free.precision, nothing.occupied.recall), (None, None));
    }
}
