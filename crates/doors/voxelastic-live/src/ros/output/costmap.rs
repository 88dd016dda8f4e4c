//! The local costmap: what a robot meets around it, after each scan. It is made of what the map knows there and of the scan itself, on a thread of its own.

use super::floor_plan::{FloorPlan, GridSettings, Surroundings};
use crate::link::Link;
use crate::near_scans::NearScan;
use crate::worker::{Priority, Worker};
use std::sync::Arc;
use std::time::{Duration, Instant};
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::Scan;
use voxelastic_ground::{GroundError, GroundTiles, TilesCopy};

/// The floor is followed so much farther than the costmap reaches, metres.
const AROUND: f64 = 2.0;
/// Scans that come less often than this do not show what comes into a robot's way, seconds.
const SELDOM: f64 = 0.5;
/// The most that it takes of a link of limited rate.
const SHARE: f64 = 0.25;

/// What the next costmap is made of.
struct Order {
    tiles: TilesCopy,
    /// Time stamp of the last scan, seconds.
    time: f64,
    /// Where the lidar and the middle of the robot are, map frame, metres.
    lidar: [f64; 3],
    middle: [f64; 2],
    /// Returns of the last scan, map frame, metres.
    returns: Vec<[f64; 3]>,
}

/// A costmap, and the time stamp of its scan, seconds.
type Made = Result<(FloorPlan, f64), GroundError>;

/// The local costmap.
#[derive(Debug)]
pub struct LocalCostmap {
    settings: GridSettings,
    /// What it is published over, if that is limited, and until when the last one is on its way.
    link: Option<Arc<Link>>,
    until: Instant,
    tiles: Option<GroundTiles>,
    /// The last scan, and whether there is a costmap of it where poses have it now.
    newest: Option<NearScan>,
    is_current: bool,
    thread: Option<Worker<Order, Made>>,
    /// Time stamp of the scan before, seconds, and how many in a row came long after the one before them.
    last: Option<f64>,
    seldom: usize,
    has_warned: bool,
}

impl LocalCostmap {
    /// Of nothing yet, published over a link if there is one.
    pub fn new(settings: GridSettings, link: Option<Arc<Link>>) -> Self {
        let until = Instant::now();
        Self { settings, link, until, tiles: None, newest: None, is_current: true, thread: None, last: None, seldom: 0, has_warned: false }
    }

    /// Keeps what is near of a scan that is going to be in the map, farther than `min_range` metres.
    pub fn add_scan(&mut self, scan: &Scan, min_range: f32) {
        self.newest = Some(NearScan::of(scan, min_range..self.settings.costmap_size as f32));
        self.is_current = false;
        let is_late = self.last.replace(scan.time).is_some_and(|last| scan.time - last > SELDOM);
        self.seldom = if is_late { self.seldom + 1 } else { 0 };
    }

    /// Has it made again: the map was corrected.
    pub fn note_corrected(&mut self) {
        self.is_current = false;
    }

    /// Whether one is being made.
    pub fn is_busy(&self) -> bool {
        self.thread.as_ref().is_some_and(Worker::is_busy)
    }

    /// Has the next one made if there was a scan or a correction since, and returns one that was made, with the time stamp of its scan, seconds. `t_lidar_base` is where the middle of the robot is. To be called in the mapper's threads, if somebody
    /// listens.
    pub fn step(&mut self, atlas: &Atlas, t_lidar_base: &Pose) -> Option<(FloorPlan, f64)> {
        if self.seldom == 5 {
            self.seldom += 1;
            tracing::warn!("the local costmap is as old as the last scan that was mapped, and those are seldom: have each mapped with --every scan");
        }
        let made = self.thread.as_mut().and_then(Worker::made);
        if Instant::now() >= self.until
            && !self.is_busy()
            && !std::mem::replace(&mut self.is_current, true)
            && let Some(scan) = self.newest.take()
        {
            match atlas.scan_pose(scan.node).map(|t_map_lidar| self.order(atlas, &scan, &t_map_lidar, t_lidar_base)) {
                Some(Ok(order)) => self.have_made(order),
                Some(Err(why)) => self.warn(&why),
                None => {}
            }
            self.newest = Some(scan);
        }
        match made? {
            Ok((plan, time)) => {
                let carried = |link: &Arc<Link>| Duration::from_secs_f64(plan.count() as f64 / (SHARE * link.carries(1.0) as f64));
                self.until = Instant::now() + self.link.as_ref().map_or(Duration::ZERO, carried);
                Some((plan, time))
            }
            Err(why) => {
                self.warn(&why);
                None
            }
        }
    }

    fn order(&mut self, atlas: &Atlas, scan: &NearScan, t_map_lidar: &Pose, t_lidar_base: &Pose) -> Result<Order, GroundError> {
        let finest = f64::from(atlas.voxel_size());
        let resolution = self.settings.finest_resolution(atlas);
        let mut tiles = match self.tiles.take() {
            Some(tiles) => tiles,
            None => GroundTiles::near_robot(resolution, finest)?,
        };
        let lidar: [f64; 3] = t_map_lidar.translation.vector.into();
        let middle = (t_map_lidar * t_lidar_base).translation.vector;
        let (middle, reach) = ([middle.x, middle.y], 0.5 * self.settings.costmap_size + AROUND);
        let noted = tiles.note(atlas).and_then(|()| tiles.make_near(atlas, middle, reach));
        let copy = tiles.copy_near(atlas, middle, reach);
        self.tiles = Some(tiles);
        noted?;
        let in_map = |p: &[f32; 3]| (t_map_lidar * nalgebra::Point3::from(p.map(f64::from))).coords.into();
        Ok(Order { tiles: copy, time: scan.time, lidar, middle, returns: scan.cloud.points.iter().map(in_map).collect() })
    }

    /// At the usual priority: a robot stops by what it shows.
    fn have_made(&mut self, order: Order) {
        let settings = self.settings;
        let start = || Worker::start("local costmap", 1, Priority::Usual, move |order: Order| make(order, &settings));
        self.thread.get_or_insert_with(start).order(order);
    }

    /// Says once why there is none.
    fn warn(&mut self, why: &GroundError) {
        let is_first = !std::mem::replace(&mut self.has_warned, true);
        // Without occupancy there is no grid either, and that says so.
        if is_first && *why != GroundError::NoOccupancy {
            tracing::warn!("no local costmap is published: {why}; {}", why.remedy());
        }
    }
}

fn make(order: Order, settings: &GridSettings) -> Made {
    let mut surroundings = Surroundings::of(order.tiles, &settings.body, order.lidar)?;
    let edge = surroundings.grid.cells.edge;
    let side = (settings.costmap_size / edge).round().max(1.0);
    let low = order.middle.map(|c| (c / edge - 0.5 * side).floor() as i32);
    let margin = (settings.inflation.reach / edge).ceil() as i32;
    // Obstacles beyond its ends cost within them.
    surroundings.grid = surroundings.grid.over(low.map(|c| c - margin), [side as usize + 2 * margin as usize; 2]);
    surroundings.mark(&settings.body, &order.returns);
    surroundings.grid.clear_under(order.middle, settings.inflation.radius);
    Ok((surroundings.costs(&settings.inflation).without_margin(margin as usize), order.time))
}
