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
        self.over(low, [0, 1].map(|k| (high[k] - low[k]) as usize))
    }

    /// What it says of `size` cells from `low`, whose edges are its own; unknown beyond its ends.
    pub fn over(&self, low: [i32; 2], size: [usize; 2]) -> Self {
        let cells = Cells { low, size, ..self.cells };
        let mut over = Self { cells, states: vec![State::Unknown; cells.count()], costs: vec![0; cells.count()] };
        for y in (low[1]..).take(size[1]) {
            let (begin, end) = (low[0].max(self.cells.low[0]), (low[0] + size[0] as i32).min(self.cells.low[0] + self.cells.size[0] as i32));
            let Some(count) = usize::try_from(end - begin).ok().filter(|count| *count > 0) else { break };
            if let (Some(from), Some(to)) = (self.cells.index([begin, y]), cells.index([begin, y])) {
                over.states[to..to + count].copy_from_slice(&self.states[from..from + count]);
                over.costs[to..to + count].copy_from_slice(&self.costs[from..from + count]);
            }
        }
        over
    }

    /// Marks the cells of a storey in which one of `points` (map frame, metres) is in the robot's way: above its largest step, below its height. For what a scan has just seen, and the map,
    /// whose voxels are `voxel` metres, does not take for occupied yet.
    pub fn mark(&mut self, storey: &Storey, body: &Body, voxel: f64, points: &[[f64; 3]]) {
        let lowest = body.step.max(1.5 * voxel);
        for p in points {
            let (Some(cell), Some(on)) = (self.cells.at([p[0], p[1]]), storey.cells.at([p[0], p[1]])) else { continue };
            let floor = &storey.floor[on];
            let height = p[2] - f64::from(floor.height);
            if floor.known != Known::No && (lowest..body.height.max(lowest + voxel)).contains(&height) {
                self.states[cell] = State::Occupied;
            }
        }
    }

    /// Where a robot stands nothing is unknown: cells within `radius` metres of `middle` (map frame) are free unless they are occupied.
    pub fn clear_under(&mut self, middle: [f64; 2], radius: f64) {
        for cell in 0..self.cells.count() {
            let [x, y] = self.cells.centre(cell);
            if self.states[cell] == State::Unknown && (x - middle[0]).hypot(y - middle[1]) <= radius {
                self.states[cell] = State::Free;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parts of a grid that lie within it, across its ends, and beyond them.
    #[test]
    fn a_part_of_a_grid_says_what_the_grid_says() {
        let cells = Cells { edge: 0.5, low: [-4, 7], size: [13, 9] };
        let all = [State::Free, State::Occupied, State::Unknown];
        let states = (0..cells.count()).map(|k| all[k * k % 3]).collect();
        let grid = Grid { cells, states, costs: (0..cells.count()).map(|k| (k % 99) as u8).collect() };
        for (low, size) in [([-2, 8], [5, 3]), ([-9, 2], [30, 30]), ([6, 10], [9, 20]), ([40, 40], [3, 3]), ([-20, 7], [4, 4]), ([0, 0], [0, 5])] {
            let part = grid.over(low, size);
            assert_eq!(part.states.len(), size[0] * size[1]);
            for cell in 0..part.cells.count() {
                let whole = cells.at(part.cells.centre(cell));
                assert_eq!(part.states[cell], whole.map_or(State::Unknown, |k| grid.states[k]));
                assert_eq!(part.costs[cell], whole.map_or(0, |k| grid.costs[k]));
            }
        }
        assert_eq!((grid.padded(8).cells.low, grid.padded(8).cells.size), ([-8, 0], [24, 16]));
    }
}
