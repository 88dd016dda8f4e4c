//! Free and occupied space as an OctoMap, and when it is due.

use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic::query::{AtlasQuery, Resampling};
use voxelastic_io::octomap;

/// It is published at most this often ...
const PERIOD: Duration = Duration::from_secs(1);
/// ... and making it takes no more than this share of the time.
const SHARE: f64 = 0.05;

/// When an OctoMap was made, and whether the map has changed since.
#[derive(Debug, Default)]
pub struct OctomapState {
    has_changed: bool,
    listeners: usize,
    /// When it was made, and how long that took.
    last: Option<(Instant, Duration)>,
}

impl OctomapState {
    /// Notes that the map has changed.
    pub fn note(&mut self) {
        self.has_changed = true;
    }

    /// Has it made again as soon as may be, however long that took before.
    pub fn hurry(&mut self) {
        self.last = self.last.map(|(at, _)| (at, Duration::ZERO));
    }

    /// Makes it if somebody listens, and the map has changed or listeners have come: the edge of the smallest cubes, metres, and the nodes of the tree.
    pub fn step(&mut self, atlas: &Atlas, listeners: usize) -> Option<(f64, Vec<u8>)> {
        let before = std::mem::replace(&mut self.listeners, listeners);
        self.has_changed |= listeners > before;
        let is_due = self.last.is_none_or(|(at, took)| at.elapsed() >= PERIOD.max(took.div_f64(SHARE)));
        if !self.has_changed || !is_due || listeners == 0 {
            return None;
        }
        let clock = Instant::now();
        let made = nodes(atlas);
        self.has_changed = false;
        self.last = Some((clock, clock.elapsed()));
        made
    }
}

fn nodes(atlas: &Atlas) -> Option<(f64, Vec<u8>)> {
    let query = AtlasQuery::new(atlas);
    if query.is_empty() {
        return None;
    }
    let voxel = query.voxel_size();
    let cubes = query.resample(&Resampling { voxel, states_only: true });
    let nodes = octomap::state_nodes(&cubes).map_err(|problem| tracing::warn!("no OctoMap is published: {problem}"));
    Some((voxel, nodes.ok()?))
}
