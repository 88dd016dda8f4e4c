//! The space that a robot could know: what is connected with its start and empty, in the box that it explores.

use crate::World;
use rayon::prelude::*;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;

/// A place in the map frame, metres.
type Point = [f64; 3];

/// Edge of a cell, metres.
const CELL: f64 = 0.4;
/// A cell is empty if its centre is farther from every surface than this, metres: gaps that are narrower than twice as much are closed.
const CLEAR: f64 = 0.25;

/// Cells of empty space that are connected with the start.
#[derive(Clone, Debug)]
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
