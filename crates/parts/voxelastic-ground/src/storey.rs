//! One storey of a map.

use crate::Body;
use crate::cells::Cells;
use crate::floor::floor;
use crate::floor_cell::{FloorCell, Known};
use crate::levels::Levels;
use crate::storeys::NO_STOREY;

/// Cells around the floor of a storey that belong to its grid, metres: obstacles beside it.
const MARGIN: f64 = 1.5;

/// One storey: a floor with one height at a place.
#[derive(Clone, Debug)]
pub struct Storey {
    /// Its grid, a part of that of the map.
    pub cells: Cells,
    /// The floor of each cell.
    pub floor: Vec<FloorCell>,
    /// Median height of the floor in the map frame, metres.
    pub height: f64,
}

impl Storey {
    /// None if nothing of it is floor.
    pub(crate) fn new(all: &Cells, levels: &Levels, of_level: &[u16], storey: u16, body: &Body) -> Option<Self> {
        debug_assert_ne!(storey, NO_STOREY);
        let level_of = |cell: usize| levels.of_cell(cell).find(|k| of_level[*k] == storey);
        let cells = part_of(all, (0..all.count()).filter(|cell| level_of(*cell).is_some()))?;
        let of_cell: Vec<Option<u32>> = (0..cells.count()).map(|cell| Some(level_of(whole_index(all, &cells, cell)?)? as u32)).collect();
        let floor = floor(&cells, levels, &of_cell, body);
        let mut heights: Vec<f32> = floor.iter().filter(|cell| cell.known == Known::Seen).map(|cell| cell.height).collect();
        let middle = heights.len() / 2;
        let height = if heights.is_empty() { return None } else { *heights.select_nth_unstable_by(middle, f32::total_cmp).1 };
        Some(Self { cells, floor, height: f64::from(height) })
    }
}

/// The part of a grid around some of its cells.
fn part_of(all: &Cells, members: impl Iterator<Item = usize>) -> Option<Cells> {
    let bounds = members.fold(None, |bounds: Option<[[usize; 2]; 2]>, cell| {
        let at = [cell % all.size[0], cell / all.size[0]];
        let [low, high] = bounds.unwrap_or([at; 2]);
        Some([[0, 1].map(|k| low[k].min(at[k])), [0, 1].map(|k| high[k].max(at[k]))])
    });
    let [low, high] = bounds?;
    let margin = all.reach(MARGIN) as usize;
    let low = [0, 1].map(|k| low[k].saturating_sub(margin));
    let high = [0, 1].map(|k| (high[k] + margin + 1).min(all.size[k]));
    Some(Cells { edge: all.edge, low: [0, 1].map(|k| all.low[k] + low[k] as i32), size: [0, 1].map(|k| high[k] - low[k]) })
}

/// The index in the whole grid of a cell of a part of it.
pub(crate) fn whole_index(all: &Cells, part: &Cells, cell: usize) -> Option<usize> {
    let at = [cell % part.size[0], cell / part.size[0]];
    all.index([0, 1].map(|k| part.low[k] + at[k] as i32))
}
