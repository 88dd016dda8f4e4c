//! Plans of an explorer: the next target and the path there, or back when there is none.

use super::{EXTENDED, Explorer, Situation};
use crate::decision::{Purpose, ReturnReason};
use crate::near_returns;
use crate::routes::leg::Leg;
use crate::routes::retreat;
use crate::routes::roadmap::Roadmap;
use crate::routes::shortcuts::short_way;
use crate::routes::ways::Part;
use crate::settings::NOISE;
use crate::targets::choice::choose;
use crate::targets::clusters::FrontierCluster;
use crate::targets::viewpoints::{Viewpoint, viewpoints};
use hashbrown::HashSet;
use voxelastic_plan::{Effort, Point, Space, anchor_path, distance, length, recheck, shorten};

/// Tries to find a path that is still free.
const TRIES: usize = 6;
/// Plans in a row that led nowhere, after which the robot goes back along its track.
const STUCK_BEFORE_RETREAT: usize = 2;
/// The same, after which it goes home, looks everywhere, and ends.
const STUCK_BEFORE_END: usize = 6;
/// It goes back this far before it plans again, in spacings of the roadmap.
const RETREAT: f64 = 2.0;
/// After more ways back in a row it goes home: it cannot get where there is more to see.
const MOST_RETREATS: u32 = 4;
/// On its way home it goes back along its track this often, each time twice as far: after more the track is shut.
const MOST_WAYS_BACK: u32 = 12;
/// Times in a row that it begins anew where it found nothing more to see, as what counted as shut may not be so in the map of today.
pub(super) const MOST_BEGINNINGS: u32 = 2;
/// On the way home a roadmap is extended around the robot within this radius, metres, to twice as far away: as far as to the track.
const TO_TRACK: f64 = 5.0;
/// A roadmap is extended within twice this distance of the robot before everything that can be reached is added to it, metres.
const FARTHEST: f64 = 800.0;
/// Steps of the roadmap that are tried in one decision.
const MOST_STEPS: usize = 6_000;
/// Steps that were not free are tried again everywhere when the box has grown by this, metres.
const GROWN: f64 = 0.1;

impl Explorer {
    /// Plans a path; returns the number of viewpoints considered. Where that takes more steps of the roadmap than fit into one decision, the next one goes on with it, and until
    /// then the robot stays on its path, or where it is.
    pub(super) fn plan<S: Space>(&mut self, now: &Situation<'_, S>, frontier: &[FrontierCluster]) -> usize {
        let mut roadmap = self.roadmap.take().unwrap_or_else(|| Roadmap::new(self.settings.spacing, now.robot));
        self.retry(now, &mut roadmap);
        if self.purpose == Purpose::Return && !self.looks_everywhere {
            self.radius = TO_TRACK;
        }
        let count = self.plan_in(now, &mut roadmap, frontier);
        self.roadmap.get_or_insert(roadmap);
        if !self.is_unfinished {
            (self.radius, self.restarts) = (EXTENDED, 0);
            self.note_progress(now);
        }
        count
    }

    /// Steps of the roadmap that this decision tries at most: more where corrections have thrown unfinished ones away, or a map that bends with every scan would leave no time
    /// for any plan.
    fn steps(&self) -> usize {
        MOST_STEPS << self.restarts.min(10)
    }

    fn plan_in<S: Space>(&mut self, now: &Situation<'_, S>, roadmap: &mut Roadmap, frontier: &[FrontierCluster]) -> usize {
        if self.beginnings > 0 || self.purpose == Purpose::Return {
            self.link(now, roadmap);
        }
        if self.purpose == Purpose::Return {
            // The way home may lead through what was found shut on the way out.
            roadmap.unblock();
        }
        self.is_unfinished = !roadmap.extend(now.space, now.robot, self.radius, self.steps());
        if self.is_unfinished {
            return 0;
        }
        let current = self.leg.take().filter(|leg| leg.volume.is_some()).and_then(|leg| leg.end());
        let mut count = 0;
        for attempt in 0..TRIES {
            let target = match self.purpose {
                Purpose::Explore => {
                    let worth = self.worthwhile(now, roadmap, frontier);
                    count = count.max(worth.len());
                    let target = choose(&self.settings, now.space, roadmap, &worth, current);
                    if attempt == 0 && self.goes_far(now, frontier, target.as_ref()) {
                        break;
                    }
                    if target.is_none() {
                        // On a later attempt, what was found shut just now may be all that led on: the next plan looks farther.
                        self.is_unfinished = attempt == 0 && self.look_farther(now, roadmap);
                        break;
                    }
                    target
                }
                _ => None,
            };
            if self.try_way(now, roadmap, target) {
                break;
            }
        }
        count
    }

