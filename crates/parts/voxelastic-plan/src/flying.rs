//! The configuration space of a flying robot.

use crate::points::{Point, between};
use crate::robot::Robot;
use crate::space::{Fit, Space, is_within};
use voxelastic::Pose;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, Capsule, OrientedBox, Sphere, UnknownAs};

/// A ball that moves freely in the map.
#[derive(Clone, Debug)]
pub struct FlyingSpace<'a> {
    map: &'a AtlasQuery<'a>,
    radius: f64,
    unknown: UnknownAs,
    bounds: [Point; 2],
}

impl<'a> FlyingSpace<'a> {
    /// The space of `robot` in a map, within the box given by two corners (map frame, metres).
    pub fn new(map: &'a AtlasQuery<'a>, robot: &Robot, bounds: [Point; 2]) -> Self {
        Self { map, radius: robot.radius, unknown: robot.unknown, bounds }
    }

    /// Whether the sweep of the ball from `from` to `to` is free.
    pub(crate) fn is_free(&self, from: Point, to: Point) -> bool {
        // Tests of points are cheap and find most collisions.
        let may_be_free = [1.0, 0.5, 0.25, 0.75].into_iter().all(|share| self.is_free_at(between(from, to, share)));
        may_be_free && self.map.is_free(&Capsule { from, to, radius: self.radius }.into(), self.unknown)
    }

    /// Whether the ball's outermost points along the axes are free.
    fn is_free_around(&self, p: Point) -> bool {
        let tip = |axis: usize, off: f64| std::array::from_fn(|k| if k == axis { p[k] + off } else { p[k] });
        (0..3).all(|axis| [-self.radius, self.radius].into_iter().all(|off| self.is_free_at(tip(axis, off))))
    }

    /// Whether a point is free.
    pub(crate) fn is_free_at(&self, p: Point) -> bool {
        match self.unknown {
            UnknownAs::Blocked => self.map.state(p) == State::Free,
            UnknownAs::Free => self.map.state(p) != State::Occupied,
        }
    }
}

impl Space for FlyingSpace<'_> {
    fn steer(&self, from: Point, to: Point) -> Option<Point> {
        (is_within(&self.bounds, to) && self.is_free(from, to)).then_some(to)
    }

    fn state_at(&self, p: Point) -> Option<Point> {
        (is_within(&self.bounds, p) && self.is_free_at(p) && self.map.is_free(&Sphere { centre: p, radius: self.radius }.into(), self.unknown))
            .then_some(p)
    }

    fn is_blocked(&self, p: Point) -> bool {
        !self.is_free_at(p)
    }

    /// Runs the exact test against unknown space only where tests of a few points pass.
    fn fit(&self, p: Point, margin: f64) -> Fit {
        let ball = |radius: f64| Sphere { centre: p, radius }.into();
        let touches = |radius: f64| !self.map.is_free(&ball(radius), UnknownAs::Free);
        let is_strict = self.unknown == UnknownAs::Blocked;
        if !is_within(&self.bounds, p) || !self.is_free_at(p) {
            Fit::Blocked
        } else if is_strict && self.map.is_free_by_one(&ball(self.radius)) {
            Fit::Free
        } else if touches(self.radius) {
            if touches((self.radius - margin).max(0.0)) { Fit::Blocked } else { Fit::Tight }
        } else if !is_strict || (self.is_free_around(p) && self.map.is_free(&ball(self.radius), self.unknown)) {
            Fit::Free
        } else {
            Fit::Tight
        }
    }

    fn is_box_free(&self, [low, high]: [Point; 2]) -> bool {
        let middle = between(low, high, 0.5);
        let half = std::array::from_fn(|k| 0.5 * (high[k] - low[k]) + self.radius);
        let around = OrientedBox { t_frame_box: Pose::translation(middle[0], middle[1], middle[2]), half };
        is_within(&self.bounds, low)
            && is_within(&self.bounds, high)
            && match self.unknown {
                UnknownAs::Blocked => self.map.is_free_by_one(&around.into()),
                UnknownAs::Free => self.map.is_free(&around.into(), self.unknown),
            }
    }

    fn bounds(&self) -> [Point; 2] {
        self.bounds
    }
}
