//! The explorer: decides after every scan whether to go on, where to go next, and when to go home.

mod far;
mod following;
mod plan;
mod way_home;

use crate::decision::{Decision, Purpose, ReturnReason};
use crate::last_scans::LastScans;
use crate::near_returns::NearReturns;
use crate::robot_space::{Clear, RobotSpace, newest_submaps};
use crate::routes::leg::Leg;
use crate::routes::retreat;
use crate::routes::roadmap::Roadmap;
use crate::settings::{ExploreError, ExploreSettings};
use crate::targets::clusters::FrontierCluster;
use crate::targets::columns::Columns;
use crate::targets::frontiers::Frontiers;
use std::time::Instant;
use voxelastic::atlas::{Atlas, SubmapId};
use voxelastic::event::NodeId;
use voxelastic::query::AtlasQuery;
use voxelastic::{Cloud, Pose};
use voxelastic_plan::{Anchor, FlyingSpace, GroundSpace, Point, Robot, Space, Wheels, anchor_path, distance, length, recheck, resolve_anchors};

/// The roadmap is extended around the robot within this radius at first, metres, to twice as far away.
const EXTENDED: f64 = 25.0;
/// What a step of the roadmap depends on is within so many spacings, and the robot's radius, of where it begins: it may lead to a corner of the lattice, and aside.
const COLUMN: f64 = 2.5;
/// A roadmap with more places is grown again around the robot when it gets where it wanted to.
const MOST_PLACES: usize = 100_000;
/// A target is given up when less than this share of the expected volume is left.
const LEFT: f64 = 0.35;
/// A path that is shut farther on is followed this far before it is planned anew, metres.
const GOES_ON: f64 = 2.0;
/// Decisions after which a path is planned anew although nothing is wrong with it.
const LONGEST_PLAN_AGE: usize = 6;
/// Until a loop closes, the map may be off by this share of the distance since the last correction ...
const DRIFT: f64 = 0.01;
/// ... and by at most this, metres.
const MOST_DRIFT: f64 = 1.0;

/// Decides where a robot goes to explore. See the [crate documentation](crate).
#[derive(Clone, Debug)]
pub struct Explorer {
    settings: ExploreSettings,
    frontiers: Frontiers,
    roadmap: Option<Roadmap>,
    /// It is extended around the robot within this radius, metres, to twice as far away.
    radius: f64,
    /// Where the map has changed since it was extended.
    changed: Columns,
    /// How far the map might have been off when everything that is not free was tried last, metres.
    tried_drift: f64,
    /// Whether the last decision left a plan to the next one.
    is_unfinished: bool,
    /// Corrections in a row that took the roadmap of an unfinished plan away.
    restarts: u32,
    /// Whether it has looked for a way home in the whole map since it turned back.
    looks_everywhere: bool,
    home: Option<(Point, Vec<Anchor>)>,
    /// Where it was at each decision.
    track: Vec<(Point, Vec<Anchor>)>,
    leg: Option<Leg>,
    scans: LastScans,
    /// The newest scan of the map at the last decision.
    last_node: Option<NodeId>,
    purpose: Purpose,
    /// Places from which everything was seen that can be seen, and their anchors.
    exhausted: Vec<(Point, Vec<Anchor>)>,
    /// Far places that it went to as there was more to see there, and their anchors.
    gone_to: Vec<(Point, Vec<Anchor>)>,
    /// Distance travelled since the map was corrected, metres.
    uncorrected: f64,
    /// Poses of the submaps at the last decision.
    poses: Vec<(SubmapId, Pose)>,
    /// Decisions since the path was planned.
    since_planned: usize,
    /// Plans in a row that led nowhere.
    stuck: usize,
    /// The way home takes at most this, metres: as the last plan found it, and what the robot has travelled since.
    way_home: f64,
    /// How far it has travelled since a plan found the way home, or it looked for shortcuts of its track, metres.
    since_way_home: f64,
    /// How far it has travelled since it turned back, metres.
    since_turned: f64,
    /// How often it has tried again on its way home since it last got where it wanted to.
    trials: u32,
    /// Ways back along the track since it last got where it wanted to.
    retreats: u32,
    /// How often it has begun anew since it last got where it wanted to.
    beginnings: u32,
    /// Whether it has seen something new since it left home.
    has_progressed: bool,
    /// Whether it was outside of the box to explore at the last decision.
    is_outside: bool,
    /// Why it turned back last.
    turned_back: Option<ReturnReason>,
}

