//! For a robot that follows the path by itself, or that somebody drives elsewhere; and what may be asked of it on the way.

use super::Explorer;
use crate::decision::{Decision, Purpose, ReturnReason};
use crate::settings::ExploreError;
use voxelastic::atlas::Atlas;
use voxelastic_plan::{Point, distance};

/// A robot that is farther from its path gets another one, metres.
const OFF_PATH: f64 = 0.75;
/// A robot that stands so near to the end of its path has arrived, metres: controllers stop short of it.
const ARRIVED: f64 = 0.5;

impl Explorer {
    /// Notes where a robot is that [`advance`](Self::advance) does not move (map frame, metres), before a decision: what it has passed of its path is dropped. A path within
    /// 50 cm of whose end it `stands` is done, and one that it has left by more than 75 cm is given up, so that the decision is about where it is now.
    pub fn keep_up(&mut self, atlas: &Atlas, robot: Point, stands: bool) {
        let Some(leg) = &mut self.leg else { return };
        let off = leg.keep_up(atlas, robot);
        let end = leg.end_in(atlas).filter(|end| stands && distance(*end, robot) < ARRIVED);
        if let (Some(end), true) = (end, leg.volume.is_some()) {
            self.arrive(atlas, end);
        }
        if end.is_some() || off > OFF_PATH {
            self.leg = None;
        }
    }

    /// As [`decide`](Self::decide), for a robot that looks at the map more often than once in a metre: a path does not grow old by it.
    ///
    /// # Errors
    /// Those of [`decide`](Self::decide).
    pub fn look(&mut self, atlas: &Atlas, robot: Point, seconds_left: Option<f64>) -> Result<Decision, ExploreError> {
        self.since_planned = self.since_planned.saturating_sub(1);
        self.decide(atlas, robot, seconds_left)
    }

    /// Its home, map frame, metres; none before the first decision.
    pub fn home(&self) -> Option<Point> {
        self.home.as_ref().map(|home| home.0)
    }

    /// It goes home from the next decision on, and stays there.
    pub fn return_home(&mut self) {
        self.turn_back(ReturnReason::Asked);
        self.turned_back = Some(ReturnReason::Asked);
        self.leg.take_if(|leg| !leg.is_retreat);
    }

    /// It explores from the next decision on, also if it was on its way home or there; home stays where it is.
    pub fn resume(&mut self) {
        self.purpose = Purpose::Explore;
        self.turned_back = None;
        (self.leg, self.roadmap) = (None, None);
        (self.stuck, self.retreats, self.beginnings, self.trials) = (0, 0, 0, 0);
        self.exhausted.clear();
        self.gone_to.clear();
    }
}
