//! Occupancy as messages: an OctoMap, and a layer of it as a floor plan.

use crate::ros::messages::Grid;
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, Axis, Resampling, SliceRequest};
use voxelastic_io::octomap;

/// Occupancy is published at most this often ...
const PERIOD: Duration = Duration::from_secs(1);
/// ... and making it takes no more than this share of the time.
const SHARE: f64 = 0.05;
/// Longest side of the floor plan, cells; beyond it, cells are larger.
const MOST_CELLS: f64 = 4000.0;

/// When occupancy was made, and whether it has changed since.
#[derive(Debug, Default)]
pub struct Layers {
    has_changed: bool,
    listeners: [usize; 2],
    /// When it was made, and how long that took.
    last: Option<(Instant, Duration)>,
}

/// Occupancy to publish.
#[derive(Debug, Default)]
pub struct Made {
    /// Edge of the smallest cubes, metres, and the nodes of the tree.
    pub octomap: Option<(f64, Vec<u8>)>,
    /// The floor plan.
    pub grid: Option<FloorPlan>,
}

/// A floor plan in the map frame.
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

    /// Makes what somebody listens to of octomap and floor plan, if the map has changed or listeners have come. `layer` is the lower and the upper end of the
    /// layer of the floor plan, metres in the map frame.
    pub fn step(&mut self, atlas: &Atlas, listeners: [usize; 2], layer: [f64; 2]) -> Option<Made> {
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
            Some(Made { octomap, grid: (listeners[1] > 0).then(|| floor_plan(&query, layer)) })
        };
        self.has_changed = false;
        self.last = Some((clock, clock.elapsed()));
        made
    }
}

/// The floor plan as it is; none without occupancy. `layer` is that of [`Layers::step`].
pub fn floor_plan_now(atlas: &Atlas, layer: [f64; 2]) -> Option<FloorPlan> {
    let query = atlas.query();
    (!query.is_empty()).then(|| floor_plan(&query, layer))
}

fn octree(query: &AtlasQuery<'_>) -> Option<(f64, Vec<u8>)> {
    let voxel = query.voxel_size();
    let cubes = query.resample(&Resampling { voxel, states_only: true });
    let nodes = octomap::state_nodes(&cubes).map_err(|problem| tracing::warn!("no OctoMap is published: {problem}"));
    Some((voxel, nodes.ok()?))
}

fn floor_plan(query: &AtlasQuery<'_>, [low, high]: [f64; 2]) -> FloorPlan {
    let bounds = query.bounds();
    let longest = f64::from(bounds.size()[0].max(bounds.size()[1]));
    let pixel = query.voxel_size().max(longest / MOST_CELLS);
    let slice = query.slice(&SliceRequest { axis: Axis::Z, at: low, thickness: high - low, pixel, bounds });
    let cell = |state: &State| match state {
        State::Free => 0,
        State::Occupied => 100,
        State::Unknown => -1,
    };
    let origin = [f64::from(bounds.min[0]), f64::from(bounds.min[1]), low];
    FloorPlan { resolution: pixel, width: slice.width, origin, cells: slice.states.iter().map(cell).collect() }
}
