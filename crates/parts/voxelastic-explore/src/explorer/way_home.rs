//! When to go home, and how far that is.

use super::{Explorer, Situation};
use crate::decision::{Purpose, ReturnReason};
use crate::routes::retreat;
use crate::routes::shortcuts::short_way;
use voxelastic_plan::{Point, Space, length};

/// The way home takes up to this much longer than it is, and this many seconds.
const RESERVE: (f64, f64) = (1.15, 10.0);
/// A way home that the robot has not driven may turn out to be longer by this factor.
const LONGER: f64 = 1.3;
/// It looks for shortcuts of its track again when it has travelled so far, metres.
const LOOKED: f64 = 10.0;
/// A robot that is at home early explores once more if there are so many seconds left.
const ONCE_MORE: f64 = 40.0;
/// A robot that goes home because no way led to where there is more to see tries again after so many metres, and then each time after twice as many.
const TRIED_AGAIN: f64 = 50.0;

impl Explorer {
    pub(super) fn is_at_home<S: Space>(&self, now: &Situation<'_, S>) -> bool {
        self.home.as_ref().is_some_and(|(home, _)| now.space.metric(*home, now.robot) < self.settings.spacing)
    }

    /// Turns back if the time just suffices for the way home.
    pub(super) fn mind_the_time<S: Space>(&mut self, now: &Situation<'_, S>) {
        if now.seconds_left.is_some_and(|left| self.seconds_home(now, left) > left) {
            self.turn_back(ReturnReason::Time);
            // A way back along the track leads home already.
            self.leg.take_if(|leg| !leg.is_retreat);
        }
    }

    /// What the way home takes at most, seconds: that of the last plan, or the track with its shortcuts, if those matter, or the track as the robot has driven it.
    fn seconds_home<S: Space>(&mut self, now: &Situation<'_, S>, left: f64) -> f64 {
        if self.seconds_for(LONGER * self.way_home) > left && self.since_way_home > LOOKED {
            let short = length(&short_way(now.space, &self.places_of_track(), now.robot).path);
            self.note_way_home(short.min(self.way_home));
        }
        let planned = self.seconds_for(LONGER * self.way_home);
        // The length of the track takes a look at all of it.
        if planned > left { planned.min(self.seconds_for(self.track_home(now))) } else { planned }
    }

    /// What a way takes that ends at home, with what is kept in reserve, seconds.
    pub(super) fn seconds_for(&self, metres: f64) -> f64 {
        metres / self.settings.speed * RESERVE.0 + RESERVE.1
    }

    /// Where it was, in order.
    pub(super) fn places_of_track(&self) -> Vec<Point> {
        self.track.iter().map(|(place, _)| *place).collect()
    }

    /// The way home along the track.
    pub(super) fn way_back(&self, robot: Point) -> Vec<Point> {
        retreat::track(&self.places_of_track(), robot)
    }

    /// Its length, metres.
    pub(super) fn track_home<S: Space>(&self, now: &Situation<'_, S>) -> f64 {
        length(&self.way_back(now.robot))
    }

    /// Notes the way home that was found, metres; infinite if its roadmap does not reach that far.
    pub(super) fn note_way_home(&mut self, metres: f64) {
        if metres.is_finite() {
            (self.way_home, self.since_way_home) = (metres, 0.0);
        }
    }

    /// Explores again if it has come far enough back from where no way led on: others begin here, and loops may have closed.
    pub(super) fn try_again(&mut self) {
        let is_far = self.since_turned > TRIED_AGAIN * f64::from(1u32 << self.trials.min(20));
        if self.purpose == Purpose::Return && self.turned_back == Some(ReturnReason::Stuck) && is_far {
            (self.purpose, self.turned_back) = (Purpose::Explore, None);
            (self.roadmap, self.leg, self.retreats, self.stuck) = (None, None, 0, 0);
            self.trials += 1;
        }
    }

    /// Whether it explores once more from home: if it has seen something new since it was there last, and there is time. On its way loops have closed, and what could not be
    /// reached may be by now, however often it has begun anew elsewhere.
    pub(super) fn leaves_again(&mut self, seconds_left: Option<f64>) -> bool {
        self.beginnings = 0;
        let has_progressed = std::mem::take(&mut self.has_progressed);
        self.turned_back.take_if(|reason| *reason == ReturnReason::Time && seconds_left.is_none_or(|left| left > ONCE_MORE));
        has_progressed && self.begin_anew()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explorer::plan::MOST_BEGINNINGS;
    use crate::settings::ExploreSettings;
    use voxelastic_plan::Robot;

    #[test]
    fn a_robot_that_found_no_way_tries_again_after_longer_and_longer_ways_back() {
        let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), [[0.0; 3], [9.0; 3]])).unwrap();
        let mut metres = |reason| {
            explorer.turn_back(reason);
            (0..1000).find(|_| {
                explorer.since_turned += 1.0;
                explorer.try_again();
                explorer.purpose == Purpose::Explore
            })
        };
        assert_eq!([(); 3].map(|()| metres(ReturnReason::Stuck)), [Some(50), Some(100), Some(200)]);
        assert_eq!(metres(ReturnReason::Time), None);
    }

    #[test]
    fn a_robot_that_saw_something_new_leaves_home_again_if_there_is_time() {
        let at_home = |reason, has_progressed| {
            let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), [[0.0; 3], [9.0; 3]])).unwrap();
            (explorer.turned_back, explorer.has_progressed, explorer.beginnings) = (Some(reason), has_progressed, MOST_BEGINNINGS);
            [20.0, 20.0].map(|left| explorer.leaves_again(Some(left)))
        };
        assert_eq!([ReturnReason::NothingLeft, ReturnReason::Stuck].map(|reason| at_home(reason, true)), [[true, false]; 2]);
        assert_eq!([ReturnReason::Time, ReturnReason::Asked].map(|reason| at_home(reason, true)), [[false; 2]; 2]);
        assert_eq!(at_home(ReturnReason::NothingLeft, false), [false; 2]);
    }

    #[test]
    fn a_robot_that_is_at_home_early_leaves_again() {
        let leaves = |reason, seconds_left| {
            let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), [[0.0; 3], [9.0; 3]])).unwrap();
            (explorer.turned_back, explorer.has_progressed) = (Some(reason), true);
            explorer.leaves_again(seconds_left)
        };
        assert_eq!([Some(30.0), Some(90.0), None].map(|left| leaves(ReturnReason::Time, left)), [false, true, true]);
        assert!(!leaves(ReturnReason::Asked, Some(90.0)), "whoever asked wants it at home");
    }
}