/// What a decision is made of.
struct Situation<'a, S> {
    atlas: &'a Atlas,
    map: &'a AtlasQuery<'a>,
    /// Whether a correction has moved submaps since the last decision.
    is_moved: bool,
    returns: &'a NearReturns,
    space: &'a S,
    /// Corners of the box in which viewpoints are.
    viewpoint_box: [Point; 2],
    robot: Point,
    seconds_left: Option<f64>,
}

impl Explorer {
    /// An explorer; its home is where it decides first.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(settings: ExploreSettings) -> Result<Self, ExploreError> {
        settings.check()?;
        Ok(Self {
            frontiers: Frontiers::new(settings.frontier, settings.bounds),
            roadmap: None,
            radius: EXTENDED,
            changed: Columns::new(COLUMN * settings.spacing + settings.robot.radius),
            tried_drift: 0.0,
            is_unfinished: false,
            restarts: 0,
            looks_everywhere: false,
            home: None,
            track: Vec::new(),
            leg: None,
            scans: LastScans::default(),
            last_node: None,
            purpose: Purpose::Explore,
            exhausted: Vec::new(),
            gone_to: Vec::new(),
            uncorrected: 0.0,
            poses: Vec::new(),
            since_planned: 0,
            stuck: 0,
            way_home: f64::INFINITY,
            since_way_home: f64::INFINITY,
            since_turned: 0.0,
            trials: 0,
            retreats: 0,
            beginnings: 0,
            has_progressed: false,
            is_outside: false,
            turned_back: None,
            settings,
        })
    }

    /// Its settings.
    pub fn settings(&self) -> &ExploreSettings {
        &self.settings
    }

    /// Places of the roadmap.
    pub fn places(&self) -> usize {
        self.roadmap.as_ref().map_or(0, Roadmap::len)
    }

    /// Why it turned back last, if it has.
    pub fn reason_to_return(&self) -> Option<ReturnReason> {
        self.turned_back
    }

    /// Where the robot is after `metres` along its path, map frame; none if it has no path.
    pub fn advance(&mut self, metres: f64) -> Option<Point> {
        self.leg.as_mut()?.advance(metres)
    }

    /// Notes the last scan, which was taken at `t_map_lidar`: paths keep clear of its returns, and of those of the last two metres, also
    /// where the map does not show them yet. To be called before
    /// [`decide`](Self::decide), with the pose as corrections left it. Without it the map alone decides.
    pub fn see(&mut self, t_map_lidar: &Pose, cloud: &Cloud) {
        self.scans.push(t_map_lidar, cloud);
    }

    /// Decides what to do at `robot` (map frame, metres). To be called after every scan, and after every correction. `seconds_left` is the time until the robot must be
    /// at home.
    ///
    /// # Errors
    /// [`ExploreError::NoOccupancy`], and [`ExploreError::Robot`] for wheels that the map has no room for.
    pub fn decide(&mut self, atlas: &Atlas, robot: Point, seconds_left: Option<f64>) -> Result<Decision, ExploreError> {
        let clock = Instant::now();
        let map = AtlasQuery::new(atlas);
        if map.is_empty() {
            return Err(ExploreError::NoOccupancy);
        }
        self.frontiers.update(atlas);
        self.frontiers.changed().iter().for_each(|(centre, reach)| self.changed.add(*centre, *reach));
        let frontier = self.frontiers.clusters(atlas, &map);
        let frontier_time = clock.elapsed();
        let (robot_type, bounds) = (self.settings.robot, self.settings.bounds);
        let newest = newest_submaps(atlas);
        let [newest, recent] = [1, 2].map(|n| AtlasQuery::of_submaps(atlas, |submap| newest.iter().take(n).any(|recent| *recent == submap)));
        let narrow = self.settings.narrowest();
        let is_moved = self.follow_submaps(atlas);
        let step = self.step(robot);
        self.uncorrected = if is_moved { 0.0 } else { self.uncorrected + step };
        self.way_home += step;
        self.since_way_home += step;
        self.since_turned += step;
        // Where drift has moved what the newest submaps saw, the box is elsewhere in them.
        let drift = self.drift();
        let wider = [bounds[0].map(|c| c - drift), bounds[1].map(|c| c + drift)];
        // A correction may find the robot outside of the box, and there is its way back.
        let own = if robot_type.ground.is_some() { 0.0 } else { robot_type.radius };
        let viewpoint_box = shrunk(wider, own);
        let [bounds, wider] = [bounds, wider].map(|bounds| including(bounds, robot, own));
        if std::mem::replace(&mut self.is_outside, bounds != self.settings.bounds) != self.is_outside {
            self.roadmap = None;
        }
        let maps = [(&map, bounds), (&recent, wider), (&newest, wider)];
        let steepest = self.settings.view.steepest();
        let returns = self.scans.returns(steepest);
        let decided = if let Some(wheels) = robot_type.ground {
            let on = |(map, bounds), robot_type| GroundSpace::new(map, &robot_type, robot, bounds).map_err(ExploreError::Robot);
            // The whole map tells the height above the floor, for all of them.
            let ground = Some(Wheels { height: Some(on(maps[0], robot_type)?.height()), ..wheels });
            let clear = |radius| -> Result<_, ExploreError> {
                let [whole, recent, newest] = maps.map(|map| on(map, Robot { radius, ground, ..robot_type }));
                Ok(Clear::new([whole?, recent?, newest?], &returns, radius, steepest))
            };
            let space = &RobotSpace::new(clear(robot_type.radius)?, clear(narrow)?, robot);
            self.decide_in(&Situation { atlas, map: &map, is_moved, returns: &returns, space, viewpoint_box, robot, seconds_left }, &frontier)
        } else {
            let clear = |radius| {
                let space = |(map, bounds)| FlyingSpace::new(map, &Robot { radius, ..robot_type }, shrunk(bounds, radius));
                Clear::new(maps.map(space), &returns, radius, steepest)
            };
            let space = &RobotSpace::new(clear(robot_type.radius), clear(narrow), robot);
            self.decide_in(&Situation { atlas, map: &map, is_moved, returns: &returns, space, viewpoint_box, robot, seconds_left }, &frontier)
        };
        let (is_new, viewpoints) = decided;
        let path = self.leg.as_ref().filter(|_| self.purpose != Purpose::Done).map_or_else(Vec::new, |leg| leg.path.clone());
        Ok(Decision {
            purpose: self.purpose,
            path,
            is_new,
            is_unfinished: self.is_unfinished,
            frontier,
            viewpoints,
            frontier_time,
            time: clock.elapsed(),
        })
    }

    /// How far the robot has come from the last place of its track, metres; nothing if that is too near for another one, or standing would count as travelling.
    fn step(&self, robot: Point) -> f64 {
        let off = self.track.last().map_or(0.0, |(last, _)| distance(*last, robot));
        if off > 0.1 * self.settings.spacing { off } else { 0.0 }
    }

    /// How far the map may be off, as no loop has closed, metres: the box is larger by it in the newest submaps.
    fn drift(&self) -> f64 {
        (DRIFT * self.uncorrected).min(MOST_DRIFT)
    }

    /// Returns whether it planned, and the number of viewpoints considered.
    fn decide_in<S: Space>(&mut self, now: &Situation<'_, S>, frontier: &[FrontierCluster]) -> (bool, usize) {
        self.follow_map(now);
        if self.is_at_home(now) && self.purpose != Purpose::Explore {
            self.leg = None;
            self.note_way_home(self.settings.spacing);
            if self.purpose == Purpose::Return && self.leaves_again(now.seconds_left) {
                self.purpose = Purpose::Explore;
            } else {
                self.purpose = Purpose::Done;
                self.is_unfinished = false;
                return (false, 0);
            }
        }
        self.since_planned += 1;
        self.try_again();
        if self.purpose == Purpose::Explore {
            self.mind_the_time(now);
        }
        if !self.must_plan(now) && !self.is_unfinished {
            return (false, 0);
        }
        self.since_planned = 0;
        (true, self.plan(now, frontier))
    }

    /// Moves the last scans with the map; returns whether it has moved.
    fn follow_submaps(&mut self, atlas: &Atlas) -> bool {
        let poses: Vec<(SubmapId, Pose)> = atlas.submaps().iter().map(|submap| (submap.id(), submap.t_map_submap())).collect();
        let is_moved = self.poses.iter().any(|(id, pose)| poses.iter().any(|(other, now)| other == id && now != pose));
        self.poses = poses;
        let newest = atlas.newest_scan();
        if let Some(node) = newest.filter(|_| newest != self.last_node) {
            self.scans.set_node(node);
        }
        self.last_node = newest;
        if is_moved {
            self.scans.follow(|node| atlas.scan_pose(node));
        }
        is_moved
    }

    /// Moves everything else that is remembered with the map.
    fn follow_map<S: Space>(&mut self, now: &Situation<'_, S>) {
        let place = |place: Point| (place, anchor_path(now.atlas, &[place]));
        let robot = now.robot;
        self.home.get_or_insert_with(|| place(robot));
        if self.track.is_empty() || self.step(robot) > 0.0 {
            self.track.push(place(robot));
        }
        if now.is_moved {
            // Places of the roadmap do not move, so it is grown again.
            self.restarts += u32::from(self.is_unfinished);
            self.roadmap = None;
            // All at once: for one by one, each would look at all scans.
            let remembered = self.home.iter_mut().chain(&mut self.exhausted).chain(&mut self.gone_to).chain(&mut self.track);
            let mut anchored: Vec<&mut (Point, Vec<Anchor>)> = remembered.filter(|(_, anchors)| !anchors.is_empty()).collect();
            let anchors: Vec<Anchor> = anchored.iter().map(|(_, anchors)| anchors[0]).collect();
            for ((place, _), moved) in anchored.iter_mut().zip(resolve_anchors(now.atlas, &anchors)) {
                *place = moved.unwrap_or(*place);
            }
        }
        if self.leg.as_mut().is_some_and(|leg| !leg.follow(now.atlas, robot, now.is_moved)) {
            self.leg = None;
        }
    }

    /// Whether the path is done, blocked, not worth it, or old; or the time has come to go home.
    fn must_plan<S: Space>(&mut self, now: &Situation<'_, S>) -> bool {
        let Some(leg) = &self.leg else { return true };
        let Some(end) = leg.end() else { return true };
        if distance(end, now.robot) < 0.5 * self.settings.spacing {
            // Once: a plan that goes on may keep it here for many decisions.
            if self.leg.take().is_some_and(|leg| leg.volume.is_some()) {
                self.arrive(now.atlas, end);
            }
            return true;
        }
        if leg.is_track {
            let is_blocked = retreat::free_part(now.map, now.returns, &leg.path, self.body(now)) < leg.path.len();
            self.leg.take_if(|_| is_blocked);
            return is_blocked;
        }
        if let Some(blocked) = recheck(now.space, now.map, &leg.path).first() {
            if let Some(roadmap) = &mut self.roadmap {
                roadmap.block(now.space, blocked.at);
            }
            // Where it is free for a while it leads on, perhaps through a doorway that no other way leads through: it plans again a little farther on.
            let mut free = leg.path[..=blocked.segment].to_vec();
            retreat::cut(&mut free, GOES_ON);
            self.leg = (length(&free) > self.settings.spacing).then(|| Leg::new(now.atlas, free, None));
            return self.leg.is_none();
        }
        let ahead = length(&leg.path);
        match leg.volume {
            None => false,
            Some(_) if self.since_planned >= LONGEST_PLAN_AGE => true,
            Some(volume) => {
                let is_seen = self.settings.view.unknown_volume(now.map, end, self.settings.bounds) < LEFT * volume;
                self.has_progressed |= is_seen;
                is_seen || self.is_time_up(now, ahead)
            }
        }
    }

    /// Notes that it stands at the viewpoint that it went to.
    fn arrive(&mut self, atlas: &Atlas, viewpoint: Point) {
        (self.retreats, self.beginnings, self.trials, self.has_progressed) = (0, 0, 0, true);
        self.exhausted.push((viewpoint, anchor_path(atlas, &[viewpoint])));
        if !self.is_unfinished {
            self.roadmap.take_if(|roadmap| roadmap.len() > MOST_PLACES);
        }
    }

    /// Whether a plan has to be made because of the time: an upper bound of the way home that needs no search.
    fn is_time_up<S: Space>(&self, now: &Situation<'_, S>, ahead: f64) -> bool {
        now.seconds_left.is_some_and(|left| (ahead + 2.0 * EXTENDED) / self.settings.speed > left || self.since_planned >= LONGEST_PLAN_AGE / 2)
    }
}

