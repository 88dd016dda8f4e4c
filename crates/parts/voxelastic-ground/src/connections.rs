//! Where the floor of a storey goes on in another: stairs, ramps.

use crate::cells::Cells;
use crate::follow::neighbours;
use crate::levels::Levels;
use crate::storeys::NO_STOREY;
use std::collections::BTreeMap;

/// Places as near as this are one, metres.
const NEAR: f64 = 0.6;

/// A place where two storeys connect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Connection {
    /// The two storeys, by number.
    pub storeys: [usize; 2],
    /// The middle of the place, map frame, metres.
    pub at: [f64; 3],
    /// How wide the place is, metres.
    pub width: f64,
    /// Largest step there, metres.
    pub step: f64,
}

/// A pair of levels of two storeys, next to each other.
struct Crossing {
    cell: usize,
    height: f32,
    step: f32,
}

/// Where levels of two storeys are next to each other.
pub(crate) fn connections(levels: &Levels, cells: &Cells, of_level: &[u16]) -> Vec<Connection> {
    let mut pairs: BTreeMap<[u16; 2], Vec<Crossing>> = BTreeMap::new();
    let is_floor: Vec<bool> = of_level.iter().map(|storey| *storey != NO_STOREY).collect();
    for cell in 0..cells.count() {
        for k in levels.of_cell(cell).filter(|k| of_level[*k] != NO_STOREY) {
            let height = levels.all()[k].height;
            neighbours(levels, cells, &is_floor, (cell, height), |other| {
                if of_level[other] > of_level[k] {
                    let step = (levels.all()[other].height - height).abs();
                    pairs.entry([of_level[k], of_level[other]]).or_default().push(Crossing { cell, height, step });
                }
            });
        }
    }
    let places = pairs.into_iter().flat_map(|(pair, crossings)| {
        let storeys = pair.map(usize::from);
        clusters(cells, crossings).into_iter().map(move |place| connection(cells, storeys, &place)).collect::<Vec<_>>()
    });
    places.collect()
}

/// Crossings that are near each other.
fn clusters(cells: &Cells, crossings: Vec<Crossing>) -> Vec<Vec<Crossing>> {
    let mut by_cell: BTreeMap<usize, Vec<Crossing>> = BTreeMap::new();
    for crossing in crossings {
        by_cell.entry(crossing.cell).or_default().push(crossing);
    }
    let reach = cells.reach(NEAR);
    let mut places = Vec::new();
    while let Some((first, crossings)) = by_cell.pop_first() {
        let (mut place, mut queue) = (crossings, vec![first]);
        while let Some(cell) = queue.pop() {
            for y in -reach..=reach {
                let ends = [-reach, reach].map(|x| beside_clamped(cells, cell, [x, y]));
                let [Some(low), Some(high)] = ends else { continue };
                while let Some((&other, _)) = by_cell.range(low..=high).next() {
                    place.extend(by_cell.remove(&other).into_iter().flatten());
                    queue.push(other);
                }
            }
        }
        places.push(place);
    }
    places
}

/// The cell beside another; the last of its row if it would be outside.
fn beside_clamped(cells: &Cells, cell: usize, [x, y]: [i32; 2]) -> Option<usize> {
    let row = cells.beside(cell, [0, y])?;
    let at = (row % cells.size[0]) as i64 + i64::from(x);
    Some(row - row % cells.size[0] + at.clamp(0, cells.size[0] as i64 - 1) as usize)
}

fn connection(cells: &Cells, storeys: [usize; 2], place: &[Crossing]) -> Connection {
    let n = place.len() as f64;
    let points: Vec<[f64; 3]> = place
        .iter()
        .map(|c| {
            let [x, y] = cells.centre(c.cell);
            [x, y, f64::from(c.height)]
        })
        .collect();
    let at: [f64; 3] = [0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / n);
    let far = points.iter().map(|p| (p[0] - at[0]).hypot(p[1] - at[1])).fold(0.0, f64::max);
    let step = place.iter().map(|c| f64::from(c.step)).fold(0.0, f64::max);
    Connection { storeys, at, width: 2.0 * far + cells.edge, step }
}
