//! The space that the robot could know: what is connected with its start and empty, in the box that it explores.

use rayon::prelude::*;
use serde::Serialize;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;
use voxelastic_plan::Point;
use voxelastic_sim::World;

/// Edge of a cell, metres.
const CELL: f64 = 0.4;
/// A cell is empty if its centre is farther from every surface than this, metres: gaps that are narrower than twice as much are closed.
const CLEAR: f64 = 0.25;

/// One place is compared with the true surfaces for each cube of this edge, voxels.
const SAMPLED: f64 = 2.0;
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
        let count = (volume / (SAMPLED * map.voxel_size()).powi(3)) as usize;
        let place = |i: usize| -> Point { std::array::from_fn(|k| low[k] + (EVEN[k] * i as f64).fract() * (high[k] - low[k])) };
        let places: Vec<Point> = (0..count).map(place).collect();
        let states = map.states(&places);
        let occupied: Vec<Point> = places.into_iter().zip(states).filter(|(_, state)| *state == State::Occupied).map(|(place, _)| place).collect();
        let mut errors: Vec<f64> = occupied.par_iter().map(|place| world.distance(*place).abs()).collect();
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors.get((share * errors.len().saturating_sub(1) as f64).round() as usize).copied();
        Some(Self { median: at(0.5)?, p95: at(0.95)? })
    }
}

/// Cells of empty space that are connected with the start.
pub struct ReachableSpace {
    centres: Vec<Point>,
}

impl ReachableSpace {
    /// The cells in the box with the corners `bounds`, map frame.
    pub fn new(world: &World, start: Point, [low, high]: [Point; 2]) -> Self {
        let size = [0, 1, 2].map(|k| ((high[k] - low[k]) / CELL).ceil().max(1.0) as usize);
        let centre = |c: [usize; 3]| -> Point { std::array::from_fn(|k| low[k] + (c[k] as f64 + 0.5) * CELL) };
        let of_index = |i: usize| [i % size[0], i / size[0] % size[1], i / size[0] / size[1]];
        let empty: Vec<bool> =
            (0..size.iter().product()).into_par_iter().with_min_len(1024).map(|i| world.distance(centre(of_index(i))) > CLEAR).collect();
        let index = |c: [usize; 3]| c[0] + size[0] * (c[1] + size[1] * c[2]);
        let first = [0, 1, 2].map(|k| (((start[k] - low[k]) / CELL).max(0.0) as usize).min(size[k] - 1));
        let mut reached = vec![false; empty.len()];
        let mut stack = Vec::new();
        if empty[index(first)] {
            reached[index(first)] = true;
            stack.push(first);
        }
        while let Some(cell) = stack.pop() {
            for axis in 0..3 {
                for step in [-1isize, 1] {
                    let mut next = cell;
                    let Some(c) = cell[axis].checked_add_signed(step).filter(|c| *c < size[axis]) else { continue };
                    next[axis] = c;
                    if empty[index(next)] && !std::mem::replace(&mut reached[index(next)], true) {
                        stack.push(next);
                    }
                }
            }
        }
        Self { centres: (0..empty.len()).filter(|i| reached[*i]).map(|i| centre(of_index(i))).collect() }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.centres.len()
    }

    /// Volume, cubic metres.
    pub fn volume(&self) -> f64 {
        self.centres.len() as f64 * CELL.powi(3)
    }

    /// Share of the cells whose centres a map knows, as free or as occupied.
    pub fn known_share(&self, map: &AtlasQuery<'_>) -> f64 {
        let known = map.states(&self.centres).into_iter().filter(|state| *state != State::Unknown).count();
        known as f64 / self.centres.len().max(1) as f64
    }
}
