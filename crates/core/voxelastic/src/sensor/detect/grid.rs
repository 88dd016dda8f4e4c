//! Organised clouds: the pixels are given, their directions are measured.

use super::angles::{Direction, circular_mean, median, mode, wrap};
use super::rings::{Ring, columns_of_turn, rows};
use crate::Cloud;
use crate::sensor::beam_model::{BeamModel, BeamTables};
use crate::sensor::cloud_layout::{CloudLayout, Grid};
use std::f32::consts::TAU;

/// The clouds' common grid and the beams of its pixels, if they are organised and every ring keeps its elevation.
pub(super) fn recognise(clouds: &[&Cloud]) -> Option<(BeamModel, CloudLayout)> {
    let first = clouds.first()?;
    let same = |c: &&Cloud| c.is_organised() && (c.width, c.height) == (first.width, first.height) && c.width > 1;
    if !clouds.iter().all(same) {
        return None;
    }
    [false, true].into_iter().find_map(|transposed| recognise_way(clouds, transposed))
}

/// A return and its column.
struct Cell {
    ring: usize,
    column: usize,
    direction: Direction,
}

fn recognise_way(clouds: &[&Cloud], transposed: bool) -> Option<(BeamModel, CloudLayout)> {
    let (rings, columns) = if transposed { (clouds[0].width, clouds[0].height) } else { (clouds[0].height, clouds[0].width) };
    let at = |i: usize| if transposed { (i % rings, i / rings) } else { (i / columns, i % columns) };
    let cell = |(i, p): (usize, &[f32; 3])| Direction::of(p).map(|direction| Cell { ring: at(i).0, column: at(i).1, direction });
    // In the order of the rings, so that neighbours in the list are neighbours in the grid.
    let mut cells: Vec<Cell> = clouds.iter().flat_map(|cloud| cloud.points.iter().enumerate().filter_map(cell)).collect();
    cells.sort_by_key(|c| (c.ring, c.column));
    let neighbours = cells.windows(2).filter(|w| w[0].ring == w[1].ring && w[1].column == w[0].column + 1);
    let steps: Vec<f32> = neighbours.map(|w| wrap(w[1].direction.azimuth - w[0].direction.azimuth)).collect();
    let one_way = steps.iter().filter(|s| **s < 0.0).count() as f32 / steps.len().max(1) as f32;
    let clockwise = one_way > 0.5;
    let sizes: Vec<f32> = steps.iter().map(|s| s.abs()).collect();
    let step = mode(&sizes, 2e-4, 0.2)?;
    if one_way.max(1.0 - one_way) < 0.8 {
        return None;
    }
    let turn = columns_of_turn(step, columns);
    let mut by_ring: Vec<Ring> = vec![Ring::new(); rings];
    cells.iter().for_each(|c| by_ring[c.ring].push(c.direction));
    let rows = rows(&by_ring, true);
    if !keeps_elevation(&by_ring, &rows.elevations, rows.origin) {
        return None;
    }
    let offsets = offsets(&cells, rings, clockwise, turn);
    let (centre, table) = centred(&offsets, TAU / turn as f32);
    let model = BeamModel::from_tables(BeamTables {
        name: "organised cloud".into(),
        elevations: rows.elevations,
        azimuth_offsets: table,
        columns: turn,
        clockwise,
        azimuth_of_first: centre,
        origin_radius: rows.origin[0],
        origin_height: rows.origin[1],
    })
    .ok()?;
    let row_of_ring = model.row_of_ring().to_vec();
    let shift_of_ring = row_of_ring.iter().map(|&row| model.shifts()[usize::from(row)]).collect();
    Some((model, CloudLayout::Grid(Grid { transposed, row_of_ring, shift_of_ring })))
}

/// Whether the returns of each ring are on its cone; if not, the cloud is organised in another way (a camera, a map).
fn keeps_elevation(rings: &[Ring], elevations: &[f32], origin: [f32; 2]) -> bool {
    let off = |(ring, &elevation): (&Ring, &f32)| {
        median(ring.iter().map(|r| ((r.height - origin[1]).atan2(r.horizontal - origin[0]) - elevation).abs()).collect())
    };
    let typical = median(rings.iter().zip(elevations).filter(|(ring, _)| !ring.is_empty()).map(off).collect());
    let (top, bottom) = elevations.iter().fold((f32::MIN, f32::MAX), |(t, b), e| (t.max(*e), b.min(*e)));
    typical < 0.4 * (top - bottom) / (rings.len().max(2) - 1) as f32
}

/// Azimuth of each ring's column 0, radians: the mean over the ring.
fn offsets(cells: &[Cell], rings: usize, clockwise: bool, turn: usize) -> Vec<Option<f32>> {
    let step = if clockwise { -TAU } else { TAU } / turn as f32;
    let mut by_ring: Vec<Vec<f32>> = vec![Vec::new(); rings];
    cells.iter().for_each(|c| by_ring[c.ring].push(wrap(c.direction.azimuth - c.column as f32 * step)));
    by_ring.into_iter().map(|ring| (!ring.is_empty()).then(|| circular_mean(ring.into_iter()))).collect()
}

/// A common azimuth of column 0, and each ring's offset from it.
///
/// Rings that differ by little more than a column belong to a cloud that is upright already: none is shifted. (Beams that
/// start beside the axis look a little to the side of what is measured of near walls and ground.) Others are staggered, and
/// the mean is where the sensor's maker has its zero.
fn centred(offsets: &[Option<f32>], step: f32) -> (f32, Vec<f32>) {
    let mean = circular_mean(offsets.iter().flatten().copied());
    let from_mean: Vec<f32> = offsets.iter().map(|o| o.map_or(0.0, |o| wrap(o - mean))).collect();
    let (low, high) = from_mean.iter().fold((f32::MAX, f32::MIN), |(l, h), o| (l.min(*o), h.max(*o)));
    if high - low > 1.5 * step {
        return (mean, from_mean);
    }
    let (middle, half) = (0.5 * (low + high), 0.499 * step);
    (mean + middle, from_mean.iter().map(|o| (o - middle).clamp(-half, half)).collect())
}
