//! A robot explores small rooms: everything, safely, and home in time; and what can go wrong.

use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, Scan};
use voxelastic::mapper::Mapper;
use voxelastic::query::UnknownAs;
use voxelastic::sensor::preset_with_columns;
use voxelastic::settings::{FieldKind, RobotRadius, Settings};
use voxelastic::{Cloud, Pose, field::occupancy::State};
use voxelastic_explore::{ExploreError, ExploreSettings, Explorer, FrontierSettings, Purpose, SensorView};
use voxelastic_plan::{Point, Robot, distance};
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{World, WorldBuilder};

const HOME: Point = [0.0, 0.0, 1.0];
const RADIUS: f64 = 0.25;
const BOUNDS: [Point; 2] = [[-3.0, -2.5, 0.3], [9.0, 2.5, 2.0]];

/// Two rooms of 6 x 5 m with a door 1.6 m wide between them, at x = 3, which may be shut; or a closet around the start.
fn rooms(is_shut: bool, is_closet: bool) -> World {
    rooms_with(is_shut, is_closet, None)
}

/// The same with a pole at a place.
fn rooms_with(is_shut: bool, is_closet: bool, pole: Option<Point>) -> World {
    let mut b = WorldBuilder::new("rooms", 1);
    b.ground(0.0, 0.3);
    let mut wall = |a: [f64; 2], c: [f64; 2]| b.cuboid([a[0], a[1], -0.5], [c[0], c[1], 3.0], 0.5);
    for y in [-3.5, 2.5] {
        wall([-4.0, y], [10.0, y + 1.0]);
    }
    for x in [-4.0, 9.0] {
        wall([x, -3.5], [x + 1.0, 3.5]);
    }
    wall([2.8, -2.5], [3.2, -0.8]);
    wall([2.8, 0.8], [3.2, 2.5]);
    if is_shut {
        wall([2.8, -0.8], [3.2, 0.8]);
    }
    if is_closet {
        [[-0.8, -0.8], [0.6, -0.8]].into_iter().for_each(|low| wall(low, [low[0] + 0.2, 0.8]));
        [[-0.8, -0.8], [-0.8, 0.6]].into_iter().for_each(|low| wall(low, [0.8, low[1] + 0.2]));
    }
    if let Some([x, y, _]) = pole {
        b.cuboid([x - 0.1, y - 0.1, -0.5], [x + 0.1, y + 0.1, 3.0], 0.5);
    }
    b.cuboid([-4.0, -3.5, 2.6], [10.0, 3.5, 3.0], 0.7);
    b.build().unwrap()
}

fn settings() -> ExploreSettings {
    let robot = Robot { radius: RADIUS + 0.1, unknown: UnknownAs::Blocked, ground: None };
    ExploreSettings { least_volume: 1.0, ..ExploreSettings::new(robot, BOUNDS) }
}

/// A corridor of 100 m from home on, 3 m wide.
fn corridor() -> World {
    let mut b = WorldBuilder::new("corridor", 1);
    b.ground(0.0, 0.3);
    for (low, high) in [([-3.0, -2.0], [101.0, -1.5]), ([-3.0, 1.5], [101.0, 2.0]), ([-3.0, -2.0], [-2.5, 2.0]), ([100.0, -2.0], [101.0, 2.0])] {
        b.cuboid([low[0], low[1], -0.5], [high[0], high[1], 3.0], 0.5);
    }
    b.cuboid([-3.0, -2.0, 2.6], [101.0, 2.0, 3.0], 0.7);
    b.build().unwrap()
}

/// A robot that is where it believes to be, but for its height.
struct Walker {
    mapper: Mapper,
    lidar: Lidar,
    position: Point,
    /// It believes to be this much higher for each metre along x.
    rise: f64,
    /// And this much higher everywhere, metres.
    raised: f64,
    scans: u64,
    travelled: f64,
    /// Least true distance of its centre from a surface.
    least: f64,
}

impl Walker {
    fn new() -> Self {
        Self::with("os0-32", 256, 0.2)
    }

