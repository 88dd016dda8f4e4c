//! Points of the map frame, and polylines through them.

/// A point of the map frame, metres.
pub type Point = [f64; 3];

/// Distance between two points, metres.
#[inline(always)]
pub fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum::<f64>().sqrt()
}

/// The point at a fraction `share` (0 to 1) of the segment from `a` to `b`.
#[inline(always)]
pub fn between(a: Point, b: Point, share: f64) -> Point {
    std::array::from_fn(|k| a[k] + share * (b[k] - a[k]))
}

/// Length of a polyline, metres.
pub fn length(line: &[Point]) -> f64 {
    line.windows(2).map(|w| distance(w[0], w[1])).sum()
}

/// The largest change of direction at an inner point, degrees; 0 for a straight line. Coincident points count as one.
pub fn sharpest_turn(line: &[Point]) -> f64 {
    let mut distinct = line.to_vec();
    distinct.dedup_by(|a, b| distance(*a, *b) < 1e-9);
    distinct.windows(3).map(|w| turn(w[0], w[1], w[2])).fold(0.0, f64::max)
}

/// Change of direction at `b` between the segments from `a` and to `c`, degrees.
pub fn turn(a: Point, b: Point, c: Point) -> f64 {
    let dot: f64 = (0..3).map(|k| (b[k] - a[k]) * (c[k] - b[k])).sum();
    (dot / (distance(a, b) * distance(b, c)).max(1e-12)).clamp(-1.0, 1.0).acos().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_turns_by_right_angles() {
        let square = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [0.0, 2.0, 0.0]];
        assert_eq!(length(&square), 6.0);
        assert!((sharpest_turn(&square) - 90.0).abs() < 1e-9);
        assert_eq!(between(square[0], square[3], 0.25), [0.5, 0.5, 0.0]);
    }
}
