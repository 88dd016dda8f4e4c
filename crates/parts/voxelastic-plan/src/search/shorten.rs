//! Shortens and smooths a path: removes points that a free motion can skip, pulls points towards the straight line, and cuts corners.
//!
//! Every change is checked against the space and made only if it shortens the path.

use crate::points::{Point, between, distance, length, turn};
use crate::space::Space;

/// When to stop shortening.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// When a round gains less than 1 %: for use within a search.
    Quick,
    /// When a round gains less than 0.02 %: for the final path.
    Thorough,
}

impl Effort {
    /// Least gain of a round, as a share of the length, and most rounds.
    fn limits(self) -> (f64, usize) {
        match self {
            Self::Quick => (0.01, 8),
            Self::Thorough => (2e-4, 40),
        }
    }
}

/// Moves of less than this are not tried, metres.
const MIN_GAIN: f64 = 1e-3;
/// Turns sharper than this are always cut, degrees.
const SHARP_TURN: f64 = 15.0;
/// Longer segments are divided before their points are pulled, metres, so that they can bend around obstacles.
const MAX_SEGMENT: f64 = 3.0;

/// A free path between the same endpoints, no longer than `path`, which must be free.
///
/// The result is a local optimum up to small gains: the side on which an obstacle is passed changes only where a straight motion leads to the other.
pub fn shorten<S: Space>(space: &S, path: Vec<Point>, effort: Effort) -> Vec<Point> {
    let (least, rounds) = effort.limits();
    let mut path = skip_points(space, path);
    for _ in 0..rounds {
        let before = length(&path);
        path = pull_tight(space, subdivide(space, path));
        path = cut_corners(space, path);
        path = skip_points(space, path);
        if before - length(&path) < least * before {
            break;
        }
    }
    path
}

/// Removes points that a free motion can skip: from each point it goes to the farthest one that doubling steps find.
fn skip_points<S: Space>(space: &S, path: Vec<Point>) -> Vec<Point> {
    let mut kept = Vec::with_capacity(path.len());
    let mut at = 0;
    while let Some(&from) = path.get(at) {
        kept.push(from);
        let can_reach = |to: usize| path.get(to).is_some_and(|p| space.connects(from, *p));
        let mut next = at + 1;
        let mut step = 1;
        // The step doubles on success and halves on failure.
        while step > 0 && next + 1 < path.len() {
            let to = (next + step).min(path.len() - 1);
            if to > next && can_reach(to) {
                next = to;
                step *= 2;
            } else {
                step /= 2;
            }
        }
        at = next;
    }
    kept
}

/// Divides long segments.
fn subdivide<S: Space>(space: &S, path: Vec<Point>) -> Vec<Point> {
    let mut fine = Vec::with_capacity(2 * path.len());
    for w in path.windows(2) {
        fine.push(w[0]);
        let parts = (distance(w[0], w[1]) / MAX_SEGMENT).ceil() as usize;
        let mut last = w[0];
        for k in 1..parts {
            // On the ground the new point lies on the floor; if it cannot be reached, the rest of the segment stays undivided.
            let Some(p) = space.steer(last, between(w[0], w[1], k as f64 / parts as f64)) else { break };
            fine.push(p);
            last = p;
        }
    }
    fine.extend(path.last());
    if_free(space, fine, &path)
}

/// `changed` if all of it is free, else `before`: on the ground a motion depends on where it starts.
fn if_free<S: Space>(space: &S, changed: Vec<Point>, before: &[Point]) -> Vec<Point> {
    let is_free = space.dimensions() == 3 || changed.windows(2).all(|w| space.connects(w[0], w[1]));
    if is_free { changed } else { before.to_vec() }
}

/// Moves each inner point towards the straight line between its neighbours, as far as that is free.
fn pull_tight<S: Space>(space: &S, mut path: Vec<Point>) -> Vec<Point> {
    for i in 1..path.len().saturating_sub(1) {
        let (a, p, b) = (path[i - 1], path[i], path[i + 1]);
        let (to_a, to_b) = (distance(a, p), distance(p, b));
        let middle = between(a, b, to_a / (to_a + to_b).max(1e-9));
        let mut share = 1.0;
        while share * distance(p, middle) > MIN_GAIN {
            let moved = between(p, middle, share);
            let reached = space.steer(a, moved).filter(|q| space.connects(*q, b));
            if let Some(q) = reached.filter(|q| distance(a, *q) + distance(*q, b) < to_a + to_b) {
                path[i] = q;
                break;
            }
            share *= 0.5;
        }
    }
    path
}