    fn with(sensor: &str, columns: usize, voxel_size: f32) -> Self {
        let model = preset_with_columns(sensor, columns).unwrap();
        let robot_radius = RobotRadius::Metres(0.9);
        let settings = Settings { voxel_size, max_range: 15.0, field: FieldKind::Occupancy, robot_radius, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        mapper.set_sensor_model(model.clone());
        Self {
            mapper,
            lidar: Lidar::new(model, LidarSettings::default()).unwrap(),
            position: HOME,
            rise: 0.0,
            raised: 0.0,
            scans: 0,
            travelled: 0.0,
            least: f64::INFINITY,
        }
    }

    /// Where it is when it believes to be at `p`.
    fn at(&self, p: Point) -> Point {
        [p[0], p[1], p[2] - self.rise * p[0] - self.raised]
    }

    /// Returns the scan and where it believes that it was taken.
    fn scan(&mut self, world: &World) -> (Pose, Cloud) {
        let pose = Pose::translation(self.position[0], self.position[1], self.position[2]);
        let [x, y, z] = self.at(self.position);
        let cloud = self.lidar.scan(world, |_| Pose::translation(x, y, z), &Stream::new(self.scans, &[]));
        self.mapper.handle(Event::Scan(Scan { node: self.scans, time: self.scans as f64, t_map_lidar: pose, cloud: cloud.clone() })).unwrap();
        self.scans += 1;
        (pose, cloud)
    }

    /// Explores until it is done, at most `decisions` times; `world` by the number of the decision. Returns the purposes in order.
    fn explore(
        &mut self,
        explorer: &mut Explorer,
        decisions: usize,
        seconds: Option<f64>,
        mut world: impl FnMut(usize, Point) -> World,
    ) -> Vec<Purpose> {
        let mut purposes = vec![Purpose::Explore];
        for decision in 0..decisions {
            let world = world(decision, self.position);
            let (pose, cloud) = self.scan(&world);
            explorer.see(&pose, &cloud);
            let left = seconds.map(|seconds| seconds - self.travelled / explorer.settings().speed);
            let decided = explorer.decide(self.mapper.atlas(), self.position, left).unwrap();
            if purposes.last() != Some(&decided.purpose) {
                purposes.push(decided.purpose);
            }
            if decided.purpose == Purpose::Done {
                assert!(!decided.is_unfinished, "nothing is left to plan");
                break;
            }
            for _ in 0..8 {
                let Some(next) = explorer.advance(0.1) else { break };
                self.travelled += distance(self.position, next);
                self.position = next;
                self.least = self.least.min(world.distance(self.at(next)));
            }
        }
        purposes
    }

    fn atlas(&self) -> &Atlas {
        self.mapper.atlas()
    }

    /// Share of the free space of both rooms that is known to be free.
    fn known(&self, world: &World) -> f64 {
        let [low, high] = BOUNDS;
        let axis = |k: usize| (0..((high[k] - low[k]) / 0.3) as usize).map(move |i| low[k] + 0.15 + 0.3 * i as f64);
        let all: Vec<Point> =
            axis(0).flat_map(|x| axis(1).flat_map(move |y| axis(2).map(move |z| [x, y, z]))).filter(|p| world.distance(*p) > 0.3).collect();
        let states = self.atlas().query().unwrap().states(&all);
        states.iter().filter(|state| **state == State::Free).count() as f64 / all.len() as f64
    }
}

#[test]
fn it_sees_both_rooms_touches_nothing_and_comes_home() {
    let world = rooms(false, false);
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
    let purposes = walker.explore(&mut explorer, 200, None, |_, _| world.clone());
    // It tries once more from home: what counted as shut may not be so in the map of then.
    let once = [Purpose::Explore, Purpose::Return, Purpose::Done];
    let again = [Purpose::Explore, Purpose::Return, Purpose::Explore, Purpose::Return, Purpose::Done];
    assert!(purposes == once || purposes == again, "at {:?}: {purposes:?}", walker.position);
    assert!(distance(walker.position, HOME) < 1.0, "{:?}", walker.position);
    assert!(walker.least > RADIUS, "{} m from a wall", walker.least);
    assert!(walker.known(&world) > 0.97, "{} known", walker.known(&world));
    assert!(walker.travelled > 8.0 && walker.travelled < 120.0, "{} m", walker.travelled);
}

#[test]
fn the_same_map_gives_the_same_way() {
    let world = rooms(false, false);
    let runs = [1, 3].map(|threads| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
            walker.explore(&mut explorer, 12, None, |_, _| world.clone());
            (walker.position, walker.travelled)
        })
    });
    assert_eq!(runs[0], runs[1]);
}

