//! Pieces of surface that float: nothing is around them, and there is a floor below. A lamp is one, and so is what somebody left who stood in the way.

use super::suggestion::Suggestion;
use crate::editing::list::Edit;
use crate::editing::region::Region;
use std::collections::{BTreeMap, HashMap};
use voxelastic::atlas::SubmapId;
use voxelastic::changes::OccupancyThen;
use voxelastic::surface::Mesh;
use voxelastic_io::Origin;

/// Edge of the cells whose neighbours hang together, finest voxels.
const CELL: f64 = 2.0;
/// Cells of a piece: fewer are dust.
const LEAST_CELLS: usize = 8;
/// Largest extent of a piece that floats, metres.
const LARGEST: f64 = 3.0;
/// Edge of the columns in which something has to be below, and by how much, metres.
const COLUMN: f64 = 0.5;
const BELOW: f64 = 0.3;
/// Share of the cells of a piece that have to have something below.
const SHARE: f64 = 0.5;

type Cell = [i32; 3];

/// Cells that hang together.
#[derive(Default)]
struct Piece {
    cells: Vec<Cell>,
    low: [f64; 3],
    high: [f64; 3],
    submaps: Vec<SubmapId>,
    /// Vertices.
    size: usize,
}

/// The pieces that float, the largest first, with their sizes.
pub fn floating(surfaces: &[(SubmapId, Mesh)], voxel: f64, origin: Origin) -> Vec<(usize, Suggestion)> {
    let edge = CELL * voxel;
    let cell_of = |p: &[f32; 3]| p.map(|c| (f64::from(c) / edge).floor() as i32);
    let mut cells: Vec<Cell> = surfaces.iter().flat_map(|(_, mesh)| mesh.positions.iter().map(cell_of)).collect();
    cells.sort_unstable();
    cells.dedup();
    let number: HashMap<Cell, u32> = cells.iter().copied().zip(0..).collect();
    let piece_of = joined(&cells, &number);
    let mut pieces: BTreeMap<u32, Piece> = BTreeMap::new();
    for (cell, piece) in cells.iter().zip(&piece_of) {
        pieces.entry(*piece).or_default().cells.push(*cell);
    }
    // Most of a map is one piece; those that may float are looked at alone.
    pieces.retain(|_, piece| {
        let extent = |k: usize| piece.cells.iter().map(|c| c[k]).max().zip(piece.cells.iter().map(|c| c[k]).min()).map_or(0, |(a, b)| a - b);
        piece.cells.len() >= LEAST_CELLS && (0..3).all(|k| f64::from(extent(k)) * edge < LARGEST)
    });
    let mut lowest: HashMap<[i32; 2], f64> = HashMap::new();
    let column = |x: f64, y: f64| [(x / COLUMN).floor() as i32, (y / COLUMN).floor() as i32];
    for (submap, mesh) in surfaces {
        for p in &mesh.positions {
            let [x, y, z] = p.map(f64::from);
            lowest.entry(column(x, y)).and_modify(|low| *low = low.min(z)).or_insert(z);
            let Some(piece) = pieces.get_mut(&piece_of[number[&cell_of(p)] as usize]) else { continue };
            if piece.size == 0 {
                (piece.low, piece.high) = ([x, y, z], [x, y, z]);
            }
            piece.low = std::array::from_fn(|k| piece.low[k].min([x, y, z][k]));
            piece.high = std::array::from_fn(|k| piece.high[k].max([x, y, z][k]));
            piece.size += 1;
            if piece.submaps.last() != Some(submap) {
                piece.submaps.push(*submap);
            }
        }
    }
    let floats = |piece: &Piece| {
        let is_above = |cell: &&Cell| {
            let [x, y, _] = cell.map(|c| (f64::from(c) + 0.5) * edge);
            lowest.get(&column(x, y)).is_some_and(|low| low + BELOW < piece.low[2])
        };
        piece.cells.iter().filter(is_above).count() as f64 >= SHARE * piece.cells.len() as f64
    };
    // A piece with others in its box is one that a box would not cut out.
    let is_alone = |own: u32, piece: &Piece| {
        let [low, high] = [piece.low, piece.high].map(|corner| cell_of(&corner.map(|c| c as f32)));
        let range = |k: usize| low[k] - 1..=high[k] + 1;
        let others = |cell: Cell| number.get(&cell).is_some_and(|n| piece_of[*n as usize] != own);
        !range(0).any(|x| range(1).any(|y| range(2).any(|z| others([x, y, z]))))
    };
    let mut found: Vec<(usize, Suggestion)> = pieces
        .iter()
        .filter(|(own, piece)| floats(piece) && is_alone(**own, piece))
        .map(|(_, piece)| (piece.size, suggestion(piece, voxel, origin)))
        .collect();
    found.sort_by(|(a, x), (b, y)| b.cmp(a).then(x.at.map(f64::to_bits).cmp(&y.at.map(f64::to_bits))));
    found
}

fn suggestion(piece: &Piece, voxel: f64, origin: Origin) -> Suggestion {
    let [low, high] = [(piece.low, -voxel), (piece.high, voxel)].map(|(corner, by)| origin.point_to_map(corner.map(|c| c + by)));
    // Centimetres are enough, and read better.
    let [min, max] = [low.map(|c| (c * 100.0).floor() / 100.0), high.map(|c| (c * 100.0).ceil() / 100.0)];
    let size = [0, 1, 2].map(|k| piece.high[k] - piece.low[k]);
    let edit =
        Edit::Erase { region: Region::Box { min, max, yaw: 0.0 }, surfaces: true, occupancy: Some(OccupancyThen::Unknown), submaps: Vec::new() };
    Suggestion {
        code: "floating",
        text: format!("a piece of {:.1} x {:.1} x {:.1} m floats: nothing is around it, and something is below", size[0], size[1], size[2]),
        at: std::array::from_fn(|k| (low[k] + high[k]) / 2.0),
        submaps: piece.submaps.clone(),
        scans: Vec::new(),
        places_agree: None,
        edit: Some(edit.to_text().trim().to_owned()),
    }
}

/// The piece of each cell: cells that touch, at a corner too, are of one.
fn joined(cells: &[Cell], number: &HashMap<Cell, u32>) -> Vec<u32> {
    let mut above: Vec<u32> = (0..cells.len() as u32).collect();
    fn root(above: &mut [u32], mut at: u32) -> u32 {
        while above[at as usize] != at {
            above[at as usize] = above[above[at as usize] as usize];
            at = above[at as usize];
        }
        at
    }
    for (own, [x, y, z]) in (0..).zip(cells) {
        for shift in 0..27 {
            let other = [x + shift % 3 - 1, y + shift / 3 % 3 - 1, z + shift / 9 - 1];
            if let Some(other) = number.get(&other) {
                let (a, b) = (root(&mut above, own), root(&mut above, *other));
                // The smaller number is the root, whatever the order.
                above[a.max(b) as usize] = a.min(b);
            }
        }
    }
    (0..cells.len() as u32).map(|own| root(&mut above, own)).collect()
}
