//! A robot that knows nothing but what is published: it follows the path, scans, and gets the next one, until all is explored and it is at home.

use crate::common::published::{Point, Published};
use std::time::{Duration, Instant};
use voxelastic::event::{Event, Scan};
use voxelastic::field::occupancy::State;
use voxelastic::sensor::preset_with_columns;
use voxelastic::settings::{FieldKind, RobotRadius, Settings};
use voxelastic::{Mapper, Pose};
use voxelastic_live::planner::{Command, LivePlanner, Plan, PlanState, PlannerSettings};
use voxelastic_live::ros::names::Names;
use voxelastic_live::ros::output::{OutputOptions, Outputs};
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{World, WorldBuilder};
use voxelastic_testing::PATIENCE;

const HOME: Point = [0.0, 0.0, 1.0];
const RADIUS: f64 = 0.25;
const BOUNDS: [Point; 2] = [[-3.0, -2.5, 0.3], [9.0, 2.5, 2.0]];
/// Metres that the robot moves between two scans: 2 m/s, 10 scans a second.
const STEP: f64 = 0.2;

/// Two rooms of 6 x 5 m with a door 1.6 m wide between them, at x = 3, and perhaps a pillar in the second one.
fn rooms(has_pillar: bool) -> World {
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
    if has_pillar {
        wall([5.8, -0.4], [6.6, 0.4]);
    }
    b.cuboid([-4.0, -3.5, 2.6], [10.0, 3.5, 3.0], 0.7);
    b.build().unwrap()
}

fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// A node that maps and plans, and a robot in a world that is where it believes to be.
struct Run {
    world: World,
    lidar: Lidar,
    mapper: Mapper,
    outputs: Outputs,
    published: Published,
    planner: LivePlanner,
    position: Point,
    /// The path that it follows, and what is ahead of it.
    path: Vec<Point>,
    ahead: Vec<Point>,
    scans: u64,
    travelled: f64,
    /// Least distance of its centre from a surface, metres.
    least: f64,
    plan: Plan,
    states: Vec<PlanState>,
}

