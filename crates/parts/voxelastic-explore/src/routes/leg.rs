//! The path that the robot is on, with waypoints that move with corrections of the map.

use crate::near_returns::squared_distance;
use voxelastic::atlas::Atlas;
use voxelastic_plan::{Anchor, Point, Space, anchor_path, between, distance, resolve_anchors};

/// A robot is looked for on its path this far ahead of where it was, metres: where a path comes back to itself, it is not taken to be farther along.
const AHEAD: f64 = 5.0;

/// A path that the robot follows.
#[derive(Clone, Debug)]
pub(crate) struct Leg {
    /// From the robot on.
    pub path: Vec<Point>,
    anchors: Vec<Anchor>,
    /// Unknown volume expected at its end, cubic metres; none on the way home.
    pub volume: Option<f64>,
    /// Whether it leads along the robot's own track.
    pub is_track: bool,
    /// Whether it leads back along it, and so home at last.
    pub is_retreat: bool,
}

impl Leg {
    pub fn new(atlas: &Atlas, path: Vec<Point>, volume: Option<f64>) -> Self {
        Self { anchors: anchor_path(atlas, &path), path, volume, is_track: false, is_retreat: false }
    }

    /// A way back along the robot's own track.
    pub fn back(atlas: &Atlas, track: Vec<Point>) -> Self {
        Self { is_retreat: true, ..Self::along(atlas, track) }
    }

    /// A way along the robot's own track.
    pub fn along(atlas: &Atlas, track: Vec<Point>) -> Self {
        Self { is_track: true, ..Self::new(atlas, track, None) }
    }

    /// The straight motions of a path along which the robot really moves: on wheels they follow the floor.
    pub fn trace<S: Space>(space: &S, path: &[Point]) -> Vec<Point> {
        let mut traced: Vec<Point> = path.first().copied().into_iter().collect();
        for segment in path.windows(2) {
            let at = traced.last().copied().filter(|at| space.steer(*at, segment[1]).is_some());
            if at.is_none() && traced.last() != Some(&segment[0]) {
                traced.push(segment[0]);
            }
            space.trace(at.unwrap_or(segment[0]), segment[1], &mut traced);
        }
        traced
    }

    /// The last waypoint.
    pub fn end(&self) -> Option<Point> {
        self.path.last().copied()
    }

    /// Moves `metres` along the path; returns where that leads.
    pub fn advance(&mut self, metres: f64) -> Option<Point> {
        let mut left = metres;
        while self.path.len() > 1 {
            let length = distance(self.path[0], self.path[1]);
            if left < length {
                self.path[0] = between(self.path[0], self.path[1], left / length);
                break;
            }
            left -= length;
            self.path.remove(0);
            if !self.anchors.is_empty() {
                self.anchors.remove(0);
            }
        }
        self.path.first().copied()
    }

    /// Moves the waypoints with the map, and begins at the robot; returns false if one of them is lost.
    pub fn follow(&mut self, atlas: &Atlas, robot: Point, is_map_moved: bool) -> bool {
        if is_map_moved {
            let moved: Option<Vec<Point>> = resolve_anchors(atlas, &self.anchors).into_iter().collect();
            match moved.filter(|moved| moved.len() == self.path.len()) {
                Some(moved) => self.path = moved,
                None => return false,
            }
        }
        if let Some(first) = self.path.first_mut() {
            *first = robot;
        }
        true
    }

    /// Drops the waypoints that the robot has passed; returns its distance from the path as it was planned, metres.
    pub fn keep_up(&mut self, atlas: &Atlas, robot: Point) -> f64 {
        let planned: Option<Vec<Point>> = resolve_anchors(atlas, &self.anchors).into_iter().collect();
        let planned = planned.filter(|planned| planned.len() == self.path.len()).unwrap_or_else(|| self.path.clone());
        let (mut passed, mut nearest, mut along) = (0, f64::INFINITY, 0.0);
        for (k, segment) in planned.windows(2).enumerate() {
            let off = squared_distance(robot, segment[0], segment[1]).sqrt();
            if off < nearest {
                (passed, nearest) = (k, off);
            }
            along += distance(segment[0], segment[1]);
            if along > AHEAD {
                break;
            }
        }
        self.path.drain(..passed);
        self.anchors.drain(..passed.min(self.anchors.len()));
        if nearest.is_finite() { nearest } else { planned.first().map_or(0.0, |only| distance(*only, robot)) }
    }

    /// Where its end is in the map of now.
    pub fn end_in(&self, atlas: &Atlas) -> Option<Point> {
        let moved = self.anchors.last().and_then(|anchor| resolve_anchors(atlas, std::slice::from_ref(anchor)).first().copied().flatten());
        moved.or_else(|| self.end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_drops_what_it_has_passed_and_is_not_taken_to_be_where_the_path_comes_back() {
        let atlas = Atlas::new(0.2);
        let leg = || Leg::new(&atlas, vec![[0.0; 3], [6.0, 0.0, 0.0], [6.0, 1.0, 0.0], [0.0, 1.0, 0.0]], Some(8.0));
        let stays = |robot: Point, expected: f64| {
            let mut leg = leg();
            let off = leg.keep_up(&atlas, robot);
            leg.path.len() == 4 && (off - expected).abs() < 1e-9
        };
        assert!(stays([3.0, 0.2, 0.0], 0.2));
        assert!(stays([3.0, 0.9, 0.0], 0.9), "the way back is too far ahead");
        let mut leg = leg();
        leg.advance(4.0);
        assert!(leg.keep_up(&atlas, [6.1, 0.5, 0.0]) < 0.11 && leg.path.len() == 3 && leg.path[0] == [6.0, 0.0, 0.0], "{:?}", leg.path);
        assert!(leg.keep_up(&atlas, [2.0, 1.3, 0.0]) < 0.31 && leg.path == [[6.0, 1.0, 0.0], [0.0, 1.0, 0.0]], "{:?}", leg.path);
        // The last motion is kept, and nothing is lost of a path that has one place.
        assert!(leg.keep_up(&atlas, [0.0, 1.0, 0.0]) < 1e-9 && leg.path.len() == 2 && leg.end_in(&atlas) == Some([0.0, 1.0, 0.0]));
        assert_eq!(Leg::new(&atlas, vec![[1.0, 0.0, 0.0]], None).keep_up(&atlas, [1.0, 2.0, 0.0]), 2.0);
    }
}
