//! The simulated robot: it moves as it believes it does, scans, and maps.

use super::args::{ExploreArgs, MARGIN, view};
use crate::failure::Failure;
use anyhow::Context;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use std::collections::HashSet;
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId, Scan};
use voxelastic::mapper::{MapError, Mapper};
use voxelastic::sensor::preset_with_columns;
use voxelastic::settings::{FieldKind, RobotRadius, Settings};
use voxelastic::{Cloud, Pose, geometry::PoseExt};
use voxelastic_explore::Explorer;
use voxelastic_plan::Point;
use voxelastic_sim::drift::{LiveSlam, LoopSettings};
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{Scene, World};

/// The true motion is checked for collisions at this interval, metres.
const CHECKED: f64 = 0.1;

/// Edge of the cubes by which TARE measures what was explored, metres.
const CUBE: f64 = 0.5;

/// A robot in a world, with its map.
pub struct SimulatedRobot {
    scene: Scene,
    lidar: Lidar,
    noise: Stream,
    slam: LiveSlam,
    mapper: Mapper,
    /// Lidar frame.
    last_scan: Cloud,
    /// Its node.
    node: NodeId,
    /// Wall time in which it was mapped, with the correction after it.
    mapping: Duration,
    /// Where the robot is, and where it believes to be.
    truth: Pose,
    believed: Pose,
    /// True positions so far, at every scan.
    pub track: Vec<Point>,
    radius: f64,
    speed: f64,
    spacing: f64,
    distance: f64,
    is_touching: bool,
    /// Cubes of the world with returns.
    cubes: HashSet<[i32; 3]>,
    /// Times that the body touched something.
    pub collisions: usize,
    /// Loops that closed.
    pub closures: usize,
}

impl SimulatedRobot {
    /// A robot at the start of the world's route.
    pub fn new(args: &ExploreArgs) -> anyhow::Result<Self> {
        let scene = Scene::named(&args.world, args.seed)?;
        let model = preset_with_columns(args.sensor(), args.columns)
            .map_err(|error| Failure::usage(error.to_string(), "see `voxelastic map --help` for the sensors, and use other --columns"))?;
        let mut settings = Settings { voxel_size: args.voxel_size, max_range: args.max_range, field: FieldKind::Occupancy, ..Settings::default() };
        settings.set("no_return", &args.no_return)?;
        let start = scene.trajectory.pose(0.0);
        let height = args.ground.then_some(start.translation.z);
        let (view, voxel) = (view(&model, args.max_range, args.voxel_size), f64::from(args.voxel_size));
        settings.robot_radius = RobotRadius::Metres(view.own_radius(args.radius + MARGIN, voxel, height) as f32);
        settings.robot_height = RobotRadius::Metres(view.own_height(args.radius + MARGIN, voxel, height) as f32);
        let start = Pose::from_parts(start.translation, UnitQuaternion::from_axis_angle(&Vector3::z_axis(), start.rotation.euler_angles().2));
        let mut mapper = Mapper::new(settings)?;
        mapper.set_sensor_model(model.clone());
        Ok(Self {
            lidar: Lidar::new(model, LidarSettings::default())?,
            noise: Stream::new(args.seed, &[0xe8]),
            slam: LiveSlam::new(args.drift, LoopSettings::default(), args.seed),
            mapper,
            last_scan: Cloud::default(),
            node: 0,
            mapping: Duration::ZERO,
            truth: start,
            believed: start,
            track: Vec::new(),
            radius: args.radius,
            speed: args.speed,
            spacing: args.spacing,
            distance: 0.0,
            is_touching: false,
            cubes: HashSet::new(),
            collisions: 0,
            closures: 0,
            scene,
        })
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.scene.world
    }

    /// The map.
    pub fn atlas(&self) -> &Atlas {
        self.mapper.atlas()
    }

    /// Where it starts.
    pub fn start(&self) -> Point {
        self.track.first().copied().unwrap_or_else(|| self.truth.translation.vector.into())
    }

    /// The last scan, and where it believes that it took it.
    pub fn last_scan(&self) -> (&Pose, &Cloud) {
        (&self.believed, &self.last_scan)
    }

    /// The mapper.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// The node of the last scan.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Wall time in which the last scan was mapped, with the correction after it.
    pub fn mapping(&self) -> Duration {
        self.mapping
    }

    /// Where it believes to be, map frame.
    pub fn position(&self) -> Point {
        self.believed.translation.vector.into()
    }

    /// Length of its true path, metres.
    pub fn distance(&self) -> f64 {
        self.distance
    }

    /// Time since the start, seconds; it does not wait for decisions.
    pub fn time(&self) -> f64 {
        self.distance / self.speed
    }