#[test]
fn a_robot_with_little_time_turns_back() {
    let world = rooms(false, false);
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
    let purposes = walker.explore(&mut explorer, 200, Some(17.0), |_, _| world.clone());
    assert_eq!(purposes.last(), Some(&Purpose::Done));
    assert!(distance(walker.position, HOME) < 1.0 && walker.travelled / 2.0 < 17.0, "{:?} after {} m", walker.position, walker.travelled);
}

#[test]
fn a_closet_has_nothing_to_explore() {
    let world = rooms(false, true);
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
    let purposes = walker.explore(&mut explorer, 60, None, |_, _| world.clone());
    assert_eq!(purposes.last(), Some(&Purpose::Done));
    assert!(walker.travelled < 3.0 && walker.least > 0.2, "{} m travelled, {} m from a wall", walker.travelled, walker.least);
}

#[test]
fn a_door_that_shuts_behind_the_robot_is_found_shut() {
    let shut_at = std::cell::Cell::new(None);
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
    let purposes = walker.explore(&mut explorer, 300, None, |decision, position| {
        if position[0] > 4.2 && shut_at.get().is_none() {
            shut_at.set(Some(decision));
        }
        rooms(shut_at.get().is_some(), false)
    });
    assert!(shut_at.get().is_some(), "it went through the door");
    assert_eq!(purposes.last(), Some(&Purpose::Done), "it notices that there is no way");
    assert!(walker.position[0] > 3.2 && walker.least > 0.2, "{:?}, {} m from a wall", walker.position, walker.least);
}

#[test]
fn a_door_that_opens_while_the_robot_goes_home_is_tried_again_from_there() {
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
    let (shut, unlocked) = (rooms(true, false), rooms(false, false));
    let (mut purposes, mut has_looked) = (vec![Purpose::Explore], false);
    while purposes.last() != Some(&Purpose::Done) && walker.scans < 400 {
        let has_opened = purposes.contains(&Purpose::Return);
        if has_opened && !has_looked && distance(walker.position, HOME) < 1.5 {
            // It looks at the door until the map has it open, but decides nothing meanwhile.
            (0..20).for_each(|_| drop(walker.scan(&unlocked)));
            has_looked = true;
        }
        let decided = walker.explore(&mut explorer, 1, None, |_, _| if has_opened { unlocked.clone() } else { shut.clone() });
        purposes.extend(decided.last().filter(|purpose| purposes.last() != Some(purpose)));
    }
    assert!(purposes.starts_with(&[Purpose::Explore, Purpose::Return, Purpose::Explore]), "{purposes:?}");
    assert!(walker.known(&unlocked) > 0.97 && distance(walker.position, HOME) < 1.0, "{} known, {purposes:?}", walker.known(&unlocked));
}

#[test]
fn a_robot_that_does_not_fit_where_it_stands_goes_back_along_its_track() {
    let pole = std::cell::Cell::new(None);
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
    let purposes = walker.explore(&mut explorer, 300, None, |_, position| {
        if position[0] > 4.2 && pole.get().is_none() {
            // Farther ahead than the robot is wide, nearer than it needs.
            pole.set(Some([position[0] + 0.42, position[1], 0.0]));
        }
        rooms_with(false, false, pole.get())
    });
    assert!(pole.get().is_some() && purposes.last() == Some(&Purpose::Done), "{purposes:?}");
    assert!(distance(walker.position, HOME) < 1.0, "{:?}", walker.position);
    assert!(walker.least > RADIUS, "{} m from a wall", walker.least);
}

