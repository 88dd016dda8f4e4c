//! The columns of a whole map: what is occupied and what is free above and below each cell of a grid.

use crate::GroundError;
use crate::cells::Cells;
use crate::column::Span;
use rayon::prelude::*;
use voxelastic::query::Cube;

/// Most cells of a grid.
pub(crate) const MOST_CELLS: usize = 400_000_000;
/// No span.
const NONE: u32 = u32::MAX;

/// The columns of a map. A part of a column of a cell is occupied if it is in any of the voxels side by side in it, and free if it is in all.
#[derive(Clone, Debug)]
pub struct Columns {
    cells: Cells,
    /// Edge of the cubes that heights are multiples of, metres, and the height of the lowest in cubes.
    cube: f64,
    lowest: i32,
    /// First run of each cell, and the number of all.
    starts: Vec<u32>,
    runs: Vec<Run>,
}

/// A span in cubes above the lowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Run {
    low: u16,
    high: u16,
    occupied: bool,
}

/// How the cells of a grid lie over voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lattice {
    /// Edge of a cell, metres.
    pub resolution: f64,
    /// Voxels side by side in a cell.
    pub side: usize,
    /// Their edge, metres.
    pub cube: f64,
    /// log2 of the edge of a tile in cells; also of the cubes that are looked up together, in voxels.
    pub shift: u32,
}

impl Lattice {
    pub fn new(resolution: f64, finest: f64, shift: u32) -> Result<Self, GroundError> {
        if !(0.5 * finest..=100.0 * finest).contains(&resolution) {
            return Err(GroundError::Resolution { resolution, finest });
        }
        let side = ((resolution / finest - 1e-3).ceil() as usize).max(1);
        Ok(Self { resolution, side, cube: resolution / side as f64, shift })
    }
}

impl Columns {
    /// The columns of a part of the grid, `size` cells from `low` along x and y, of all cubes that are in it.
    pub(crate) fn of_part(cubes: Vec<Cube>, lattice: &Lattice, (low, size): ([i32; 2], usize), bounds: &Bounds) -> Result<Self, GroundError> {
        let (side, high) = (lattice.side, bounds.high[2] - bounds.low[2]);
        if high > i32::from(u16::MAX) {
            return Err(GroundError::TooLarge { size: [size; 2], high: high as usize });
        }
        let fine = Cells { edge: lattice.cube, low: low.map(|c| c * side as i32), size: [size * side; 2] };
        let (starts, runs) = stack(cubes, &fine, bounds.low[2]);
        let columns = Self { cells: fine, cube: lattice.cube, lowest: bounds.low[2], starts, runs };
        let cells = Cells { edge: lattice.resolution, low, size: [size; 2] };
        Ok(if side > 1 { columns.joined(cells, side) } else { Self { cells, ..columns } })
    }

    /// Columns of no cell yet.
    pub(crate) fn empty(cells: Cells, cube: f64, lowest: i32) -> Self {
        Self { cells, cube, lowest, starts: vec![0], runs: Vec::new() }
    }

    /// Adds the next cell, as it is in a part.
    pub(crate) fn push(&mut self, cell: Option<(&Self, usize)>) {
        if let Some((part, cell)) = cell {
            let up = (part.lowest - self.lowest) as u16;
            self.runs.extend(part.of_cell(cell).iter().map(|run| Run { low: run.low + up, high: run.high + up, ..*run }));
        }
        self.starts.push(self.runs.len() as u32);
    }

    /// The grid.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// Edge of the voxels that columns consist of, metres: at most that of a cell.
    pub fn voxel(&self) -> f64 {
        self.cube
    }

    /// What is known of the column of a cell, from below.
    pub fn spans(&self, cell: usize) -> impl DoubleEndedIterator<Item = Span> + '_ {
        self.of_cell(cell).iter().map(|run| {
            let [low, high] = [run.low, run.high].map(|c| f64::from(self.lowest + i32::from(c)) * self.cube);
            Span { low, high, occupied: run.occupied }
        })
    }

    fn of_cell(&self, cell: usize) -> &[Run] {
        &self.runs[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// The columns of cells that `side` x `side` of these are in.
    fn joined(self, cells: Cells, side: usize) -> Self {
        let row = |y: usize| -> Vec<(u32, Vec<Run>)> {
            let cell = |x: usize| {
                let within = (0..side * side).map(|k| (x * side + k % side) + self.cells.size[0] * (y * side + k / side));
                let parts: Vec<&[Run]> = within.map(|fine| self.of_cell(fine)).collect();
                let joined = join(&parts);
                (joined.len() as u32, joined)
            };
            (0..cells.size[0]).map(cell).collect()
        };
        let rows: Vec<Vec<(u32, Vec<Run>)>> = (0..cells.size[1]).into_par_iter().map(row).collect();
        let mut starts = vec![0];
        let mut runs = Vec::new();
        for (_, cell) in rows.into_iter().flatten() {
            runs.extend(cell);
            starts.push(runs.len() as u32);
        }
        Self { cells, starts, runs, ..self }
    }
}

/// Columns side by side as one: occupied where one is, free where all are.
fn join(parts: &[&[Run]]) -> Vec<Run> {
    let mut ends: Vec<u16> = parts.iter().flat_map(|part| part.iter().flat_map(|run| [run.low, run.high])).collect();
    ends.sort_unstable();
    ends.dedup();
    let mut joined: Vec<Run> = Vec::new();
    let mut next = vec![0; parts.len()];
    for pair in ends.windows(2) {
        let (mut occupied, mut free) = (false, 0);
        for (part, next) in parts.iter().zip(&mut next) {
            while part.get(*next).is_some_and(|run| run.high <= pair[0]) {
                *next += 1;
            }
            if let Some(run) = part.get(*next).filter(|run| run.low <= pair[0]) {
                occupied |= run.occupied;
                free += usize::from(!run.occupied);
            }
        }
        if !occupied && free < parts.len() {
            continue;
        }
        match joined.last_mut() {
            Some(last) if last.high == pair[0] && last.occupied == occupied => last.high = pair[1],
            _ => joined.push(Run { low: pair[0], high: pair[1], occupied }),
        }
    }
    joined
}

/// The box around cubes, in multiples of their edge from zero.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub low: [i32; 3],
    pub high: [i32; 3],
}