impl Run {
    fn new(world: World, time: Option<f64>) -> Self {
        let model = preset_with_columns("os0-32", 256).unwrap();
        let robot_radius = RobotRadius::Metres(0.9);
        let settings = Settings { voxel_size: 0.2, max_range: 15.0, field: FieldKind::Occupancy, robot_radius, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        mapper.set_sensor_model(model.clone());
        let published = Published::default();
        let mut outputs = Outputs::new(OutputOptions { explores: true, ..OutputOptions::default() });
        outputs.add_sinks(&Names::of_node("robot"), |profile| Ok(published.topic(&profile.name))).unwrap();
        let planner =
            PlannerSettings { radius: RADIUS, margin: 0.1, height: None, speed: 2.0, bounds: Some(BOUNDS), time, max_range: 15.0, least_volume: 1.0 };
        Self {
            world,
            lidar: Lidar::new(model, LidarSettings::default()).unwrap(),
            mapper,
            outputs,
            published,
            planner: LivePlanner::start(planner, 2).unwrap(),
            position: HOME,
            path: Vec::new(),
            ahead: Vec::new(),
            scans: 0,
            travelled: 0.0,
            least: f64::INFINITY,
            plan: Plan::default(),
            states: Vec::new(),
        }
    }

    /// Maps a scan, as a node does.
    fn scan(&mut self) {
        let [x, y, z] = self.position;
        let pose = Pose::translation(x, y, z);
        let cloud = self.lidar.scan(&self.world, |_| pose, &Stream::new(self.scans, &[]));
        let scan = Scan { node: self.scans, time: 0.1 * self.scans as f64, t_map_lidar: pose, cloud };
        self.scans += 1;
        self.planner.add_scan(&scan, 0.1);
        self.outputs.add_scan(scan.node, scan.time);
        self.event(Event::Scan(scan));
    }

    fn event(&mut self, event: Event) {
        self.mapper.handle(event).unwrap();
        self.outputs.note(&self.mapper, None);
        self.planner.note();
    }

    /// Has a plan made of the map as it is, and publishes it.
    fn wait_for_plan(&mut self) {
        let begin = Instant::now();
        let mut was_asked = false;
        loop {
            if let Some(plan) = self.planner.plan() {
                let plan = plan.unwrap();
                self.outputs.publish_plan(self.mapper.atlas(), &plan);
                if self.states.last() != Some(&plan.state) {
                    self.states.push(plan.state);
                }
                self.plan = plan;
                if was_asked {
                    return;
                }
            }
            was_asked |= self.planner.step(self.mapper.atlas()).is_some();
            assert!(begin.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn move_to(&mut self, to: Point) {
        let (from, length) = (self.position, distance(self.position, to));
        for k in 0..=10 {
            let at: Point = std::array::from_fn(|c| from[c] + 0.1 * f64::from(k) * (to[c] - from[c]));
            self.least = self.least.min(self.world.distance(at));
        }
        self.travelled += length;
        self.position = to;
    }

    /// Moves along the published path as far as between two scans.
    fn follow(&mut self) {
        let path = self.published.path();
        if path != self.path {
            self.ahead = path.clone();
            self.path = path;
        }
        let mut left = STEP;
        while let Some(waypoint) = self.ahead.first().copied().filter(|_| left > 1e-6) {
            let (at, length) = (self.position, distance(self.position, waypoint));
            if length <= left {
                self.ahead.remove(0);
            }
            let share = if length > left { left / length } else { 1.0 };
            self.move_to(std::array::from_fn(|k| at[k] + share * (waypoint[k] - at[k])));
            left -= share * length;
        }
    }

    /// Follows what is published until it is done, at most `steps` times. A plan is there with every third scan, as with a slow one.
    fn explore(&mut self, steps: usize) {
        for step in 0..steps {
            self.scan();
            if step % 3 == 0 || self.published.path().len() < 2 {
                self.wait_for_plan();
            }
            if self.plan.state == PlanState::Done {
                break;
            }
            self.follow();
        }
    }

    /// Share of the free space of both rooms that is known to be free.
    fn known(&self) -> f64 {
        let [low, high] = BOUNDS;
        let axis = |k: usize| (0..((high[k] - low[k]) / 0.3) as usize).map(move |i| low[k] + 0.15 + 0.3 * i as f64);
        let all = axis(0).flat_map(|x| axis(1).flat_map(move |y| axis(2).map(move |z| [x, y, z])));
        let all: Vec<Point> = all.filter(|p| self.world.distance(*p) > 0.3).collect();
        let states = self.mapper.atlas().query().unwrap().states(&all);
        states.iter().filter(|state| **state == State::Free).count() as f64 / all.len() as f64
    }
}

#[test]
fn a_robot_that_follows_what_is_published_explores_all_and_comes_home() {
    let mut run = Run::new(rooms(true), None);
    run.explore(1200);
    assert_eq!((run.states.first(), run.plan.state), (Some(&PlanState::Exploring), PlanState::Done), "{:?} at {:?}", run.states, run.position);
    assert!(run.states.contains(&PlanState::Returning) && run.plan.reason.is_some() && run.published.path().is_empty());
    println!("{:.1} m, {} scans, {:.1} % known, {:.2} m from a wall", run.travelled, run.scans, 100.0 * run.known(), run.least);
    assert!(distance(run.position, HOME) < 1.0 && run.plan.from_home.is_some_and(|off| off < 1.0), "{:?}", run.position);
    assert!(run.least > RADIUS, "{} m from a wall", run.least);
    assert!(run.known() > 0.97, "{} known", run.known());
    assert!(run.travelled > 8.0 && run.travelled < 120.0, "{} m", run.travelled);
}

#[test]
fn a_robot_with_little_time_is_at_home_in_time() {
    let mut run = Run::new(rooms(false), Some(17.0));
    run.explore(400);
    assert_eq!(run.plan.state, PlanState::Done, "{:?}", run.position);
    assert!(distance(run.position, HOME) < 1.0 && run.scans <= 171, "{:?} after {} scans", run.position, run.scans);
}

#[test]
fn a_robot_that_somebody_drives_elsewhere_gets_a_path_from_there() {
    let mut run = Run::new(rooms(false), None);
    run.explore(6);
    assert!(run.published.path().len() > 1 && run.published.frontier().len() > 1 && run.published.goal() == run.published.path().last().copied());
    // Through the door and into a corner of the second room, whatever the plan is.
    for to in [[0.0, 0.0, 1.0], [4.5, 0.0, 1.0], [7.5, -1.5, 1.0]] {
        while distance(run.position, to) > 1e-3 {
            let (at, off) = (run.position, distance(run.position, to));
            run.move_to(std::array::from_fn(|k| at[k] + (STEP / off).min(1.0) * (to[k] - at[k])));
            run.scan();
            if run.scans.is_multiple_of(3) {
                run.wait_for_plan();
            }
        }
        run.wait_for_plan_of_now();
        let path = run.published.path();
        assert!(path.is_empty() || distance(path[0], run.position) < 1e-3, "{:?}, and not from {:?}", path, run.position);
    }
    assert!(matches!(run.plan.state, PlanState::Exploring | PlanState::Returning), "{:?}", run.plan.state);
    run.explore(1200);
    assert!(run.plan.state == PlanState::Done && distance(run.position, HOME) < 1.0 && run.known() > 0.97, "{:?}, {}", run.position, run.known());
}

impl Run {
    /// As [`wait_for_plan`](Self::wait_for_plan), after a scan from where the robot stands.
    fn wait_for_plan_of_now(&mut self) {
        self.scan();
        self.wait_for_plan();
    }
}

#[test]
fn the_published_path_moves_with_the_map_at_once() {
    let mut run = Run::new(rooms(false), None);
    run.explore(6);
    let (before, goal) = (run.published.path(), run.published.goal().unwrap());
    assert!(before.len() > 1);
    // It lies in what is published as free, once the grid of this map is made, on a thread of its own.
    let begin = Instant::now();
    let is_free = |(edge, width, corner, cells): (f64, usize, Point, Vec<i8>)| {
        let cell = |p: &Point| [0, 1].map(|k| ((p[k] - corner[k]) / edge) as usize);
        before.iter().map(cell).all(|[x, y]| cells[y * width + x] == 0)
    };
    while !run.published.grid().is_some_and(is_free) {
        assert!(begin.elapsed() < PATIENCE, "{before:?}");
        std::thread::sleep(Duration::from_millis(20));
        run.outputs.step(run.mapper.atlas());
    }
    let moved = (0..run.scans).map(|node| (node, Pose::translation(0.5, -0.25, 0.0) * run.mapper.pose(node).unwrap())).collect();
    run.event(Event::PoseUpdate(moved));
    // No plan was made since.
    let after = run.published.path();
    let shift = |a: Point, b: Point| [b[0] - a[0] - 0.5, b[1] - a[1] + 0.25, b[2] - a[2]].into_iter().all(|off| off.abs() < 1e-6);
    assert!(before.len() == after.len() && before.iter().zip(&after).all(|(a, b)| shift(*a, *b)), "{before:?} {after:?}");
    assert!(shift(goal, run.published.goal().unwrap()));
}

#[test]
fn it_waits_and_goes_home_when_it_is_asked_to() {
    let mut run = Run::new(rooms(false), None);
    run.explore(30);
    assert_eq!(run.plan.state, PlanState::Exploring);
    run.planner.pause(true);
    run.outputs.stop_exploring();
    assert!(run.published.path().is_empty());
    run.scan();
    std::thread::sleep(Duration::from_millis(300));
    assert!(run.planner.step(run.mapper.atlas()).is_none() && run.planner.plan().is_none());
    run.planner.command(Command::Return);
    run.explore(600);
    assert!(run.plan.state == PlanState::Done && distance(run.position, HOME) < 1.0, "{:?} at {:?}", run.plan.state, run.position);
    assert_eq!(run.plan.reason.map(|reason| reason.to_string()).as_deref(), Some("it was asked to"));
    let known = run.known();
    // And on.
    run.planner.command(Command::Explore);
    run.plan = Plan::default();
    run.explore(1200);
    assert!(run.plan.state == PlanState::Done && distance(run.position, HOME) < 1.0 && run.known() > known.max(0.97), "{known} {}", run.known());
    assert!(run.least > RADIUS, "{} m from a wall", run.least);
}
