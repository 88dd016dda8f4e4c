//! Where a robot can be and go: what planning asks, whatever answers it.

use crate::points::{Point, between, distance};
use crate::robot::Robot;
use voxelastic::Pose;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, Capsule, OrientedBox, Sphere, UnknownAs};

/// The space that a robot moves in. A state is the place of the robot's centre.
///
/// Motions are checked as wholes, never at steps along them.
pub trait Space {
    /// Moves straight from a state to `to`: where the robot arrives, which need not be `to` itself (on wheels it is above or
    /// below); none when something is in the way.
    fn reach(&self, from: Point, to: Point) -> Option<Point>;

    /// The state at `p`, or for wheels above or below it; none when the robot does not fit there.
    fn settle(&self, p: Point) -> Option<Point>;

    /// Whether something is in the way at `p` itself. Cheap: it is asked a lot, and nothing but luck depends on the answer.
    fn is_blocked(&self, p: Point) -> bool {
        self.settle(p).is_none()
    }

    /// Where a state at `p` would be, whether or not the robot fits there; none where there can be none, as over an abyss.
    fn lay(&self, p: Point) -> Option<Point> {
        Some(p)
    }

    /// Corners of the box that states are in.
    fn bounds(&self) -> [Point; 2];

    /// Whether two states are the same for all purposes, so that one can be arrived at instead of the other.
    fn is_same(&self, a: Point, b: Point) -> bool {
        distance(a, b) < 1e-9
    }

    /// Longest branch that makes sense, metres: motions are tried whole.
    fn longest(&self) -> f64 {
        4.0
    }

    /// How many of the coordinates can be chosen freely: 3 in the air, 2 on the ground.
    fn dimensions(&self) -> usize {
        3
    }

    /// Appends the states on the way from a state to another that [`reach`](Self::reach) arrived at, the last included.
    fn trace(&self, _from: Point, to: Point, way: &mut Vec<Point>) {
        way.push(to);
    }

    /// Whether the robot that reached `arrived` from `from` can go back the same way.
    fn leads_back(&self, _from: Point, _arrived: Point) -> bool {
        true
    }

    /// Whether a piece of a path that was [traced](Self::trace) can still be taken.
    fn holds(&self, from: Point, to: Point) -> bool {
        self.joins(from, to)
    }

    /// Where a robot in a state would be over `to`, near by. Whether it fits there, and on the way, is not looked at.
    fn alongside(&self, _from: Point, to: Point) -> Option<Point> {
        Some(to)
    }

    /// How the robot fits in a state: whole, or as a ball whose radius is smaller by `less`.
    fn fit(&self, p: Point, _less: f64) -> Fit {
        if self.settle(p).is_some() { Fit::Whole } else { Fit::Not }
    }

    /// Whether the robot certainly fits wherever its centre is in a box, asked of all of it at once.
    fn is_open(&self, _corners: [Point; 2]) -> bool {
        false
    }

    /// Whether the robot can go straight from one state to the other.
    fn joins(&self, from: Point, to: Point) -> bool {
        self.reach(from, to).is_some_and(|arrived| self.is_same(arrived, to))
    }
}

/// How a robot fits in a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// As it is.
    Whole,
    /// If it were smaller: it may fit near by.
    Nearly,
    /// Not at all.
    Not,
}

/// A ball that flies through a map.
#[derive(Clone, Debug)]
pub struct Air<'a> {
    map: &'a AtlasQuery<'a>,
    radius: f64,
    unknown: UnknownAs,
    bounds: [Point; 2],
}

impl<'a> Air<'a> {
    /// The space of `robot` in a map, within a box.
    pub fn new(map: &'a AtlasQuery<'a>, robot: &Robot, bounds: [Point; 2]) -> Self {
        Self { map, radius: robot.radius, unknown: robot.unknown, bounds }
    }

    /// Whether the ball meets nothing on its way from `from` to `to`, all of the sweep at once.
    pub(crate) fn is_free(&self, from: Point, to: Point) -> bool {
        // Points are cheap to ask for, and where something is in the way one of a few is in it, most often.
        let may_be = [1.0, 0.5, 0.25, 0.75].into_iter().all(|share| self.is_free_at(between(from, to, share)));
        may_be && self.map.is_free(&Capsule { from, to, radius: self.radius }.into(), self.unknown)
    }

    /// Whether nothing is in the way of the ball's farthest points along the axes.
    fn is_free_around(&self, p: Point) -> bool {
        let tip = |axis: usize, off: f64| std::array::from_fn(|k| if k == axis { p[k] + off } else { p[k] });
        (0..3).all(|axis| [-self.radius, self.radius].into_iter().all(|off| self.is_free_at(tip(axis, off))))
    }

    /// Whether nothing is in the way of a point.
    pub(crate) fn is_free_at(&self, p: Point) -> bool {
        match self.unknown {
            UnknownAs::Blocked => self.map.state(p) == State::Free,
            UnknownAs::Free => self.map.state(p) != State::Occupied,
        }
    }
}

/// Whether `p` is in the box.
pub(crate) fn is_within(bounds: &[Point; 2], p: Point) -> bool {
    (0..3).all(|k| p[k] >= bounds[0][k] && p[k] <= bounds[1][k])
}

impl Space for Air<'_> {
    fn reach(&self, from: Point, to: Point) -> Option<Point> {
        (is_within(&self.bounds, to) && self.is_free(from, to)).then_some(to)
    }

    fn settle(&self, p: Point) -> Option<Point> {
        (is_within(&self.bounds, p) && self.is_free_at(p) && self.map.is_free(&Sphere { centre: p, radius: self.radius }.into(), self.unknown))
            .then_some(p)
    }

    fn is_blocked(&self, p: Point) -> bool {
        !self.is_free_at(p)
    }

    /// What of space is unknown is asked thoroughly only where a look at some places says that it is worth the time.
    fn fit(&self, p: Point, less: f64) -> Fit {
        let ball = |radius: f64| Sphere { centre: p, radius }.into();
        let touches = |radius: f64| !self.map.is_free(&ball(radius), UnknownAs::Free);
        let is_strict = self.unknown == UnknownAs::Blocked;
        if !is_within(&self.bounds, p) || !self.is_free_at(p) {
            Fit::Not
        } else if is_strict && self.map.is_free_by_one(&ball(self.radius)) {
            Fit::Whole
        } else if touches(self.radius) {
            if touches((self.radius - less).max(0.0)) { Fit::Not } else { Fit::Nearly }
        } else if !is_strict || (self.is_free_around(p) && self.map.is_free(&ball(self.radius), self.unknown)) {
            Fit::Whole
        } else {
            Fit::Nearly
        }
    }

    fn is_open(&self, [low, high]: [Point; 2]) -> bool {
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
