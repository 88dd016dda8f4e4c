//! When to go home, and how far that is.

use super::{EXTENDED, Explorer, Search, Situation};
use crate::decision::{Purpose, ReturnReason};
use crate::retreat;
use voxelastic_plan::{Point, Space, length};

/// The way home takes up to this much longer than planned, and this many seconds.
pub(super) const RESERVE: (f64, f64) = (1.15, 10.0);
/// So many seconds before it has to go home, it looks for a shorter way there in the whole map: in a large one that takes many decisions.
const SEARCH: f64 = 20.0;
/// It looks again when it has travelled so far, metres.
const SEARCHED: f64 = 2.0 * EXTENDED;
/// A way home through the whole map is looked for if it is shorter than the track by this factor.
const SHORTER: f64 = 1.5;
/// A robot that is at home early explores once more if there are so many seconds left.
const ONCE_MORE: f64 = 40.0;

/// A map in which the roadmap has more places than this is too large to look for a way home in: that would take minutes. The robot goes home while its track suffices.
const MOST_SEARCHED: usize = 250_000;

impl Explorer {
    pub(super) fn is_at_home<S: Space>(&self, now: &Situation<'_, S>) -> bool {
        self.home.as_ref().is_some_and(|(home, _)| now.space.metric(*home, now.robot) < self.settings.spacing)
    }

    /// Turns back if the time just suffices for the way home; looks for a shorter one shortly before.
    pub(super) fn mind_the_time<S: Space>(&mut self, now: &Situation<'_, S>) {
        let Some(left) = now.seconds_left else { return };
        let needed = self.seconds_home(now, left);
        if needed > left {
            self.turn_back(ReturnReason::Time);
            // The time does not suffice for a search, unless it pays.
            self.radius = EXTENDED;
            // A way back along the track leads home already.
            self.leg.take_if(|leg| !leg.is_retreat);
        } else if self.search == Search::Idle && self.since_way_home > SEARCHED && needed > left - SEARCH {
            self.since_way_home = 0.0;
            (self.radius, self.is_unfinished, self.search) = (f64::INFINITY, true, Search::Running);
        }
    }

    /// What the way home takes at most, seconds: that of the last plan, which may turn out to be twice as long, or the track, which the robot has driven, if that matters.
    fn seconds_home<S: Space>(&self, now: &Situation<'_, S>, left: f64) -> f64 {
        let seconds = |metres: f64| metres / self.settings.speed * RESERVE.0 + RESERVE.1;
        let planned = seconds(2.0 * self.way_home);
        // The length of the track takes a look at all of it.
        if planned > left - SEARCH { planned.min(seconds(self.track_home(now))) } else { planned }
    }

    /// Ends the search with the plan that it is part of, or gives it up where the map is too large; returns whether it does that.
    pub(super) fn gives_up_search(&mut self, places: usize) -> bool {
        if self.search != Search::Running {
            return false;
        }
        if !self.is_unfinished {
            self.search = Search::Idle;
        } else if self.purpose == Purpose::Explore && places > MOST_SEARCHED {
            (self.search, self.radius) = (Search::TooLarge, EXTENDED);
            return true;
        }
        false
    }

    /// The way home along the track.
    pub(super) fn way_back(&self, robot: Point) -> Vec<Point> {
        let places: Vec<Point> = self.track.iter().map(|(place, _)| *place).collect();
        retreat::track(&places, robot)
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

    /// Whether it goes home and the map is known to have a way that is much shorter than the track.
    pub(super) fn has_shortcut_home<S: Space>(&self, now: &Situation<'_, S>) -> bool {
        self.purpose == Purpose::Return && SHORTER * self.way_home < self.track_home(now)
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
    fn a_search_ends_with_its_plan_or_where_the_map_is_too_large() {
        let search = |is_unfinished, purpose, places| {
            let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), [[0.0; 3], [9.0; 3]])).unwrap();
            (explorer.search, explorer.radius, explorer.is_unfinished, explorer.purpose) = (Search::Running, f64::INFINITY, is_unfinished, purpose);
            (explorer.gives_up_search(places), explorer.search, explorer.radius)
        };
        let (explore, home) = (Purpose::Explore, Purpose::Return);
        assert_eq!(search(true, explore, 1000), (false, Search::Running, f64::INFINITY));
        assert_eq!(search(false, explore, MOST_SEARCHED + 1), (false, Search::Idle, f64::INFINITY));
        assert_eq!(search(true, explore, MOST_SEARCHED + 1), (true, Search::TooLarge, EXTENDED));
        assert_eq!(
            search(true, home, MOST_SEARCHED + 1),
            (false, Search::Running, f64::INFINITY),
            "it has found a way, and its track would be too long"
        );
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
