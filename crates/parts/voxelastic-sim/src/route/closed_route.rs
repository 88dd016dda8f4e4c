//! Closed routes in the plane, by arc length.

use std::f64::consts::TAU;

/// A straight or circular segment of a route.
#[derive(Clone, Copy, Debug)]
struct Segment {
    /// Path length at which it starts, metres.
    start: f64,
    length: f64,
    from: [f64; 2],
    heading: f64,
    /// Radians turned per metre, counter-clockwise.
    curvature: f64,
}

/// Distance between the heights of a profile, metres.
const PROFILE_STEP: f64 = 0.02;

/// A closed smooth curve in the plane of straight lines and circular arcs, parametrised by arc length over any number of laps.
///
/// Unlike a spline through waypoints it has straight segments, which narrow doorways need.
#[derive(Clone, Debug)]
pub struct Route {
    segments: Vec<Segment>,
    length: f64,
    /// Height of the floor every [`PROFILE_STEP`] of a lap, metres; empty for level ground at zero.
    profile: Vec<f64>,
}

impl Route {
    /// The closed polygon with these corners (metres), each rounded with `radius` or as much as its sides allow.
    /// Fewer than three corners give a circle of that radius around the first (or the origin).
    pub fn rounded(corners: &[[f64; 2]], radius: f64) -> Self {
        let corners: Vec<[f64; 2]> = corners.iter().enumerate().filter(|&(i, c)| i == 0 || *c != corners[i - 1]).map(|(_, c)| *c).collect();
        let count = corners.len();
        let radius = radius.max(1e-3);
        if count < 3 {
            let centre = corners.first().copied().unwrap_or_default();
            let around = Segment { start: 0.0, length: TAU * radius, from: [centre[0], centre[1] - radius], heading: 0.0, curvature: 1.0 / radius };
            return Self { segments: vec![around], length: TAU * radius, profile: Vec::new() };
        }
        let side = |k: usize| {
            let (a, b) = (corners[k % count], corners[(k + 1) % count]);
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            (dy.atan2(dx), dx.hypot(dy))
        };
        // Distance from corner k + 1 to the ends of its arc, and the angle of the arc.
        let arcs: Vec<(f64, f64)> = (0..count)
            .map(|k| {
                let ((before, a), (after, b)) = (side(k), side(k + 1));
                let turn = (after - before + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
                let cut = (radius * (turn.abs() / 2.0).tan()).min(0.5 * a.min(b));
                (cut, turn)
            })
            .collect();
        let mut route = Self { segments: Vec::with_capacity(2 * count), length: 0.0, profile: Vec::new() };
        for k in 0..count {
            let (heading, length) = side(k);
            let behind = arcs[(k + count - 1) % count].0;
            let (ahead, turn) = arcs[k];
            let (sin, cos) = heading.sin_cos();
            let from = [corners[k][0] + cos * behind, corners[k][1] + sin * behind];
            let straight = (length - behind - ahead).max(0.0);
            route.push(Segment { start: 0.0, length: straight, from, heading, curvature: 0.0 });
            if turn.abs() > 1e-9 {
                let radius = ahead / (turn.abs() / 2.0).tan();
                let from = [from[0] + cos * straight, from[1] + sin * straight];
                route.push(Segment { start: 0.0, length: radius * turn.abs(), from, heading, curvature: turn.signum() / radius });
            }
        }
        route
    }

    fn push(&mut self, segment: Segment) {
        self.segments.push(Segment { start: self.length, ..segment });
        self.length += segment.length;
    }

    /// The route over a floor, whose height is asked for along a lap, point by point.
    pub fn over(mut self, mut floor: impl FnMut([f64; 2]) -> f64) -> Self {
        let steps = (self.length / PROFILE_STEP).ceil() as usize;
        self.profile = (0..steps).map(|k| floor(self.at(k as f64 * PROFILE_STEP).0)).collect();
        self
    }

    /// Height of the floor after `travelled` metres, metres.
    pub fn floor(&self, travelled: f64) -> f64 {
        let Some(last) = self.profile.len().checked_sub(1) else { return 0.0 };
        let at = travelled.rem_euclid(self.length) / PROFILE_STEP;
        let k = (at as usize).min(last);
        let (here, next) = (self.profile[k], self.profile[if k == last { 0 } else { k + 1 }]);
        here + (at - k as f64).clamp(0.0, 1.0) * (next - here)
    }

    /// Length of one lap, metres.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Position (metres) and heading (radians counter-clockwise from x, continuous within a lap) after
    /// `travelled` metres, which may be any number of laps, also negative.
    pub fn at(&self, travelled: f64) -> ([f64; 2], f64) {
        let s = travelled.rem_euclid(self.length);
        let index = self.segments.partition_point(|p| p.start <= s).saturating_sub(1);
        let segment = &self.segments[index];
        let (along, (sin, cos)) = (s - segment.start, segment.heading.sin_cos());
        let turn = segment.curvature * along;
        // The chord of an arc by sinc, which includes straight lines.
        let half = turn / 2.0;
        let chord = along * if half.abs() < 1e-6 { 1.0 } else { half.sin() / half };
        let (s, c) = half.sin_cos();
        let direction = [cos * c - sin * s, sin * c + cos * s];
        ([segment.from[0] + chord * direction[0], segment.from[1] + chord * direction[1]], segment.heading + turn)
    }

    /// Whether a point (metres) is farther than `clearance` metres from the whole route.
    pub(crate) fn is_clear_of(&self, p: [f64; 2], clearance: f64) -> bool {
        let steps = (self.length() / 0.5) as usize;
        (0..steps).all(|k| {
            let q = self.at(k as f64 * 0.5).0;
            (p[0] - q[0]).hypot(p[1] - q[1]) > clearance
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn routes_are_closed_smooth_and_parametrised_by_arc_length(
            corners in prop::collection::vec([-50.0..50.0f64, -50.0..50.0f64], 0..9), radius in 0.5..8.0f64,
        ) {
            let route = Route::rounded(&corners, radius);
            let steps = 4000;
            let ds = route.length() / f64::from(steps);
            for k in 0..steps {
                let s = f64::from(k) * ds;
                let ((a, before), (b, after)) = (route.at(s), route.at(s + ds));
                let chord = (b[0] - a[0]).hypot(b[1] - a[1]);
                prop_assert!(chord <= ds * (1.0 + 1e-9));
                // A step that is nearly straight goes where the heading says, but for a sharp corner right at either end of it.
                if ds < 0.02 * radius && chord > 0.999 * ds {
                    let towards = |heading: f64| ((b[0] - a[0]) * heading.cos() + (b[1] - a[1]) * heading.sin()) / chord;
                    prop_assert!(towards(before).max(towards(after)) > 0.99);
                }
            }
            let ((a, _), (b, _)) = (route.at(-1.0), route.at(3.0 * route.length() - 1.0));
            prop_assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-6);
        }
    }

    #[test]
    fn rounded_square() {
        let route = Route::rounded(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]], 2.0);
        assert!((route.length() - (24.0 + 2.0 * TAU)).abs() < 1e-9);
        let (p, heading) = route.at(3.0);
        assert!((p[0] - 5.0).abs() < 1e-9 && p[1].abs() < 1e-9 && heading.abs() < 1e-9);
        let corner = route.at(6.0 + std::f64::consts::FRAC_PI_2).0;
        assert!((corner[0] - (8.0 + 2f64.sqrt())).abs() < 1e-9 && (corner[1] - (2.0 - 2f64.sqrt())).abs() < 1e-9);
    }
}