    /// Has the roadmap try again what was not free, where the map or the returns around the robot have changed since the last plan began, or the box has grown. Not while a plan
    /// goes on, or it would never be done where each scan changes something.
    fn retry<S: Space>(&mut self, now: &Situation<'_, S>, roadmap: &mut Roadmap) {
        if self.is_unfinished {
            return;
        }
        let is_elsewhere = self.is_outside || (self.drift() - self.tried_drift).abs() > GROWN;
        if is_elsewhere {
            self.tried_drift = self.drift();
        }
        roadmap.retry((!is_elsewhere).then(|| self.changed.widened()).as_ref());
        self.changed.clear();
        // The returns that count are others at the next plan.
        self.changed.add(now.robot, near_returns::REACH);
    }

    /// After some plans that lead nowhere the robot goes back along its track, as the map may say that it does not fit where it stands. After some more it goes home; then it
    /// looks for any way home in the whole map, and then it ends: it is shut in. The map may show more after another scan.
    fn note_progress<S: Space>(&mut self, now: &Situation<'_, S>) {
        let leads_on = self.leg.as_ref().and_then(Leg::end).is_some_and(|end| distance(end, now.robot) > 0.3 * self.settings.spacing);
        self.stuck = if leads_on { 0 } else { self.stuck + 1 };
        if self.stuck >= STUCK_BEFORE_RETREAT {
            self.retreat(now);
        }
        match self.purpose {
            Purpose::Explore if self.stuck >= STUCK_BEFORE_END => self.turn_back(ReturnReason::Stuck),
            Purpose::Return if self.stuck >= STUCK_BEFORE_END && !self.looks_everywhere => {
                (self.looks_everywhere, self.is_unfinished, self.stuck) = (true, true, 0);
                (self.roadmap, self.radius) = (None, f64::INFINITY);
            }
            Purpose::Return if self.stuck >= STUCK_BEFORE_END => self.purpose = Purpose::Done,
            _ => {}
        }
    }

    /// Forgets what it took for shut, if that may help: false if it did so some times and got nowhere since.
    pub(super) fn begin_anew(&mut self) -> bool {
        let may_help = !matches!(self.turned_back, Some(ReturnReason::Time | ReturnReason::Asked)) && self.beginnings < MOST_BEGINNINGS;
        if may_help {
            (self.roadmap, self.retreats, self.stuck) = (None, 0, 0);
            self.beginnings += 1;
        }
        may_help
    }

    /// It goes home from now on, with all its patience: what led nowhere so far led elsewhere.
    pub(super) fn turn_back(&mut self, reason: ReturnReason) {
        if self.purpose == Purpose::Explore {
            (self.purpose, self.stuck, self.turned_back) = (Purpose::Return, 0, Some(reason));
            (self.looks_everywhere, self.since_turned) = (false, 0.0);
        }
    }

    /// A path back along the track, if there is one, as far as the next plan needs.
    fn retreat<S: Space>(&mut self, now: &Situation<'_, S>) {
        let track = self.way_back(now.robot);
        let mut path = retreat::passable(now.map, now.returns, &track, [self.settings.robot.radius, self.body(now)]);
        // Each way back is twice as long as the one before, so that it ends somewhere else, and at last at home.
        retreat::cut(&mut path, RETREAT * self.settings.spacing * 2f64.powi(self.retreats.min(20) as i32));
        if length(&path) <= 0.5 * self.settings.spacing {
            return;
        }
        match self.purpose {
            Purpose::Explore => self.exhausted.push((now.robot, anchor_path(now.atlas, &[now.robot]))),
            // The whole track leads home, if nothing has shut it since.
            _ if self.retreats < MOST_WAYS_BACK => self.stuck = 0,
            _ => {}
        }
        self.retreats += 1;
        if self.retreats > MOST_RETREATS {
            self.turn_back(ReturnReason::Stuck);
        }
        self.leg = Some(Leg::back(now.atlas, path));
    }

    /// Radius that has to be free where the margin is used up, metres; less where something has come too near to it, so that it may go where that is no nearer.
    pub(super) fn body<S: Space>(&self, now: &Situation<'_, S>) -> f64 {
        self.settings.narrowest().min(now.returns.nearest(now.robot) - NOISE).max(0.0)
    }

    /// Where no place within reach of the roadmap is worth a visit: has the next decision plan with one that reaches farther, with a new one, or the way home. False if the
    /// robot stands where it does not fit, which says nothing about what is left to see.
    fn look_farther<S: Space>(&mut self, now: &Situation<'_, S>, roadmap: &mut Roadmap) -> bool {
        if !roadmap.ways(now.space, now.robot).lead_anywhere() {
            return false;
        }
        while self.radius.is_finite() {
            // Farther and farther, so that in a large map this takes as long as what is left is far.
            self.radius = if self.radius < FARTHEST { 2.0 * self.radius } else { f64::INFINITY };
            if !roadmap.is_extended(now.robot, self.radius) {
                return true;
            }
        }
        if self.begin_anew() {
            *roadmap = Roadmap::new(self.settings.spacing, now.robot);
        } else {
            self.turn_back(ReturnReason::NothingLeft);
        }
        true
    }

