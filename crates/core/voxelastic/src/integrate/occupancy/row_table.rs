//! From the sine of an elevation to the row of the range image, for many directions at a time.
//!
//! Unlike [`sensor::row_lookup`](crate::sensor), which finds the exact row of one elevation, this table interpolates between evenly spaced sines: no arcsine and no
//! comparison for each of the 256 directions of a query, and a fiftieth of a row is accurate enough for the bounds of the pyramid.

use crate::simd::floor_positive;
use crate::simd::gather;
use std::f32::consts::PI;

/// Maps sines of elevations to fractional rows of the image.
#[derive(Clone, Debug)]
pub(super) struct RowTable {
    /// Row (fractional) by sine of the elevation, evenly spaced from `lowest`; rows count from the top.
    table: Vec<f32>,
    per_sine: f32,
    /// Sines of the lower and upper limit of the field of view, one row beyond the outermost rays.
    pub lowest: f32,
    /// See [`RowTable::lowest`].
    pub highest: f32,
    /// RowTable.
    pub count: usize,
    /// Largest density of rows, rows per radian.
    pub per_radian: f32,
}

impl RowTable {
    const BINS: usize = 2048;

    /// From the elevations of the rows, radians, top to bottom (strictly descending), at least two.
    pub fn new(elevations: &[f32]) -> Self {
        let count = elevations.len();
        let gap = |i: usize| (elevations[i] - elevations[i + 1]).max(1e-5);
        let (top, bottom) = (elevations[0] + gap(0), elevations[count - 1] - gap(count - 2));
        let (lowest, highest) = (bottom.max(-PI / 2.0).sin(), top.min(PI / 2.0).sin());
        let per_sine = Self::BINS as f32 / (highest - lowest);
        let mut row = count - 2;
        let table = (0..=Self::BINS)
            .map(|bin| {
                let elevation = (lowest + bin as f32 / per_sine).clamp(-1.0, 1.0).asin();
                // Bins go up, rows go down.
                while row > 0 && elevation > elevations[row] {
                    row -= 1;
                }
                row as f32 + (elevations[row] - elevation) / gap(row)
            })
            .collect();
        let per_radian = 1.0 / (0..count - 1).map(gap).fold(f32::INFINITY, f32::min);
        Self { table, per_sine, lowest, highest, count, per_radian }
    }

    /// Fractional rows at sines of elevation: 0 is the centre of the top row. At most one row beyond the field of view; never NaN. All slices must be as long as
    /// `sines`, or longer; `bins` and `next` are scratch memory.
    #[inline(always)]
    pub fn rows(&self, sines: &[f32], rows: &mut [f32], bins: &mut [u32], next: &mut [f32]) {
        let (lowest, per_sine, count) = (self.lowest, self.per_sine, sines.len());
        let (rows, bins, next) = (&mut rows[..count], &mut bins[..count], &mut next[..count]);
        for i in 0..count {
            bins[i] = floor_positive(bin(sines[i], lowest, per_sine)) as u32;
        }
        gather(&self.table[..Self::BINS], bins, rows);
        gather(&self.table[1..], bins, next);
        for i in 0..count {
            let fraction = bin(sines[i], lowest, per_sine) - bins[i] as i32 as f32;
            rows[i] += (next[i] - rows[i]) * fraction;
        }
    }
}

/// Fractional index into the table.
#[inline(always)]
fn bin(sine: f32, lowest: f32, per_sine: f32) -> f32 {
    let at = (sine - lowest) * per_sine;
    let at = if at > 0.0 { at } else { 0.0 };
    if at < RowTable::BINS as f32 - 1.0 { at } else { RowTable::BINS as f32 - 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_follow_uneven_elevations() {
        let elevations: Vec<f32> = [17.0f32, 12.0, 10.0, 9.0, 5.0, -1.0, -12.0].map(f32::to_radians).into();
        let table = RowTable::new(&elevations);
        let row_at = |elevation: f32| {
            let mut row = [0f32];
            table.rows(&[elevation.sin()], &mut row, &mut [0], &mut [0.0]);
            row[0]
        };
        for (i, e) in elevations.iter().enumerate() {
            assert!((row_at(*e) - i as f32).abs() < 0.02, "row {i} at {}", row_at(*e));
        }
        for w in 0..elevations.len() - 1 {
            let middle = 0.5 * (elevations[w] + elevations[w + 1]);
            assert!((row_at(middle) - w as f32 - 0.5).abs() < 0.02);
        }
    }
}