    /// Distance between where it is and where it believes to be, metres.
    pub fn error(&self) -> f64 {
        self.truth.translation_distance(&self.believed)
    }

    /// Explored volume as TARE measures it, cubic metres: that of all cubes with a return.
    pub fn tare_volume(&self) -> f64 {
        CUBE.powi(3) * self.cubes.len() as f64
    }

    /// Scans, and maps the scan with what the SLAM system says.
    pub fn scan(&mut self) -> anyhow::Result<()> {
        let truth = self.truth;
        self.track.push(truth.translation.vector.into());
        let tracked = self.slam.step(&self.scene.world, truth);
        let cloud = self.lidar.scan(&self.scene.world, |_| truth, &self.noise.fork(tracked.node));
        self.last_scan.clone_from(&cloud);
        let cube = |p: &[f32; 3]| -> [i32; 3] { (truth * Point3::from(p.map(f64::from))).coords.map(|c| (c / CUBE).floor() as i32).into() };
        self.cubes.extend(cloud.points.iter().filter(|p| Cloud::is_return(p)).map(cube));
        let scan = Scan { node: tracked.node, time: self.time(), t_map_lidar: tracked.t_map_lidar, cloud };
        let map = |mapper: &mut Mapper, event: Event| mapper.handle(event).map(drop).context("the robot cannot map");
        let clock = Instant::now();
        match self.mapper.handle(Event::Scan(scan)) {
            // As a driver would, and the robot goes on.
            Err(error @ MapError::NoReturns { .. }) => tracing::warn!("{error}; it is left out"),
            mapped => drop(mapped.context("the robot cannot map")?),
        }
        (self.believed, self.node) = (tracked.t_map_lidar, tracked.node);
        if let Some(edge) = tracked.edge {
            map(&mut self.mapper, Event::OdometryEdge(edge))?;
        }
        if let Some((edge, poses)) = tracked.closure {
            self.closures += 1;
            self.believed = poses.last().map_or(self.believed, |(_, pose)| *pose);
            map(&mut self.mapper, Event::LoopEdge(edge))?;
            map(&mut self.mapper, Event::PoseUpdate(poses))?;
        }
        self.mapping = clock.elapsed();
        Ok(())
    }

    /// Moves along the explorer's path to where the next scan is due, and scans.
    pub fn follow(&mut self, explorer: &mut Explorer) -> anyhow::Result<()> {
        let (truth, believed) = (self.truth, self.believed);
        let t_truth_map = truth * believed.inverse();
        let mut at = self.position();
        for _ in 0..(self.spacing / CHECKED).ceil() as usize {
            let Some(next) = explorer.advance(CHECKED) else { break };
            let moved = voxelastic_plan::distance(at, next);
            if moved < 1e-9 {
                break;
            }
            self.distance += moved;
            self.move_to(&t_truth_map, at, next);
            at = next;
        }
        self.scan()
    }

    /// Moves straight to `next`, map frame, ahead.
    fn move_to(&mut self, t_truth_map: &Pose, at: Point, next: Point) {
        let ahead = (next[1] - at[1]).atan2(next[0] - at[0]);
        let rotation = if (next[0] - at[0]).hypot(next[1] - at[1]) > 1e-3 {
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ahead)
        } else {
            self.believed.rotation
        };
        self.believed = Pose::from_parts(Translation3::from(Point3::from(next).coords), rotation);
        let truth = t_truth_map * self.believed;
        // Each motion is a product with the last one, so rounding would grow.
        self.truth = Pose::from_parts(truth.translation, UnitQuaternion::new_normalize(truth.rotation.into_inner()));
        let off = self.scene.world.distance(self.truth.translation.vector.into());
        let is_touching = off < self.radius;
        if is_touching && !self.is_touching {
            self.collisions += 1;
            let at = self.truth.translation.vector;
            tracing::debug!("touches something {off:.2} m from {:.2?}, where it believes to be at {next:.2?}", at.as_slice());
        }
        self.is_touching = is_touching;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        args: ExploreArgs,
    }

    #[test]
    fn a_scan_without_returns_is_left_out() {
        let Alone { args } = Alone::parse_from(["explore", "room", "--columns", "256"]);
        let mut robot = SimulatedRobot::new(&args).unwrap();
        robot.scan().unwrap();
        let scans = |robot: &SimulatedRobot| robot.atlas().scan_poses().count();
        assert_eq!(scans(&robot), 1);
        // Nothing is in range where it is now.
        robot.truth.translation.z += 1e3;
        robot.scan().unwrap();
        assert_eq!(scans(&robot), 1);
        robot.truth.translation.z -= 1e3;
        robot.scan().unwrap();
        assert_eq!(scans(&robot), 2);
    }
}