/// [`Cube::corner`] of a cube at the origin.
const ORIGIN: i32 = 1 << 20;

fn corner(cube: &Cube) -> [i32; 3] {
    cube.corner.map(|c| c as i32 - ORIGIN)
}

impl Bounds {
    pub fn of(cubes: &[Cube]) -> Option<Self> {
        let mut bounds = Self { low: [i32::MAX; 3], high: [i32::MIN; 3] };
        for cube in cubes {
            for (k, low) in corner(cube).into_iter().enumerate() {
                bounds.low[k] = bounds.low[k].min(low);
                bounds.high[k] = bounds.high[k].max(low + (1 << cube.level));
            }
        }
        (!cubes.is_empty()).then_some(bounds)
    }

    /// The box around this and another.
    pub fn with(self, other: &Self) -> Self {
        Self { low: [0, 1, 2].map(|k| self.low[k].min(other.low[k])), high: [0, 1, 2].map(|k| self.high[k].max(other.high[k])) }
    }

    /// The cells of `side` cubes around it.
    pub fn cells(&self, edge: f64, side: i32) -> Cells {
        let low = [0, 1].map(|k| self.low[k].div_euclid(side));
        let size = [0, 1].map(|k| ((self.high[k] - 1).div_euclid(side) - low[k] + 1) as usize);
        Cells { edge, low, size }
    }
}

/// Sorts cubes into columns: the first run of each, and all runs from below.
fn stack(mut cubes: Vec<Cube>, cells: &Cells, lowest: i32) -> (Vec<u32>, Vec<Run>) {
    cubes.sort_unstable_by_key(|cube| (cube.corner[2], cube.corner[1], cube.corner[0]));
    // The last run of each column, and of each run the one before.
    let mut last = vec![NONE; cells.count()];
    let mut all: Vec<(Run, u32)> = Vec::new();
    for cube in &cubes {
        let ([x, y, z], edge) = (corner(cube), 1 << cube.level);
        let run = Run { low: (z - lowest) as u16, high: (z - lowest + edge) as u16, occupied: cube.value > 0 };
        for row in y..y + edge {
            let Some(first) = cells.index([x, row]) else { continue };
            for last in &mut last[first..first + edge as usize] {
                match all.get_mut(*last as usize) {
                    Some((below, _)) if below.high == run.low && below.occupied == run.occupied => below.high = run.high,
                    _ => {
                        all.push((run, *last));
                        *last = all.len() as u32 - 1;
                    }
                }
            }
        }
    }
    let mut starts = Vec::with_capacity(last.len() + 1);
    let mut runs = Vec::with_capacity(all.len());
    starts.push(0);
    for mut at in last {
        let first = runs.len();
        while let Some((run, before)) = all.get(at as usize) {
            runs.push(*run);
            at = *before;
        }
        runs[first..].reverse();
        starts.push(runs.len() as u32);
    }
    (starts, runs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against a walk over all voxels.
        #[test]
        fn columns_side_by_side_are_joined_voxel_by_voxel(states in prop::collection::vec(prop::collection::vec(0..3u8, 12), 4)) {
            let runs = |column: &Vec<u8>| -> Vec<Run> {
                let mut low = 0;
                let all = column.chunk_by(|a, b| a == b).map(|run| {
                    low += run.len() as u16;
                    (run[0], Run { low: low - run.len() as u16, high: low, occupied: run[0] == 2 })
                });
                all.filter(|(state, _)| *state > 0).map(|(_, run)| run).collect()
            };
            let columns: Vec<Vec<Run>> = states.iter().map(runs).collect();
            let joined = join(&columns.iter().map(Vec::as_slice).collect::<Vec<_>>());
            for z in 0..12 {
                let here: Vec<u8> = states.iter().map(|column| column[z]).collect();
                let expected = if here.contains(&2) { 2 } else { u8::from(!here.contains(&0)) };
                let found = joined.iter().find(|run| (run.low..run.high).contains(&(z as u16)));
                prop_assert_eq!(found.map_or(0, |run| 1 + u8::from(run.occupied)), expected);
            }
            prop_assert!(joined.windows(2).all(|pair| pair[0].high < pair[1].low || (pair[0].high == pair[1].low && pair[0].occupied != pair[1].occupied)));
        }
    }
}
