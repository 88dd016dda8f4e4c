//! How far a map's obstacles are from the true surfaces.

use rayon::prelude::*;
use serde::Serialize;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;
use voxelastic_plan::Point;
use voxelastic_sim::World;

/// One place is compared with the true surfaces for each cube of this edge, voxels.
const SAMPLED: f64 = 2.0;
/// ... and at most so many places, evenly taken, in large boxes ...
const MOST: usize = 1 << 24;
/// ... so many at a time.
const AT_ONCE: usize = 1 << 20;
/// Steps along the axes of a sequence that fills a box evenly, and is aligned with no wall (Roberts' generalisation of the golden ratio).
const EVEN: Point = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];

/// Distances of the map's obstacles from the world's surfaces, metres.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SurfaceError {
    median: f64,
    p95: f64,
}

impl SurfaceError {
    /// Those of places in the box with the corners `bounds` (map frame) that the map has occupied; none if there are no such places.
    pub fn new(world: &World, map: &AtlasQuery<'_>, [low, high]: [Point; 2]) -> Option<Self> {
        let volume: f64 = (0..3).map(|k| high[k] - low[k]).product();
        let count = ((volume / (SAMPLED * map.voxel_size()).powi(3)) as usize).min(MOST);
        let place = |i: usize| -> Point { std::array::from_fn(|k| low[k] + (EVEN[k] * i as f64).fract() * (high[k] - low[k])) };
        let mut errors = Vec::new();
        for first in (0..count).step_by(AT_ONCE) {
            let places: Vec<Point> = (first..count.min(first + AT_ONCE)).map(place).collect();
            let states = map.states(&places);
            let occupied = places.into_iter().zip(states).filter(|(_, state)| *state == State::Occupied);
            let occupied: Vec<Point> = occupied.map(|(place, _)| place).collect();
            errors.par_extend(occupied.par_iter().map(|place| world.distance(*place).abs()));
        }
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors.get((share * errors.len().saturating_sub(1) as f64).round() as usize).copied();
        Some(Self { median: at(0.5)?, p95: at(0.95)? })
    }
}
