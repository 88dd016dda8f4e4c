//! Makes a path shorter and rounder: points are left out where the way without them is free, corners are cut and pulled tight.
//!
//! Everything that is changed is checked anew, and nothing is changed that does not make the path shorter.

use crate::points::{Point, between, distance, length, turn};
use crate::space::Space;

/// How long to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// Until a round gains less than 1 %: while searching.
    Quick,
    /// Until a round gains less than 0.02 %, and corners are round: at the end.
    Thorough,
}

impl Effort {
    /// Least share of the length that a round must gain to be followed by another, and most rounds.
    fn limits(self) -> (f64, usize) {
        match self {
            Self::Quick => (0.01, 8),
            Self::Thorough => (2e-4, 40),
        }
    }
}

/// Gains below this are left, metres.
const GAIN: f64 = 1e-3;
/// Turns sharper than this are cut where there is room, degrees.
const SHARP: f64 = 15.0;
/// Pieces longer than this are halved before they are pulled, metres: a long piece can bend around what is in its way.
const PIECE: f64 = 3.0;

/// A path through the same ends, no longer than `path`, along which every piece is free.
///
/// `path` must be free itself. It is shortened to what is locally the shortest, up to small gains; which way
/// around an obstacle it goes changes only where a straight line leads there.
pub fn shorten<S: Space>(space: &S, path: Vec<Point>, effort: Effort) -> Vec<Point> {
    let (least, rounds) = effort.limits();
    let mut path = leave_out(space, path);
    for _ in 0..rounds {
        let before = length(&path);
        path = pull(space, halve(space, path));
        path = cut(space, path);
        path = leave_out(space, path);
        if before - length(&path) < least * before {
            break;
        }
    }
    path
}

/// Leaves out points as long as the way past them is free and shorter: from each point to the farthest that can be seen, as
/// far as doubling steps find it.
fn leave_out<S: Space>(space: &S, path: Vec<Point>) -> Vec<Point> {
    let mut kept = Vec::with_capacity(path.len());
    let mut at = 0;
    while let Some(&from) = path.get(at) {
        kept.push(from);
        let sees = |to: usize| path.get(to).is_some_and(|p| space.joins(from, *p));
        let mut next = at + 1;
        let mut step = 1;
        // Grows while it works, shrinks when it does not.
        while step > 0 && next + 1 < path.len() {
            let to = (next + step).min(path.len() - 1);
            if to > next && sees(to) {
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

/// Puts points into long pieces.
fn halve<S: Space>(space: &S, path: Vec<Point>) -> Vec<Point> {
    let mut fine = Vec::with_capacity(2 * path.len());
    for w in path.windows(2) {
        fine.push(w[0]);
        let pieces = (distance(w[0], w[1]) / PIECE).ceil() as usize;
        let mut last = w[0];
        for k in 1..pieces {
            // On wheels a point between lies on the floor; one that cannot be reached is left out.
            let Some(p) = space.reach(last, between(w[0], w[1], k as f64 / pieces as f64)) else { break };
            fine.push(p);
            last = p;
        }
    }
    fine.extend(path.last());
    join(space, fine, &path)
}

/// `changed` if all of it is free, else `before`: on wheels the way to a point depends on where it began.
fn join<S: Space>(space: &S, changed: Vec<Point>, before: &[Point]) -> Vec<Point> {
    let holds = space.dimensions() == 3 || changed.windows(2).all(|w| space.joins(w[0], w[1]));
    if holds { changed } else { before.to_vec() }
}

/// Moves each inner point towards the straight line between its neighbours, as far as that is free.
fn pull<S: Space>(space: &S, mut path: Vec<Point>) -> Vec<Point> {
    for i in 1..path.len().saturating_sub(1) {
        let (a, p, b) = (path[i - 1], path[i], path[i + 1]);
        let (to_a, to_b) = (distance(a, p), distance(p, b));
        let middle = between(a, b, to_a / (to_a + to_b).max(1e-9));
        let mut share = 1.0;
        while share * distance(p, middle) > GAIN {
            let moved = between(p, middle, share);
            let reached = space.reach(a, moved).filter(|q| space.joins(*q, b));
            if let Some(q) = reached.filter(|q| distance(a, *q) + distance(*q, b) < to_a + to_b) {
                path[i] = q;
                break;
            }
            share *= 0.5;
        }
    }
    path
}

/// Cuts corners: a point becomes two, on the pieces before and behind it, as far from it as the way between them is free.
fn cut<S: Space>(space: &S, path: Vec<Point>) -> Vec<Point> {
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
    if angle < SHARP && to_a.min(to_b) * (angle.to_radians() / 2.0).sin().powi(2) < GAIN {
        return None;
    }
    // Half of the piece behind is left to the next corner.
    let mut off = to_a.min(0.5 * to_b);
    while off * (1.0 - (angle.to_radians() / 2.0).cos()) > 0.25 * GAIN {
        let (first, second) = (between(p, a, (off / to_a).min(1.0)), between(p, b, off / to_b));
        let tried = space.reach(a, first).and_then(|f| Some([f, space.reach(f, second)?])).filter(|[_, s]| space.joins(*s, b));
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
        fn reach(&self, from: Point, to: Point) -> Option<Point> {
            let d: Point = std::array::from_fn(|k| to[k] - from[k]);
            let along = -(from[0] * d[0] + from[1] * d[1]) / (d[0] * d[0] + d[1] * d[1]).max(1e-12);
            let p = between(from, to, along.clamp(0.0, 1.0));
            (p[0].hypot(p[1]) > self.0).then_some(to)
        }

        fn settle(&self, p: Point) -> Option<Point> {
            (p[0].hypot(p[1]) > self.0).then_some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-20.0; 3], [20.0; 3]]
        }
    }

    #[test]
    fn a_detour_around_a_disc_becomes_the_two_tangents_and_the_arc() {
        let detour = vec![[-10.0, 0.0, 0.0], [-9.0, 12.0, 0.0], [0.0, 15.0, 2.0], [8.0, 9.0, 0.0], [10.0, 0.0, 0.0]];
        let path = shorten(&Disc(3.0), detour.clone(), Effort::Thorough);
        let tangent = (100.0f64 - 9.0).sqrt();
        let arc = 3.0 * (std::f64::consts::PI - 2.0 * (tangent / 3.0).atan());
        let shortest = 2.0 * tangent + arc;
        assert!(length(&path) > shortest && length(&path) < 1.003 * shortest, "{} instead of {shortest}", length(&path));
        assert!(sharpest_turn(&path) < 20.0, "{}", sharpest_turn(&path));
        assert_eq!((path[0], path[path.len() - 1]), (detour[0], detour[4]));
        assert!(path.windows(2).all(|w| Disc(3.0).joins(w[0], w[1])));
    }

    #[test]
    fn nothing_in_the_way_leaves_the_straight_line() {
        let path = shorten(&Disc(1.0), vec![[2.0, -5.0, 0.0], [9.0, 0.0, 5.0], [3.0, 1.0, -2.0], [2.0, 5.0, 1.0]], Effort::Quick);
        assert_eq!(path, [[2.0, -5.0, 0.0], [2.0, 5.0, 1.0]]);
        assert!(shorten(&Disc(1.0), Vec::new(), Effort::Quick).is_empty());
        assert_eq!(shorten(&Disc(1.0), vec![[3.0; 3]], Effort::Thorough), [[3.0; 3]]);
    }
}
