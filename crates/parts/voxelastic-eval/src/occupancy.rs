//! Evaluation of occupancy: precision and recall of free and occupied space against a world with a known distance function.

use rayon::prelude::*;
use serde::Serialize;
use voxelastic::field::occupancy::State;

/// Precision and recall of one state.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Points with this state in the map.
    #[serde(rename = "said")]
    pub predicted: usize,
    /// Points with this state in the world.
    #[serde(rename = "is")]
    pub actual: usize,
    /// Points with this state in both.
    #[serde(rename = "both")]
    pub correct: usize,
    /// `correct` over `predicted`; `None` when nothing is predicted.
    pub precision: Option<f64>,
    /// `correct` over `actual`; `None` when nothing is actual.
    pub recall: Option<f64>,
}

/// Result of [`score`], with stable JSON keys.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OccupancyScores {
    /// Points evaluated: finite ones, except those within the margin outside of a surface.
    pub points: usize,
    /// Of these, points that are unknown in the map.
    pub unknown: usize,
    /// Free space. Its precision matters for the safety of a robot.
    pub free: Score,
    /// Occupied space.
    pub occupied: Score,
    /// Points that are free in the map but inside of a solid, deeper than the margin: dangerous errors.
    pub deep_false_free: usize,
}

/// Evaluates a map at `points` (metres, in space that the sensor could see: along beams, and on surfaces).
///
/// `distance` is the world's signed distance, negative inside. At or inside a surface (`distance <= 0`) a point is occupied; farther than `margin`
/// (metres; about a voxel) outside it is free; points in between are not evaluated, since a voxel there may be either.
pub fn score<M, W>(points: &[[f32; 3]], map: M, distance: W, margin: f32) -> OccupancyScores
where
    M: Fn([f32; 3]) -> State + Sync,
    W: Fn([f32; 3]) -> f32 + Sync,
{
    let evaluate = |p: &[f32; 3]| {
        let d = if p.iter().all(|c| c.is_finite()) { distance(*p) } else { f32::NAN };
        if d.is_nan() || (d > 0.0 && d <= margin) { None } else { Some((map(*p), d)) }
    };
    let evaluated: Vec<(State, f32)> = points.par_iter().filter_map(evaluate).collect();
    let count = |f: &dyn Fn(State, f32) -> bool| evaluated.iter().filter(|(s, d)| f(*s, *d)).count();
    let score = |state: State, inside: bool| {
        let (predicted, actual) = (count(&|s, _| s == state), count(&|_, d| (d <= 0.0) == inside));
        let correct = count(&|s, d| s == state && (d <= 0.0) == inside);
        let share = |of: usize| (of > 0).then(|| correct as f64 / of as f64);
        Score { predicted, actual, correct, precision: share(predicted), recall: share(actual) }
    };
    OccupancyScores {
        points: evaluated.len(),
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
    fn known_errors_are_counted() {
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
