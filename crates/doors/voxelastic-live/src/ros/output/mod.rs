//! What is published about the map: topics, and when there is something new in them.
//!
//! | topic | type | when |
//! | --- | --- | --- |
//! | `~/surface` | `visualization_msgs/MarkerArray` | a triangle mesh for each tile of the one surface that changed or whose submaps moved, and for all of them when somebody comes |
//! | `~/surface_points` | `sensor_msgs/PointCloud2` | the vertices of the same tiles |
//! | `~/moving_points` | `sensor_msgs/PointCloud2` | points of each scan that were set aside because they are on things that move, with `dynamic = remove` |
//! | `~/octomap` | `octomap_msgs/Octomap` | free and occupied space, if the map has occupancy |
//! | `~/grid` | `nav_msgs/OccupancyGrid` | a 2-D map of the storey that the robot is on, for its height and what it climbs: once a second while it changes; for those who also listen to its updates, when its size changes or somebody comes |
//! | `~/grid_updates` (the name of the grid with `_updates`) | `map_msgs/OccupancyGridUpdate` | rectangles of the 2-D map that contain what has changed in it |
//! | `~/global_costmap`, `~/global_costmap_updates` | the same | the costs of that map for a robot's footprint |
//! | `~/local_costmap` | `nav_msgs/OccupancyGrid` | the costs around the robot, of the map and of the last scan: after each scan |
//! | `~/distance_slice` | `sensor_msgs/PointCloud2` | distances to the nearest surface within 10 m of the robot, at its height |
//! | `~/path` | `nav_msgs/Path` | poses of the scans, when a scan was added or poses were corrected; of more than 4096 every second, fourth, ... and the last |
//! | `~/frontier` | `visualization_msgs/MarkerArray` | for a robot that explores: a box at the centre of each cluster of the frontier, as large as that is, and an arrow towards what is unknown, with each plan |
//! | `~/explore_path`, `~/explore_goal` | `nav_msgs/Path`, `geometry_msgs/PoseStamped` | where it is to go, and the end of that, with each plan, and where poses were corrected |
//! | `~/submaps` | `geometry_msgs/PoseArray` | root poses of the submaps, when they change |
//! | `/diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second |
//! | `/tf` | `tf2_msgs/TFMessage` | `map` to the frame of the odometry, with each scan and ten times a second |
//!
//! Everything is in the frame `map`. What takes work is made only if somebody listens, and when listeners have taken what was made before.

mod costmap;
mod distances;
mod exploration;
mod floor_plan;
mod grid;
mod octomap;
mod options;
mod path;
mod sinks;
mod surface;
mod topics;

use super::messages::{self, Grid, Header, Health};
use super::middleware::{Middleware, MiddlewareError, Sink, TopicProfile};
use super::names::Names;
use crate::planner::Plan;
use costmap::LocalCostmap;
use distances::SliceState;
use exploration::ShownPlan;
use floor_plan::FloorPlan;
pub use floor_plan::GridSettings;
use grid::LiveGrid;
use octomap::OctomapState;
pub use options::OutputOptions;
use path::PathState;
use sinks::Sinks;
use std::time::{Duration, Instant};
use surface::SurfaceTiles;
pub use topics::{MAP_FRAME, Output, profiles};
use voxelastic::atlas::Atlas;
use voxelastic::event::{NodeId, Scan};
use voxelastic::settings::Dynamic;
use voxelastic::{Mapper, Pose};
use voxelastic_io::bag::live::LiveFrames;

/// Paths and figures are published at most this often.
const PERIOD: Duration = Duration::from_secs(1);
/// Paths over a link of limited rate.
const PATH_PERIOD_OVER_LINK: Duration = Duration::from_secs(5);
/// The transform is published at least this often.
const TRANSFORM_PERIOD: Duration = Duration::from_millis(100);

/// How the robot's odometry is tied to the map.
#[derive(Clone, Debug)]
pub struct OdometryLink {
    /// The frame that the poses of the scans came in.
    pub odom: String,
    /// Where the lidar was in it at the last scan, and which scan that was.
    pub t_odom_lidar: Pose,
    /// The node of that scan.
    pub node: NodeId,
    /// Time stamp of that scan, seconds.
    pub time: f64,
    /// The robot's frame, and its pose in the frame of the lidar: published, too, where nobody else does.
    pub base: Option<(String, Pose)>,
}

