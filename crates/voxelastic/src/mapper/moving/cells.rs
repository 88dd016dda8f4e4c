//! A range image in two bytes a pixel, to be kept.

use crate::sensor::RangeImage;

/// Ranges are stored in steps of this, metres.
pub(super) const STEP: f32 = 0.02;
/// A cell without return.
pub(super) const HOLE: u16 = u16::MAX;
/// Most steps.
const FARTHEST: f32 = 65_000.0;
/// Pixels of a row are joined until there are at most so many cells.
const MOST_COLUMNS: usize = 1024;

/// The nearest return of each cell of a range image, a cell being one or several pixels of a row.
#[derive(Clone, Debug)]
pub(in crate::mapper) struct Cells {
    pub rows: usize,
    pub columns: usize,
    /// A cell is so many pixels wide, as a power of two.
    pub shift: u32,
    /// In steps, at least one; or [`HOLE`].
    pub steps: Vec<u16>,
}

impl Cells {
    pub fn new(image: &RangeImage) -> Self {
        // Beyond the maximum range is no farther than that, for all that is known.
        let farthest = image.ranges.iter().copied().filter(|range| range.is_finite()).fold(0.0, f32::max).min(FARTHEST * STEP);
        let steps = |&range: &f32| {
            let steps = if range < farthest { range / STEP } else { farthest / STEP };
            if range > 0.0 { (steps as i32 as u16).max(1) } else { HOLE }
        };
        let mut cells = Self { rows: image.rows, columns: image.columns, shift: 0, steps: image.ranges.iter().map(steps).collect() };
        while cells.columns > MOST_COLUMNS {
            let (columns, half) = (cells.columns, cells.columns.div_ceil(2));
            let pairs = cells.steps.chunks_exact(columns).flat_map(|row| row.chunks(2).map(|pair| pair.iter().copied().min().unwrap_or(HOLE)));
            cells.steps = pairs.collect();
            (cells.columns, cells.shift) = (half, cells.shift + 1);
        }
        cells
    }
}
