//! 2-D maps: what a robot on the floor of a storey meets.

use crate::cells::Cells;
use crate::column::{Span, band};
use crate::columns::Columns;
use crate::floor_cell::{FloorCell, Known};
use crate::levels::GAP;
use crate::robot::Body;
use crate::storey::{Storey, whole_index};
use rayon::prelude::*;
use voxelastic::field::occupancy::State;

/// A 2-D map.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Its cells.
    pub cells: Cells,
    /// Their states, in the order of [`Cells::index`].
    pub states: Vec<State>,
    /// What it takes to be there, 0 to 99, by how much of what the robot climbs the floor takes; 0 where nothing is known.
    pub costs: Vec<u8>,
}

impl Grid {
    /// The 2-D map of a storey.
    pub fn of(columns: &Columns, storey: &Storey, body: &Body) -> Self {
        let voxel = columns.voxel();
        let state = |cell: usize| match whole_index(columns.cells(), &storey.cells, cell) {
            Some(whole) => cell_state(&|| columns.spans(whole), &storey.floor[cell], body, voxel),
            None => State::Unknown,
        };
        let cost = |cell: &FloorCell| (99.0 * cell.difficulty.clamp(0.0, 1.0)).round() as u8;
        let states = (0..storey.cells.count()).into_par_iter().map(state).collect();
        Self { cells: storey.cells, states, costs: storey.floor.iter().map(cost).collect() }
    }
}

/// Where the floor falls away it is occupied this far beyond the last floor that was seen, metres: farther, nobody knows.
const EDGE: f32 = 0.3;

/// The state of a cell for a robot that comes over the floor around it.
///
/// It is occupied where the floor is steeper than the robot climbs, where anything is in the band between the robot's step and its height above the floor, and where the
/// floor falls away; free where the floor is known and the whole band was seen free; else unknown.
fn cell_state<I: Iterator<Item = Span>>(spans: &impl Fn() -> I, floor: &FloorCell, body: &Body, voxel: f64) -> State {
    let height = f64::from(floor.height);
    // What the floor's own voxels fill is no obstacle.
    let lowest = body.step.max(1.5 * voxel);
    let to = height + body.height.max(lowest + voxel);
    match floor.known {
        Known::No => State::Unknown,
        Known::Seen if floor.is_steep() => State::Occupied,
        Known::Seen => {
            let from = (height + body.step).max(f64::from(floor.top));
            // The floor was seen, so nothing stands on it, also where the beams are too far apart to show that the space right above it is free.
            if from < to { band(spans(), [from, to], f64::from(floor.top) + GAP) } else { State::Unknown }
        }
        Known::Between | Known::Beyond if floor.beyond <= EDGE && falls_away(spans(), height - lowest, height) => State::Occupied,
        Known::Between => band(spans(), [height + lowest, to], height),
        Known::Beyond => match band(spans(), [height + lowest, to], height) {
            State::Occupied => State::Occupied,
            _ => State::Unknown,
        },
    }
}

/// Whether free space goes down from the height of the floor to below `low`.
fn falls_away(mut spans: impl Iterator<Item = Span>, low: f64, height: f64) -> bool {
    spans.any(|span| !span.occupied && span.low < low && span.high >= height)
}

impl Grid {
    /// The same grid, enlarged by unknown cells so that its ends are at multiples of `block` cells: as a map grows, its origin seldom moves.
    pub fn padded(&self, block: i32) -> Self {
        let low = self.cells.low.map(|c| c.div_euclid(block) * block);
        let high = [0, 1].map(|k| (self.cells.low[k] + self.cells.size[k] as i32 + block - 1).div_euclid(block) * block);
        let cells = Cells { low, size: [0, 1].map(|k| (high[k] - low[k]) as usize), ..self.cells };
        let mut padded = Self { cells, states: vec![State::Unknown; cells.count()], costs: vec![0; cells.count()] };
        for (row, (states, costs)) in self.states.chunks(self.cells.size[0]).zip(self.costs.chunks(self.cells.size[0])).enumerate() {
            let Some(first) = cells.index([self.cells.low[0], self.cells.low[1] + row as i32]) else { continue };
            padded.states[first..first + states.len()].copy_from_slice(states);
            padded.costs[first..first + costs.len()].copy_from_slice(costs);
        }
        padded
    }
}