/// Publishes what changes in a map, to all networks that were added.
pub struct Outputs {
    sinks: Sinks,
    options: OutputOptions,
    surface: SurfaceTiles,
    octomap: OctomapState,
    grid: LiveGrid,
    costmap: LocalCostmap,
    slice: SliceState,
    poses: Vec<Pose>,
    path: PathState,
    plan: ShownPlan,
    link: Option<(Instant, OdometryLink, Pose)>,
    last_transform: Option<Instant>,
    last_figures: Option<Instant>,
    /// The time of a simulation, if there is one.
    clock: Clock,
    /// Is told which transforms are published.
    frames: Option<LiveFrames>,
    /// The last scan.
    newest: Option<NodeId>,
    /// Whether its moving points are to be published.
    has_moving: bool,
    /// Which of surface, grid and OctoMap had the last turn.
    turn: usize,
}

/// What tells the time of a simulation, seconds; none while it is not known.
type Clock = Box<dyn Fn() -> Option<f64> + Send>;

impl Outputs {
    /// None yet.
    pub fn new(options: OutputOptions) -> Self {
        Self {
            sinks: Sinks::over(options.link.clone()),
            surface: SurfaceTiles::new(options.detail),
            octomap: OctomapState::default(),
            grid: LiveGrid::new(options.grid()),
            costmap: LocalCostmap::new(options.grid, options.link.clone()),
            options,
            slice: SliceState::default(),
            poses: Vec::new(),
            path: PathState::default(),
            plan: ShownPlan::default(),
            link: None,
            last_transform: None,
            last_figures: None,
            clock: Box::new(|| None),
            frames: None,
            newest: None,
            has_moving: false,
            turn: 0,
        }
    }

    /// The time between scans is that of a simulation.
    pub fn set_clock(&mut self, clock: impl Fn() -> Option<f64> + Send + 'static) {
        self.clock = Box::new(clock);
    }

    /// Tells `frames` which transforms are published, so that those of others are told from them.
    pub fn set_frames(&mut self, frames: LiveFrames) {
        self.frames = Some(frames);
    }

    /// How the odometry is tied to the last scan, and where its frame is in the map; none where poses are in the map's frame.
    pub fn link(&self) -> Option<(&OdometryLink, &Pose)> {
        self.link.as_ref().map(|(_, link, t_map_odom)| (link, t_map_odom))
    }

    /// Publishes in a network, too.
    ///
    /// # Errors
    /// When the network refuses.
    pub fn add(&mut self, middleware: &mut dyn Middleware, names: &Names) -> Result<(), MiddlewareError> {
        self.add_sinks(names, |profile| middleware.advertise(profile))
    }

