//! A robot that explores a simulated world by what a node publishes, in real time: ten scans a second, with drift and loop closures. Prints how much it knows, how long
//! scans took, and what planning cost.
//!
//! `cargo run --release -p voxelastic-live --example explore -- maze 1 300 [picture.png]`: the world, its seed, seconds at most; the picture shows what was published
//! after a third of them.

#[path = "../tests/all/common/published.rs"]
mod published;

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use published::{Point, Published};
use std::collections::VecDeque;
use std::error::Error;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use voxelastic::event::{Event, Scan};
use voxelastic::sensor::preset_with_columns;
use voxelastic::settings::{FieldKind, RobotRadius, Settings};
use voxelastic::{Mapper, Pose};
use voxelastic_eval::grid_view::{Dot, GridView, Line};
use voxelastic_live::feed::{Feed, Next, Overload};
use voxelastic_live::planner::{LivePlanner, Plan, PlanState, PlannerSettings};
use voxelastic_live::ros::names::Names;
use voxelastic_live::ros::output::{OutputOptions, Outputs};
use voxelastic_live::transport::Transport;
use voxelastic_run::Input;
use voxelastic_sim::drift::{LiveSlam, LoopSettings};
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{ReachableSpace, Scene};

const PERIOD: Duration = Duration::from_millis(100);
const RADIUS: f64 = 0.3;
const SPEED: f64 = 2.0;
/// Drift of the odometry, metres in 100 m.
const DRIFT: f64 = 2.0;

/// What happened to the robot.
#[derive(Clone, Copy, Debug)]
struct Course {
    travelled: f64,
    collisions: usize,
    /// Least distance of its centre from a surface, metres.
    least: f64,
    /// Distance between where it is and where it believes to be, metres.
    error: f64,
    /// From its start, metres.
    from_home: f64,
}

/// A robot that follows the published path and scans.
struct Robot {
    scene: Scene,
    lidar: Lidar,
    slam: LiveSlam,
    published: Published,
    seed: u64,
    start: Pose,
    truth: Pose,
    believed: Pose,
    path: Vec<Point>,
    ahead: Vec<Point>,
    is_touching: bool,
    due: Instant,
    begin: Instant,
    inputs: VecDeque<Input>,
    course: Arc<Mutex<Course>>,
}

fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// The place on the segment from `a` to `b` that is nearest to `p`.
fn nearest(p: Point, a: Point, b: Point) -> Point {
    let dot = |u: Point, v: Point| (0..3).map(|k| u[k] * v[k]).sum::<f64>();
    let (along, off): (Point, Point) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| p[k] - a[k]));
    let share = (dot(along, off) / dot(along, along).max(1e-12)).clamp(0.0, 1.0);
    std::array::from_fn(|k| a[k] + share * along[k])
}

impl Robot {
    fn position(&self) -> Point {
        self.believed.translation.vector.into()
    }

    /// Takes another path from where it is on it.
    fn look_at_path(&mut self) {
        let path = self.published.path();
        if path == self.path {
            return;
        }
        let at = self.position();
        let off = |motion: &[Point]| distance(at, nearest(at, motion[0], motion[1]));
        let on = path.windows(2).take(8).enumerate().min_by(|a, b| off(a.1).total_cmp(&off(b.1))).map_or(0, |(k, _)| k + 1);
        self.ahead = path[on.min(path.len())..].to_vec();
        self.path = path;
    }

    /// Moves for the time between two scans.
    fn follow(&mut self) {
        self.look_at_path();
        let t_truth_map = self.truth * self.believed.inverse();
        let mut left = SPEED * PERIOD.as_secs_f64();
        while let Some(to) = self.ahead.first().copied().filter(|_| left > 1e-6) {
            let (at, length) = (self.position(), distance(self.position(), to));
            let step = length.min(left).min(0.05);
            if length <= step + 1e-9 {
                self.ahead.remove(0);
            }
            if length > 1e-9 {
                self.move_to(&t_truth_map, at, std::array::from_fn(|k| at[k] + step / length * (to[k] - at[k])));
            }
            left -= step;
        }
    }