#[test]
fn a_robot_whose_height_drifts_explores_a_long_corridor() {
    let world = corridor();
    let bounds = [[-2.0, -1.5, 0.3], [100.0, 1.5, 1.6]];
    let (mut walker, mut explorer) = (Walker::with("os0-64", 512, 0.1), Explorer::new(ExploreSettings { bounds, ..settings() }).unwrap());
    // At its end the floor of the map is 0.98 m higher than at home: the box as it was there leaves no room above it.
    walker.rise = 0.0098;
    let mut decisions = 0;
    while walker.position[0] < 94.0 && decisions < 350 {
        walker.explore(&mut explorer, 1, None, |_, _| world.clone());
        decisions += 1;
    }
    assert!(decisions < 350 && walker.least > RADIUS, "{:?} at {:?}, {} m from a wall", explorer.reason_to_return(), walker.position, walker.least);
}

#[test]
fn a_robot_that_a_correction_finds_above_the_box_comes_back_and_goes_on() {
    const RAISED: f64 = 0.5;
    let world = rooms(false, false);
    let bounds = [BOUNDS[0], [BOUNDS[1][0], BOUNDS[1][1], 1.6]];
    let (mut walker, mut explorer) =
        (Walker::with("os0-64", 512, 0.1), Explorer::new(ExploreSettings { bounds, least_volume: 0.3, ..settings() }).unwrap());
    walker.position[2] = 1.2;
    let mut poses = Vec::new();
    while walker.position[0] < 4.5 && walker.scans < 60 {
        let [x, y, z] = walker.position;
        poses.push((walker.scans, Pose::translation(x, y, z + RAISED)));
        walker.explore(&mut explorer, 1, None, |_, _| world.clone());
    }
    walker.mapper.handle(Event::PoseUpdate(poses)).unwrap();
    walker.position[2] += RAISED;
    walker.raised = RAISED;
    let is_back = |walker: &Walker| walker.position[2] + RADIUS < bounds[1][2];
    assert!(!is_back(&walker) && walker.position[0] > 4.5, "{:?}", walker.position);
    // Its track is above the box, too.
    for _ in 0..20 {
        assert_eq!(walker.explore(&mut explorer, 1, None, |_, _| world.clone()), [Purpose::Explore]);
        if is_back(&walker) {
            break;
        }
    }
    assert!(is_back(&walker), "{:?}", walker.position);
    let purposes = walker.explore(&mut explorer, 300, None, |_, _| world.clone());
    assert!(purposes.last() == Some(&Purpose::Done) && walker.least > RADIUS, "{purposes:?}, {} m from a wall", walker.least);
    assert!(distance(walker.position, [HOME[0], HOME[1], 1.2 + RAISED]) < 1.0, "{:?}", walker.position);
}

#[test]
fn a_robot_without_a_track_finds_its_way_home_in_the_whole_map() {
    // Two corridors side by side, joined at one end; home is at the other end of one, the robot at that of the other.
    let mut b = WorldBuilder::new("hairpin", 1);
    b.ground(0.0, 0.3);
    let walls = [
        ([-3.0, -2.0], [61.0, -1.5]),
        ([-3.0, 7.5], [61.0, 8.0]),
        ([-3.0, -2.0], [-2.5, 8.0]),
        ([60.5, -2.0], [61.0, 8.0]),
        ([1.5, 1.5], [61.0, 4.5]),
    ];
    for (low, high) in walls {
        b.cuboid([low[0], low[1], -0.5], [high[0], high[1], 3.0], 0.5);
    }
    b.cuboid([-3.0, -2.0, 2.6], [61.0, 8.0, 3.0], 0.7);
    let world = b.build().unwrap();
    let bounds = [[-2.0, -1.5, 0.3], [60.0, 7.5, 1.6]];
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(ExploreSettings { bounds, ..settings() }).unwrap());
    let home = [58.0, 0.0, 1.0];
    walker.position = home;
    walker.explore(&mut explorer, 1, None, |_, _| world.clone());
    // Somebody carries it around, mapping, without a word to the explorer.
    for [x, y] in (0..30).map(|k| [58.0 - 2.0 * f64::from(k), 0.0]).chain([[0.0, 3.0]]).chain((0..30).map(|k| [2.0 * f64::from(k), 6.0])) {
        walker.position = [x, y, 1.0];
        walker.scan(&world);
    }
    explorer.return_home();
    let purposes = walker.explore(&mut explorer, 600, None, |_, _| world.clone());
    assert!(purposes.last() == Some(&Purpose::Done) && distance(walker.position, home) < 1.0, "{purposes:?} at {:?}", walker.position);
    assert!(walker.least > RADIUS, "{} m from a wall", walker.least);
}