    /// Publishes to whatever `advertise` makes of each topic, too.
    ///
    /// # Errors
    /// Those of `advertise`.
    pub fn add_sinks(
        &mut self,
        names: &Names,
        mut advertise: impl FnMut(&TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError>,
    ) -> Result<(), MiddlewareError> {
        let (explores, is_limited) = (self.options.explores, self.options.link.is_some());
        let is_offered = |output: Output| (explores || !output.is_of_exploration()) && !(is_limited && output.is_large());
        for (output, profile) in profiles(names).into_iter().filter(|(output, _)| is_offered(*output)) {
            self.sinks.add(output, advertise(&profile)?);
        }
        Ok(())
    }

    /// Messages that could not be handed over so far.
    pub fn lost(&self) -> usize {
        self.sinks.lost
    }

    /// Notes the time stamp of a scan that is in the map.
    pub fn add_scan(&mut self, node: NodeId, time: f64) {
        self.path.add(node, time);
        (self.newest, self.has_moving) = (Some(node), true);
        self.sinks.stamp = time;
    }

    /// Notes a scan that is going to be in the map, with returns farther than `min_range` metres.
    pub fn take_scan(&mut self, scan: &Scan, min_range: f32) {
        self.add_scan(scan.node, scan.time);
        if self.sinks.subscribers(Output::LocalCostmap) > 0 {
            self.costmap.add_scan(scan, min_range);
        }
    }

    /// After an event: poses are published at once, everything else by [`step`](Self::step).
    pub fn note(&mut self, mapper: &Mapper, link: Option<OdometryLink>) {
        let atlas = mapper.atlas();
        self.note_submaps(atlas);
        self.note_moving(mapper);
        self.surface.note(mapper);
        if let Some(t_map_lidar) = self.newest.and_then(|node| atlas.scan_pose(node)) {
            self.surface.focus(<[f64; 3]>::from(t_map_lidar.translation.vector).map(|c| c as f32));
        }
        self.octomap.note();
        self.grid.note();
        self.slice.note();
        if let Some(link) = link.filter(|link| link.odom != MAP_FRAME)
            && let Some(t_map_lidar) = atlas.scan_pose(link.node)
        {
            let t_map_odom = t_map_lidar * link.t_odom_lidar.inverse();
            self.link = Some((Instant::now(), link, t_map_odom));
            self.publish_transform();
        }
        self.note_path(atlas);
    }

    /// After a submap was rebuilt as corrections had bent it: what is made of it is made again soon.
    pub fn note_rebuilt(&mut self, mapper: &Mapper) {
        self.octomap.hurry();
        self.grid.hurry();
        self.costmap.note_corrected();
        self.note(mapper, None);
    }

    fn note_path(&mut self, atlas: &Atlas) {
        let header = self.sinks.header();
        let period = if self.options.link.is_some() { PATH_PERIOD_OVER_LINK } else { PERIOD };
        if let Some(message) = self.path.step(atlas, period).map(|path| messages::path(header, path)) {
            self.sinks.publish(Output::Path, |_| message);
        }
    }

    /// Once for each scan, also if it has none: what is shown goes then.
    fn note_moving(&mut self, mapper: &Mapper) {
        if std::mem::take(&mut self.has_moving) && mapper.settings().dynamic == Dynamic::Remove {
            self.sinks.publish(Output::MovingPoints, |header| messages::point_cloud(header, mapper.moving_points(), &[]));
        }
    }

    fn note_submaps(&mut self, atlas: &Atlas) {
        let poses: Vec<Pose> = atlas.submaps().iter().map(|submap| submap.t_map_submap()).collect();
        if poses != self.poses {
            self.sinks.publish(Output::Submaps, |header| messages::pose_array(header, &poses));
            self.poses = poses;
            self.costmap.note_corrected();
            if self.plan.follow(atlas) {
                self.publish_path_to_explore();
            }
        }
    }

    /// Publishes where a robot that explores is to go, and the frontier. The path is where the map of now has it, which may have been corrected since it was planned.
    pub fn publish_plan(&mut self, atlas: &Atlas, plan: &Plan) {
        self.plan.set(plan);
        self.plan.follow(atlas);
        let shapes = exploration::shapes(&plan.frontier);
        self.sinks.publish(Output::Frontier, |header| messages::shape_markers(header, "frontier", &shapes));
        self.publish_path_to_explore();
    }

    /// Publishes that a robot that explores is to stay where it is.
    pub fn stop_exploring(&mut self) {
        self.plan = ShownPlan::default();
        self.publish_path_to_explore();
    }

    fn publish_path_to_explore(&mut self) {
        let poses = self.plan.poses();
        if let Some(goal) = poses.last() {
            self.sinks.publish(Output::ExploreGoal, |header| messages::pose_stamped(header, goal));
        }
        self.sinks.publish(Output::ExplorePath, |header| {
            let stamped: Vec<(f64, Pose)> = poses.iter().map(|pose| (header.stamp, *pose)).collect();
            messages::path(header, &stamped)
        });
    }

    /// Publishes the path as it is, if what was published is older.
    pub fn finish(&mut self, mapper: &Mapper) {
        self.path.repeat();
        self.note(mapper, None);
    }

    /// Forgets the map, which begins anew.
    pub fn reset(&mut self) {
        let removed = self.surface.removed();
        if !removed.is_empty() {
            self.sinks.publish(Output::Surface, |header| messages::mesh_markers(header, &removed));
        }
        self.surface = SurfaceTiles::new(self.options.detail);
        (self.octomap, self.slice) = (OctomapState::default(), SliceState::default());
        self.grid = LiveGrid::new(self.options.grid());
        self.costmap = LocalCostmap::new(self.options.grid, self.options.link.clone());
        (self.poses, self.path, self.link) = (Vec::new(), PathState::default(), None);
        self.sinks.publish(Output::Path, |header| messages::path(header, &[]));
        self.sinks.publish(Output::Frontier, |header| messages::shape_markers(header, "frontier", &[]));
        self.stop_exploring();
        self.sinks.publish(Output::Submaps, |header| messages::pose_array(header, &[]));
    }

    /// Publishes what robots steer by: transforms, and the local costmap of the last scan; false if no costmap is due. To be called in the mapper's threads after each scan, also
    /// if others wait.
    pub fn step_urgent(&mut self, atlas: &Atlas) -> bool {
        if self.last_transform.is_some_and(|last| last.elapsed() >= TRANSFORM_PERIOD) {
            self.publish_transform();
        }
        self.step_costmap(atlas)
    }

    /// Publishes what is urgent, and makes and publishes some of the surface that changed, or of the occupancy: in turns, as what waits until there is nothing else may never come.
    /// False if nothing is due. To be called in the mapper's threads.
    pub fn step(&mut self, atlas: &Atlas) -> bool {
        let is_urgent = self.step_urgent(atlas);
        let turns = [Self::step_surface, Self::step_grid, Self::step_octomap];
        let is_done = turns.iter().any(|_| {
            self.turn = (self.turn + 1) % turns.len();
            turns[self.turn](self, atlas)
        });
        is_done || is_urgent
    }

    /// Whether tiles of the surface, the grid or the costmap are being made: they are published by a [`step`](Self::step) soon.
    pub fn is_busy(&self) -> bool {
        self.surface.is_busy() || self.grid.is_busy() || self.costmap.is_busy()
    }

    fn step_surface(&mut self, atlas: &Atlas) -> bool {
        let listeners = [Output::Surface, Output::SurfacePoints].map(|output| self.sinks.subscribers(output));
        if !self.sinks.has_room(&[Output::Surface, Output::SurfacePoints]) {
            return false;
        }
        let Some(meshes) = self.surface.step(atlas, listeners) else { return false };
        let (points, colours) = meshes.vertices();
        self.sinks.publish_if(Output::SurfacePoints, |header| (!points.is_empty()).then(|| messages::point_cloud(header, &points, &colours)));
        self.sinks.publish(Output::Surface, |header| messages::mesh_markers(header, &meshes.markers));
        true
    }

    fn step_octomap(&mut self, atlas: &Atlas) -> bool {
        let listeners = self.sinks.subscribers(Output::Octomap);
        if !self.sinks.has_room(&[Output::Octomap]) {
            return false;
        }
        let Some((voxel, nodes)) = self.octomap.step(atlas, listeners) else { return false };
        self.sinks.publish(Output::Octomap, |header| messages::octomap(header, voxel, &nodes));
        true
    }

    fn step_grid(&mut self, atlas: &Atlas) -> bool {
        let (grid, costmap) = ([Output::Grid, Output::GridUpdates], [Output::GlobalCostmap, Output::GlobalCostmapUpdates]);
        let (listeners, robot) = ([grid[0], costmap[0]].map(|output| self.sinks.subscribers(output)), self.robot());
        if !self.sinks.has_room(&grid) || !self.sinks.has_room(&costmap) {
            return false;
        }
        let news = self.grid.step(atlas, listeners, robot);
        let mut is_told = false;
        for (topics, news) in [grid, costmap].into_iter().zip(news) {
            is_told |= news.is_some();
            news.iter().for_each(|news| self.sinks.publish_grid(topics, news));
        }
        is_told
    }

    fn step_costmap(&mut self, atlas: &Atlas) -> bool {
        if self.sinks.subscribers(Output::LocalCostmap) == 0 || !self.sinks.has_room(&[Output::LocalCostmap]) {
            return false;
        }
        let t_lidar_base = self.frames.as_ref().and_then(LiveFrames::base).map_or(Pose::identity(), |(_, t_lidar_base)| t_lidar_base);
        let Some((costmap, stamp)) = self.costmap.step(atlas, &t_lidar_base) else { return false };
        self.sinks.publish(Output::LocalCostmap, |header| messages::occupancy_grid(Header { stamp, ..header }, &costmap.as_message()));
        true
    }

    /// Where the sensor is in the map frame, metres.
    fn robot(&self) -> [f64; 3] {
        let t_map_lidar = self.path.last().copied().or_else(|| self.link.as_ref().map(|(_, link, t_map_odom)| t_map_odom * link.t_odom_lidar));
        t_map_lidar.unwrap_or_default().translation.vector.into()
    }

    /// The grid as it is now, as a message like those of its topic; without cells where the map has no occupancy.
    pub fn grid(&mut self, atlas: &Atlas) -> Vec<u8> {
        let header = self.sinks.header();
        let none = Grid { resolution: 0.0, width: 0, origin: [0.0; 3], cells: &[] };
        let robot = self.robot();
        let made = self.grid.now(atlas, robot).ok();
        messages::occupancy_grid(header, &made.as_ref().map_or(none, FloorPlan::as_message))
    }

    /// Publishes distances around the robot, if somebody listens and the map has changed. `distances` says them for points of the map frame, metres; none where nothing is
    /// known.
    pub fn step_slice(&mut self, atlas: &Atlas, distances: impl FnOnce(&[[f64; 3]]) -> Vec<Option<f32>>) {
        let begin = Instant::now();
        if !self.sinks.has_room(&[Output::DistanceSlice]) || !self.slice.is_due(self.sinks.subscribers(Output::DistanceSlice), begin) {
            return;
        }
        let Some(t_map_lidar) = self.newest.and_then(|node| atlas.scan_pose(node)) else { return };
        let points = distances::points(t_map_lidar.translation.vector.into(), f64::from(atlas.voxel_size()));
        let known = points.iter().zip(distances(&points)).filter_map(|(p, distance)| Some([p[0] as f32, p[1] as f32, p[2] as f32, distance?]));
        let known: Vec<[f32; 4]> = known.collect();
        self.slice.made(begin, begin.elapsed());
        self.sinks.publish(Output::DistanceSlice, |header| messages::distance_cloud(header, &known));
    }

    /// Whether a second has passed since it was said how the node is.
    pub fn is_time_for_diagnostics(&self) -> bool {
        self.last_figures.is_none_or(|last| last.elapsed() >= PERIOD)
    }

    /// How the node is, in words and as figures.
    pub fn diagnostics(&mut self, node: &str, (health, words, mut figures): (Health, String, Vec<(String, String)>)) {
        self.last_figures = Some(Instant::now());
        figures.push(("messages_lost".to_owned(), self.sinks.lost.to_string()));
        figures.extend(self.options.link.iter().map(|link| ("link_kb".to_owned(), (link.sent() / 1000).to_string())));
        self.sinks.publish(Output::Diagnostics, |header| messages::diagnostics(Header { frame: "", ..header }, node, (health, &words), &figures));
    }

    fn publish_transform(&mut self) {
        let Some((since, link, t_map_odom)) = self.link.clone().filter(|_| self.options.transforms) else { return };
        self.last_transform = Some(Instant::now());
        let stamp = (self.clock)().map_or_else(|| link.time + since.elapsed().as_secs_f64(), |now| now.max(link.time));
        let map = Header { stamp, frame: MAP_FRAME };
        let odom = Header { stamp, frame: &link.odom };
        let mut links = vec![(map, link.odom.as_str(), t_map_odom)];
        if let Some((base, t_lidar_base)) = &link.base {
            links.push((odom, base, link.t_odom_lidar * t_lidar_base));
        }
        self.frames.iter().for_each(|frames| links.iter().for_each(|(_, child, _)| frames.note_published(child, stamp)));
        self.sinks.publish(Output::Transforms, |_| messages::transforms(&links));
    }
}

#[cfg(test)]
mod tests;