    fn move_to(&mut self, t_truth_map: &Pose, at: Point, to: Point) {
        let [x, y] = [to[0] - at[0], to[1] - at[1]];
        let ahead = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), y.atan2(x));
        let rotation = if x.hypot(y) > 1e-3 { ahead } else { self.believed.rotation };
        self.believed = Pose::from_parts(Translation3::from(Vector3::from(to)), rotation);
        let truth = t_truth_map * self.believed;
        self.truth = Pose::from_parts(truth.translation, UnitQuaternion::new_normalize(truth.rotation.into_inner()));
        let off = self.scene.world.distance(self.truth.translation.vector.into());
        let mut course = self.course.lock().unwrap();
        course.travelled += distance(at, to);
        course.least = course.least.min(off);
        course.collisions += usize::from(off < RADIUS && !self.is_touching);
        course.from_home = (self.truth.translation.vector - self.start.translation.vector).norm();
        self.is_touching = off < RADIUS;
    }

    fn scan(&mut self) {
        let (truth, tracked) = (self.truth, self.slam.step(&self.scene.world, self.truth));
        let cloud = self.lidar.scan(&self.scene.world, |_| truth, &Stream::new(self.seed, &[0xe8, tracked.node]));
        self.believed = tracked.t_map_lidar;
        let scan = Scan { node: tracked.node, time: self.begin.elapsed().as_secs_f64(), t_map_lidar: tracked.t_map_lidar, cloud };
        self.inputs.push_back(Input::Event(Event::Scan(scan)));
        self.inputs.extend(tracked.edge.map(|edge| Input::Event(Event::OdometryEdge(edge))));
        if let Some((edge, poses)) = tracked.closure {
            self.believed = poses.last().map_or(self.believed, |(_, pose)| *pose);
            self.inputs.extend([Event::LoopEdge(edge), Event::PoseUpdate(poses)].map(Input::Event));
        }
        self.course.lock().unwrap().error = (self.truth.translation.vector - self.believed.translation.vector).norm();
    }
}

impl Transport for Robot {
    fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
        if let Some(input) = self.inputs.pop_front() {
            return Some(input);
        }
        if is_stopped() {
            return None;
        }
        std::thread::sleep(self.due.saturating_duration_since(Instant::now()));
        self.due = (self.due + PERIOD).max(Instant::now());
        self.follow();
        self.scan();
        self.inputs.pop_front()
    }
}

/// Draws the last messages.
fn draw(file: &Path, published: &Published) -> Result<(), Box<dyn Error>> {
    let Some((edge, width, corner, cells)) = published.grid() else { return Ok(()) };
    let colour = |cell: &i8| match cell {
        0 => [255, 255, 255],
        100 => [60, 62, 68],
        _ => [200, 203, 208],
    };
    let colours: Vec<[u8; 3]> = cells.iter().map(colour).collect();
    let flat = |path: Vec<Point>| path.into_iter().map(|[x, y, _]| [x, y]).collect::<Vec<_>>();
    let [driven, planned, frontier, goal] = [[90, 120, 200], [30, 150, 60], [226, 112, 46], [200, 30, 60]];
    let line = |points, colour, width| Line { points, colour, width };
    let sides = |(centre, size): &(Point, Point)| {
        let [x, y] = [0, 1].map(|k| [centre[k] - 0.5 * size[k], centre[k] + 0.5 * size[k]]);
        vec![[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]], [x[0], y[0]]]
    };
    let boxes = published.frontier().into_iter().map(|cluster| line(sides(&cluster), frontier, 2.0));
    let lines = boxes.chain([line(flat(published.path_of("path")), driven, 2.0), line(flat(published.path()), planned, 4.0)]);
    let view = GridView {
        title: "path, frontier and goal as they are published".to_owned(),
        labels: ["x [m]", "y [m]"],
        origin: [corner[0], corner[1]],
        pixel: edge,
        size: [width, cells.len() / width.max(1)],
        cells: &colours,
        legend: [(driven, "driven"), (planned, "path to follow"), (frontier, "frontier"), (goal, "goal")]
            .map(|(c, text)| (c, text.to_owned()))
            .into(),
        lines: lines.collect(),
        dots: published.goal().into_iter().map(|[x, y, _]| Dot { at: [x, y], colour: goal, radius: 7.0 }).collect(),
    };
    Ok(view.write_png(file)?)
}

