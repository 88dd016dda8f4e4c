//! The interface between planning and the world: where a robot can be, and which motions are free.

use crate::points::{Point, distance};

/// The configuration space of a robot. A state is the position of the robot's centre, map frame, metres.
///
/// Implemented by [`FlyingSpace`](crate::FlyingSpace) and [`GroundSpace`](crate::GroundSpace) over an occupancy map. Motions are checked as whole
/// sweeps, never at steps along them.
pub trait Space {
    /// Moves straight from a state towards `to`. Returns the state the robot arrives at, which on the ground is above or below `to`; none when the
    /// motion is not free.
    fn steer(&self, from: Point, to: Point) -> Option<Point>;

    /// The state at `p`, on the ground above or below it; none when the robot does not fit there.
    fn state_at(&self, p: Point) -> Option<Point>;

    /// Whether the point `p` itself is an obstacle. A cheap test that may be wrong: only the choice of samples depends on it.
    fn is_blocked(&self, p: Point) -> bool {
        self.state_at(p).is_none()
    }

    /// Projects `p` to where a state would be, whether or not the robot fits there; none where there is none, for instance without a floor.
    fn project(&self, p: Point) -> Option<Point> {
        Some(p)
    }

    /// Corners of the box that states lie in, map frame, metres.
    fn bounds(&self) -> [Point; 2];

    /// Whether two states are equal up to rounding and the map's resolution.
    fn is_same(&self, a: Point, b: Point) -> bool {
        distance(a, b) < 1e-9
    }

    /// Longest motion that is worth trying, metres.
    fn max_step(&self) -> f64 {
        4.0
    }

    /// Number of coordinates that can be chosen freely: 3 in the air, 2 on the ground.
    fn dimensions(&self) -> usize {
        3
    }

    /// Distance in the coordinates that can be chosen freely, metres.
    fn metric(&self, a: Point, b: Point) -> f64 {
        if self.dimensions() == 2 { (a[0] - b[0]).hypot(a[1] - b[1]) } else { distance(a, b) }
    }

    /// Appends the corners of the motion from a state to another that [`steer`](Self::steer) arrived at, the last state included.
    fn trace(&self, _from: Point, to: Point, path: &mut Vec<Point>) {
        path.push(to);
    }

    /// Whether the motion that arrived at `arrived` is free in the other direction, too.
    fn is_reversible(&self, _from: Point, _arrived: Point) -> bool {
        true
    }

    /// Whether a segment of a [traced](Self::trace) path is free.
    fn is_segment_free(&self, from: Point, to: Point) -> bool {
        self.connects(from, to)
    }

    /// The state at `to` of a robot that comes from the nearby state `from`. Does not check that it fits there or that the motion is free.
    fn neighbour_state(&self, _from: Point, to: Point) -> Option<Point> {
        Some(to)
    }

    /// How the robot fits at a state: with its full radius, or only with one that is smaller by `margin` metres.
    fn fit(&self, p: Point, _margin: f64) -> Fit {
        if self.state_at(p).is_some() { Fit::Free } else { Fit::Blocked }
    }

    /// Whether the robot fits at every state in a box. May return false although it does.
    fn is_box_free(&self, _corners: [Point; 2]) -> bool {
        false
    }

    /// Whether the straight motion between two states is free.
    fn connects(&self, from: Point, to: Point) -> bool {
        self.steer(from, to).is_some_and(|arrived| self.is_same(arrived, to))
    }
}

/// How a robot fits at a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// With its full radius.
    Free,
    /// Only with a smaller radius: the robot may fit nearby.
    Tight,
    /// Not at all.
    Blocked,
}

/// Whether `p` is in the box.
pub(crate) fn is_within(bounds: &[Point; 2], p: Point) -> bool {
    (0..3).all(|k| p[k] >= bounds[0][k] && p[k] <= bounds[1][k])
}
