//! Occupancy as messages: an OctoMap, and a 2-D map of the storey that the robot is on.

use crate::ros::messages::Grid;
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, Axis, Resampling, SliceRequest};
use voxelastic_ground::{Body, Ground, GroundError};
use voxelastic_io::octomap;

/// Occupancy is published at most this often ...
const PERIOD: Duration = Duration::from_secs(1);
/// ... and making it takes no more than this share of the time.
const SHARE: f64 = 0.05;
/// Longest side of the 2-D map, cells; beyond it, cells are twice, four times, .. as large.
const MOST_CELLS: f64 = 4000.0;

/// The 2-D map ends at multiples of this many cells, so that its origin seldom moves as it grows.
const BLOCK: i32 = 128;

/// Without a floor, obstacles are those in this layer, metres above the sensor.
const SENSOR_LAYER: [f64; 2] = [-0.2, 0.3];

/// What the 2-D map is made for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridSettings {
    /// Edge of a cell, metres; `None`: the finest voxel of the map.
    pub resolution: Option<f64>,
    /// The robot.
    pub body: Body,
}

/// When occupancy was made, and whether it has changed since.
#[derive(Debug, Default)]
pub struct Layers {
    has_changed: bool,
    /// Whether it was said that there is no 2-D map.
    has_warned: bool,
    listeners: [usize; 2],
    /// When it was made, and how long that took.
    last: Option<(Instant, Duration)>,
}

/// Occupancy to publish.
#[derive(Debug, Default)]
pub struct Made {
    /// Edge of the smallest cubes, metres, and the nodes of the tree.
    pub octomap: Option<(f64, Vec<u8>)>,
    /// The 2-D map.
    pub grid: Option<FloorPlan>,
}

/// A 2-D map in the map frame.
#[derive(Debug)]
pub struct FloorPlan {
    resolution: f64,
    width: usize,
    origin: [f64; 3],
    cells: Vec<i8>,
}

impl FloorPlan {
    /// As the content of a message.
    pub fn as_message(&self) -> Grid<'_> {
        Grid { resolution: self.resolution, width: self.width, origin: self.origin, cells: &self.cells }
    }
}

impl Layers {
    /// Notes that the map has changed.
    pub fn note(&mut self) {
        self.has_changed = true;
    }

    /// Has it made again as soon as may be, however long that took before.
    pub fn hurry(&mut self) {
        self.last = self.last.map(|(at, _)| (at, Duration::ZERO));
    }

    /// Says once why there is no 2-D map.
    fn warn(&mut self, why: &GroundError) {
        if !std::mem::replace(&mut self.has_warned, true) {
            tracing::warn!("no 2-D map is published: {why}; {}", why.remedy());
        }
    }

    /// Makes what somebody listens to of octomap and 2-D map, if the map has changed or listeners have come. The 2-D map is of the storey below `robot`, where the
    /// sensor is in the map frame, metres.
    pub fn step(&mut self, atlas: &Atlas, listeners: [usize; 2], grid: &GridSettings, robot: [f64; 3]) -> Option<Made> {
        let before = std::mem::replace(&mut self.listeners, listeners);
        self.has_changed |= listeners.iter().zip(before).any(|(now, before)| *now > before);
        let is_due = self.last.is_none_or(|(at, took)| at.elapsed() >= PERIOD.max(took.div_f64(SHARE)));
        if !self.has_changed || !is_due || listeners == [0; 2] {
            return None;
        }
        let clock = Instant::now();
        let query = atlas.query();
        let made = if query.is_empty() {
            None
        } else {
            let octomap = if listeners[0] > 0 { octree(&query) } else { None };
            let grid = (listeners[1] > 0).then(|| floor_plan(atlas, grid, robot));
            let grid = grid.and_then(|made| made.map_err(|why| self.warn(&why)).ok());
            Some(Made { octomap, grid })
        };
        self.has_changed = false;
        self.last = Some((clock, clock.elapsed()));
        made
    }
}

fn octree(query: &AtlasQuery<'_>) -> Option<(f64, Vec<u8>)> {
    let voxel = query.voxel_size();
    let cubes = query.resample(&Resampling { voxel, states_only: true });
    let nodes = octomap::state_nodes(&cubes).map_err(|problem| tracing::warn!("no OctoMap is published: {problem}"));
    Some((voxel, nodes.ok()?))
}

/// The 2-D map of the storey below `robot`, where the sensor is in the map frame, metres.
///
/// # Errors
/// As of [`Ground::of`].
pub fn floor_plan(atlas: &Atlas, settings: &GridSettings, robot: [f64; 3]) -> Result<FloorPlan, GroundError> {
    let query = atlas.query();
    if query.is_empty() {
        return Err(GroundError::NoOccupancy);
    }
    let size = query.bounds().size();
    // The decimal number that the setting was, not the float that it became.
    let voxel = atlas.voxel_size().to_string().parse().unwrap_or(f64::from(atlas.voxel_size()));
    let mut resolution = settings.resolution.unwrap_or(voxel);
    while f64::from(size[0].max(size[1])) > MOST_CELLS * resolution {
        resolution *= 2.0;
    }
    let ground = match Ground::of(atlas, resolution, &settings.body) {
        Err(GroundError::NoFloor { .. }) => return Ok(without_floor(&query, resolution, robot[2])),
        ground => ground?,
    };
    let storey = &ground.storeys()[ground.storey_below(robot).unwrap_or(0)];
    let grid = ground.grid(storey).padded(BLOCK);
    let cell = |state: &State| match state {
        State::Free => 0,
        State::Occupied => 100,
        State::Unknown => -1,
    };
    let [x, y] = grid.cells.origin();
    Ok(FloorPlan { resolution, width: grid.cells.size[0], origin: [x, y, storey.height], cells: grid.states.iter().map(cell).collect() })
}

/// Where no floor was found, as at the beginning: obstacles at the height of the sensor. Nothing is free, as nobody knows what a robot would stand on.
fn without_floor(query: &AtlasQuery<'_>, resolution: f64, height: f64) -> FloorPlan {
    let (bounds, low) = (query.bounds(), height + SENSOR_LAYER[0]);
    let request = SliceRequest { axis: Axis::Z, at: low, thickness: SENSOR_LAYER[1] - SENSOR_LAYER[0], pixel: resolution, bounds };
    let slice = query.slice(&request);
    let cells = slice.states.iter().map(|state| if *state == State::Occupied { 100 } else { -1 }).collect();
    FloorPlan { resolution, width: slice.width, origin: [f64::from(bounds.min[0]), f64::from(bounds.min[1]), low], cells }
}