    /// Makes the way to a target, or home without one, its path if that is still free; if it is not, the roadmap has it no more. Returns whether no other one needs to be
    /// tried.
    fn try_way<S: Space>(&mut self, now: &Situation<'_, S>, roadmap: &mut Roadmap, target: Option<Viewpoint>) -> bool {
        let (ways, home) = (roadmap.ways(now.space, now.robot), self.home_or(now.robot));
        let near_home = || roadmap.near(home, 3.0 * self.settings.spacing).into_iter().find(|node| ways.length(*node).is_finite());
        let Some(node) = target.map(|viewpoint| viewpoint.node).or_else(near_home) else { return true };
        let part = ways.first_part(roadmap, node);
        if part.is_track {
            if self.purpose == Purpose::Explore && self.retreats >= MOST_RETREATS {
                self.turn_back(ReturnReason::Stuck);
                return true;
            }
            self.follow_track(now, &part);
            if self.leg.is_none() {
                roadmap.unlink(part.link);
            }
            return self.leg.is_some();
        }
        let mut path = part.path;
        if part.is_whole && target.is_none() && now.space.connects(roadmap.place(node), home) {
            path.push(home);
        }
        let path = Leg::trace(now.space, &shorten(now.space, path, Effort::Quick));
        match recheck(now.space, now.map, &path).first() {
            None => {
                let volume = target.filter(|_| part.is_whole).map(|viewpoint| viewpoint.volume.possible);
                self.leg = Some(Leg::new(now.atlas, path, volume));
                true
            }
            Some(blocked) => {
                roadmap.block(now.space, blocked.at);
                false
            }
        }
    }

    /// The viewpoints from which there is something to see, and from which the robot still gets home in time, that the roadmap reaches as it is.
    fn worthwhile<S: Space>(&mut self, now: &Situation<'_, S>, roadmap: &Roadmap, frontier: &[FrontierCluster]) -> Vec<Viewpoint> {
        let (ways, ways_home) = (roadmap.ways(now.space, now.robot), roadmap.ways(now.space, self.home_or(now.robot)));
        let near = roadmap.near(now.robot, 1.5 * self.settings.spacing);
        self.note_way_home(near.into_iter().map(|node| ways_home.length(node)).fold(f64::INFINITY, f64::min));
        let reach = self.settings.spacing * 1.6;
        let (seconds_left, [low, high]) = (now.seconds_left, now.viewpoint_box);
        // Where the roadmap has no way home, the robot comes back to where it is and goes home from there.
        let from_here = self.track_home(now).min(self.way_home);
        let exhausted: HashSet<u32> = self.exhausted.iter().flat_map(|(place, _)| roadmap.near(*place, reach)).collect();
        let is_excluded = |node: u32| {
            let home = ways_home.length(node).min(ways.length(node) + from_here);
            let needed = self.seconds_for(ways.length(node) + home);
            let place = roadmap.place(node);
            let is_inside = (0..3).all(|k| (low[k]..=high[k]).contains(&place[k]));
            !is_inside || seconds_left.is_some_and(|left| needed > left) || exhausted.contains(&node)
        };
        viewpoints(now.map, (roadmap, &ways), &self.settings, now.robot, frontier.to_vec(), is_excluded)
    }

    /// Has the roadmap lead along the track, too, and on the way home across its shortcuts.
    fn link<S: Space>(&self, now: &Situation<'_, S>, roadmap: &mut Roadmap) {
        let track = self.places_of_track();
        roadmap.link(&track);
        if self.purpose == Purpose::Return && !roadmap.has_shortcuts() {
            short_way(now.space, &track, now.robot).shortcuts.into_iter().for_each(|ends| roadmap.shortcut(ends));
        }
    }

    /// Takes a part of its track as its path, as far as the last scans have it free; none if they do not.
    fn follow_track<S: Space>(&mut self, now: &Situation<'_, S>, part: &Part) {
        let path = retreat::passable(now.map, now.returns, &part.path, [self.settings.robot.radius, self.body(now)]);
        if length(&path) <= 0.5 * self.settings.spacing {
            return;
        }
        self.leg = Some(Leg::along(now.atlas, path));
        self.retreats += u32::from(self.purpose == Purpose::Explore);
    }

    /// Where home is; where the robot is if it has none yet.
    fn home_or(&self, robot: Point) -> Point {
        self.home.as_ref().map_or(robot, |home| home.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::ExploreSettings;
    use voxelastic_plan::Robot;

    #[test]
    fn corrections_that_never_cease_leave_time_for_a_plan() {
        let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), [[0.0; 3], [9.0; 3]])).unwrap();
        let steps = [0, 1, 4, 50].map(|restarts| {
            explorer.restarts = restarts;
            explorer.steps()
        });
        assert_eq!(steps, [6_000, 12_000, 96_000, 6_144_000]);
    }
}