/// Median, 99 % and the most, milliseconds.
fn times(mut all: Vec<Duration>) -> String {
    all.sort_unstable();
    let at = |share: f64| all.get((share * all.len().saturating_sub(1) as f64).round() as usize).map_or(0.0, |time| 1e3 * time.as_secs_f64());
    format!("{:.1} / {:.1} / {:.1} ms of {}", at(0.5), at(0.99), at(1.0), all.len())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [world, seed, seconds] = [0, 1, 2].map(|k| arguments.get(k).cloned().unwrap_or_default());
    let (seed, seconds): (u64, u64) = (seed.parse()?, seconds.parse()?);
    let scene = Scene::named(&world, seed)?;
    let model = preset_with_columns("os1-64", 512)?;
    let start = scene.trajectory.pose(0.0);
    let start = Pose::from_parts(start.translation, UnitQuaternion::from_axis_angle(&Vector3::z_axis(), start.rotation.euler_angles().2));
    let place: Point = start.translation.vector.into();
    let (low, high) = scene.world.bounds().ok_or("a world without bounds")?;
    let bounds = [[low[0], low[1], place[2] - 0.7], [high[0], high[1], place[2] + 1.0]];
    let truth = ReachableSpace::new(&scene.world, place, bounds);
    let mut settings = Settings { voxel_size: 0.1, max_range: 30.0, min_range: 0.1, field: FieldKind::Occupancy, ..Settings::default() };
    [settings.robot_radius, settings.robot_height] = [1.31, 0.5].map(RobotRadius::Metres);
    let mut mapper = Mapper::new(settings)?;
    mapper.set_sensor_model(model.clone());
    let published = Published::default();
    let mut outputs = Outputs::new(OutputOptions { explores: true, ..OutputOptions::default() });
    outputs.add_sinks(&Names::of_node("robot"), |profile| Ok(published.topic(&profile.name)))?;
    let time = Some(seconds as f64);
    let planner =
        PlannerSettings { radius: RADIUS, margin: 0.1, height: None, speed: SPEED, bounds: Some(bounds), time, max_range: 30.0, least_volume: 4.0 };
    let mut planner = LivePlanner::start(planner, 2)?;
    let course = Course { travelled: 0.0, collisions: 0, least: f64::INFINITY, error: 0.0, from_home: 0.0 };
    let course = Arc::new(Mutex::new(course));
    let begin = Instant::now();
    let robot = Robot {
        lidar: Lidar::new(model, LidarSettings::default())?,
        slam: LiveSlam::new(DRIFT, LoopSettings::default(), seed),
        scene,
        published: published.clone(),
        seed,
        start,
        truth: start,
        believed: start,
        path: Vec::new(),
        ahead: Vec::new(),
        is_touching: false,
        due: begin,
        begin,
        inputs: VecDeque::new(),
        course: Arc::clone(&course),
    };
    let feed = Feed::start(Box::new(robot), Overload::NewestWin)?;
    let (mut delays, mut copies, mut looks, mut plans, mut last) = (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Plan::default());
    let (mut closures, mut picture) = (0, arguments.get(3));
    while last.state != PlanState::Done && begin.elapsed() < Duration::from_secs(2 * seconds) {
        if let Next::Incoming(incoming, arrival) = feed.next(Duration::from_millis(10)) {
            let Input::Event(event) = *incoming else { continue };
            let is_scan = matches!(event, Event::Scan(_));
            closures += usize::from(matches!(event, Event::LoopEdge(_)));
            if let Event::Scan(scan) = &event {
                planner.add_scan(scan, 0.1);
                outputs.add_scan(scan.node, scan.time);
            }
            mapper.handle(event)?;
            if is_scan {
                delays.push(arrival.at.elapsed());
            }
            outputs.note(&mapper, None);
            planner.note();
        }
        if let Some(plan) = planner.plan() {
            last = plan?;
            outputs.publish_plan(mapper.atlas(), &last);
            looks.push(last.took);
            plans.extend(last.is_new.then_some(last.took));
        }
        if feed.counts().waiting == 0 {
            copies.extend(planner.step(mapper.atlas()));
            if begin.elapsed() > Duration::from_secs(seconds) / 3
                && let Some(file) = picture.take()
            {
                outputs.step(mapper.atlas());
                draw(Path::new(file), &published)?;
            }
        }
    }
    let (course, counts) = (*course.lock().unwrap(), feed.counts());
    feed.stop();
    println!(
        "{world} {seed}: {:?}, {:?} after {:.0} s, {:.1} m from its start",
        last.state,
        last.reason.map(|r| r.to_string()),
        begin.elapsed().as_secs_f64(),
        course.from_home
    );
    println!(
        "{:.1} % known, {:.0} m, {} collisions, {:.2} m from a surface, {closures} loops, error {:.2} m",
        100.0 * truth.known_share(&mapper.atlas().query().unwrap()),
        course.travelled,
        course.collisions,
        course.least,
        course.error
    );
    println!(
        "{} scans, {} left out, {} submaps, {:.0} MB; from coming to the map {}",
        counts.scans,
        counts.left_out,
        mapper.atlas().submaps().len(),
        mapper.atlas().bytes() as f64 / 1e6,
        times(delays)
    );
    println!("copies {}; looks {}; new paths {}", times(copies), times(looks), times(plans));
    Ok(())
}