/// The box with the corners `low` and `high`, larger where a ball of `radius` metres around `p` is not in it, by a millimetre more for rounding.
fn including([low, high]: [Point; 2], p: Point, radius: f64) -> [Point; 2] {
    let lower = |k: usize| if p[k] - radius < low[k] { p[k] - radius - 1e-3 } else { low[k] };
    let higher = |k: usize| if p[k] + radius > high[k] { p[k] + radius + 1e-3 } else { high[k] };
    [std::array::from_fn(lower), std::array::from_fn(higher)]
}

/// The box in which the centre of a ball may be that stays in the box with the corners `low` and `high`; the middle along an axis where it has no room.
fn shrunk([low, high]: [Point; 2], radius: f64) -> [Point; 2] {
    let room = |k: usize| (0.5 * (high[k] - low[k])).min(radius);
    [std::array::from_fn(|k| low[k] + room(k)), std::array::from_fn(|k| high[k] - room(k))]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing but free space.
    struct Open;

    impl Space for Open {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            self.state_at(from).and_then(|_| self.state_at(to))
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            p.iter().all(|c| c.abs() < 20.0).then_some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-20.0; 3], [20.0; 3]]
        }
    }

    #[test]
    fn a_path_that_is_shut_farther_on_is_followed_for_a_while() {
        let atlas = Atlas::new(0.1);
        let (map, returns) = (atlas.query().unwrap(), NearReturns::default());
        let now = Situation {
            atlas: &atlas,
            map: &map,
            is_moved: false,
            returns: &returns,
            space: &Open,
            viewpoint_box: Open.bounds(),
            robot: [0.0; 3],
            seconds_left: None,
        };
        let followed = |path: &[Point]| {
            let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), Open.bounds())).unwrap();
            explorer.leg = Some(Leg::new(&atlas, path.to_vec(), Some(30.0)));
            (explorer.must_plan(&now), explorer.leg.map(|leg| (leg.path, leg.volume)))
        };
        // Nothing is free beyond 20 m.
        let path = [[0.0; 3], [3.0, 0.0, 0.0], [3.0, 6.0, 0.0], [30.0, 6.0, 0.0]];
        assert_eq!(followed(&path), (false, Some((vec![[0.0; 3], [GOES_ON, 0.0, 0.0]], None))));
        assert_eq!(followed(&[[0.0; 3], [1.2, 0.0, 0.0], [30.0, 0.0, 0.0]]), (false, Some((vec![[0.0; 3], [1.2, 0.0, 0.0]], None))));
        assert_eq!(followed(&[[0.0; 3], [0.3, 0.0, 0.0], [30.0, 0.0, 0.0]]), (true, None), "that is hardly a way");
    }

    #[test]
    fn standing_is_not_travelling() {
        let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), [[-20.0; 3], [20.0; 3]])).unwrap();
        assert_eq!(explorer.step([1.0; 3]), 0.0, "it begins here");
        explorer.track.push(([0.0; 3], Vec::new()));
        assert_eq!([0.0, 0.05, 0.5].map(|x| explorer.step([x, 0.0, 0.0])), [0.0, 0.0, 0.5]);
    }

    #[test]
    fn a_large_roadmap_is_left_for_a_new_one_but_not_while_a_plan_makes_it() {
        let mut explorer = Explorer::new(ExploreSettings::new(Robot::flying(0.4), [[-20.0; 3], [20.0; 3]])).unwrap();
        let mut roadmap = Roadmap::new(0.6, [0.0; 3]);
        roadmap.extend_all(&Open, [0.0; 3], f64::INFINITY);
        assert!(roadmap.len() > MOST_PLACES);
        explorer.roadmap = Some(roadmap);
        explorer.is_unfinished = true;
        explorer.arrive(&Atlas::new(0.1), [0.0; 3]);
        assert!(explorer.places() > MOST_PLACES);
        explorer.is_unfinished = false;
        explorer.arrive(&Atlas::new(0.1), [0.0; 3]);
        assert_eq!(explorer.places(), 0);
    }
}