/// Cuts corners: replaces a point by one on each of its two segments, as far from it as the motion between them is free.
fn cut_corners<S: Space>(space: &S, path: Vec<Point>) -> Vec<Point> {
    let mut rounder: Vec<Point> = Vec::with_capacity(2 * path.len());
    rounder.extend(path.first());
    for i in 1..path.len().saturating_sub(1) {
        let (a, p, b) = (rounder[rounder.len() - 1], path[i], path[i + 1]);
        match cut_corner(space, a, p, b) {
            Some([first, second]) => rounder.extend([first, second]),
            None => rounder.push(p),
        }
    }
    rounder.extend(path.last().filter(|_| path.len() > 1));
    rounder
}

fn cut_corner<S: Space>(space: &S, a: Point, p: Point, b: Point) -> Option<[Point; 2]> {
    let (to_a, to_b) = (distance(a, p), distance(p, b));
    let angle = turn(a, p, b);
    if angle < SHARP_TURN && to_a.min(to_b) * (angle.to_radians() / 2.0).sin().powi(2) < MIN_GAIN {
        return None;
    }
    // The next corner may use the other half of the second segment.
    let mut off = to_a.min(0.5 * to_b);
    while off * (1.0 - (angle.to_radians() / 2.0).cos()) > 0.25 * MIN_GAIN {
        let (first, second) = (between(p, a, (off / to_a).min(1.0)), between(p, b, off / to_b));
        let tried = space.steer(a, first).and_then(|f| Some([f, space.steer(f, second)?])).filter(|[_, s]| space.connects(*s, b));
        if let Some([f, s]) = tried.filter(|[f, s]| distance(a, *f) + distance(*f, *s) + distance(*s, b) < to_a + to_b) {
            return Some([f, s]);
        }
        off *= 0.5;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::sharpest_turn;

    /// The plane outside of a disc.
    struct Disc(f64);

    impl Space for Disc {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            let d: Point = std::array::from_fn(|k| to[k] - from[k]);
            let along = -(from[0] * d[0] + from[1] * d[1]) / (d[0] * d[0] + d[1] * d[1]).max(1e-12);
            let p = between(from, to, along.clamp(0.0, 1.0));
            (p[0].hypot(p[1]) > self.0).then_some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            (p[0].hypot(p[1]) > self.0).then_some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-20.0; 3], [20.0; 3]]
        }
    }

    #[test]
    fn detour_around_a_disc_becomes_tangents_and_arc() {
        let detour = vec![[-10.0, 0.0, 0.0], [-9.0, 12.0, 0.0], [0.0, 15.0, 2.0], [8.0, 9.0, 0.0], [10.0, 0.0, 0.0]];
        let path = shorten(&Disc(3.0), detour.clone(), Effort::Thorough);
        let tangent = (100.0f64 - 9.0).sqrt();
        let arc = 3.0 * (std::f64::consts::PI - 2.0 * (tangent / 3.0).atan());
        let shortest = 2.0 * tangent + arc;
        assert!(length(&path) > shortest && length(&path) < 1.003 * shortest, "{} instead of {shortest}", length(&path));
        assert!(sharpest_turn(&path) < 20.0, "{}", sharpest_turn(&path));
        assert_eq!((path[0], path[path.len() - 1]), (detour[0], detour[4]));
        assert!(path.windows(2).all(|w| Disc(3.0).connects(w[0], w[1])));
    }

    #[test]
    fn without_obstacles_the_path_becomes_straight() {
        let path = shorten(&Disc(1.0), vec![[2.0, -5.0, 0.0], [9.0, 0.0, 5.0], [3.0, 1.0, -2.0], [2.0, 5.0, 1.0]], Effort::Quick);
        assert_eq!(path, [[2.0, -5.0, 0.0], [2.0, 5.0, 1.0]]);
        assert!(shorten(&Disc(1.0), Vec::new(), Effort::Quick).is_empty());
        assert_eq!(shorten(&Disc(1.0), vec![[3.0; 3]], Effort::Thorough), [[3.0; 3]]);
    }
}