#[test]
fn a_robot_with_a_long_track_turns_back_when_its_time_suffices_for_a_shorter_way() {
    let world = corridor();
    let bounds = [[-2.0, -1.5, 0.3], [100.0, 1.5, 1.6]];
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(ExploreSettings { bounds, ..settings() }).unwrap());
    // It comes to and fro across the corridor: 80 m from home, along a track of 229 m.
    for k in 0..108 {
        walker.position = [0.75 * f64::from(k), if k % 2 == 0 { -1.0 } else { 1.0 }, 1.0];
        let (pose, cloud) = walker.scan(&world);
        explorer.see(&pose, &cloud);
        explorer.decide(walker.atlas(), walker.position, None).unwrap();
    }
    let mut decide = |seconds_left| explorer.decide(walker.atlas(), walker.position, Some(seconds_left)).unwrap().purpose;
    // The track takes 142 s with what is kept in reserve, the length of the corridor 70.
    assert_eq!([155.0, 120.0, 75.0, 65.0].map(&mut decide), [Purpose::Explore, Purpose::Explore, Purpose::Explore, Purpose::Return]);
    let purposes = walker.explore(&mut explorer, 600, Some(65.0), |_, _| world.clone());
    assert!(purposes.last() == Some(&Purpose::Done) && distance(walker.position, HOME) < 1.0, "{purposes:?} at {:?}", walker.position);
    assert!(walker.travelled < 95.0 && walker.least > RADIUS, "{} m, {} m from a wall", walker.travelled, walker.least);
}

#[test]
fn another_robot_goes_on_in_a_map_that_is_there() {
    let world = rooms(false, false);
    let (mut walker, mut explorer) = (Walker::new(), Explorer::new(settings()).unwrap());
    walker.explore(&mut explorer, 4, None, |_, _| world.clone());
    let before = walker.known(&world);
    let mut another = Explorer::new(settings()).unwrap();
    let home = walker.position;
    let purposes = walker.explore(&mut another, 200, None, |_, _| world.clone());
    assert_eq!(purposes.last(), Some(&Purpose::Done));
    assert!(walker.known(&world) > before.max(0.97) && distance(walker.position, home) < 1.0);
}

#[test]
fn impossible_settings_and_maps_without_occupancy_are_refused() {
    let good = settings();
    let bad = [
        ExploreSettings { speed: 0.0, ..good },
        ExploreSettings { spacing: f64::NAN, ..good },
        ExploreSettings { margin: good.robot.radius, ..good },
        ExploreSettings { margin: -0.1, ..good },
        ExploreSettings { least_volume: -1.0, ..good },
        ExploreSettings { bounds: [BOUNDS[1], BOUNDS[0]], ..good },
        ExploreSettings { robot: Robot::flying(-1.0), ..good },
        ExploreSettings { view: SensorView { range: 0.0, ..good.view }, ..good },
    ];
    for settings in bad {
        assert!(Explorer::new(settings).is_err(), "{settings:?}");
    }
    let refused = Explorer::new(ExploreSettings { frontier: FrontierSettings::default(), ..good }).unwrap().decide(&Atlas::new(0.2), HOME, None);
    assert!(matches!(refused, Err(ExploreError::NoOccupancy)));
}
