//! Elevation to row by a table: beams need not be evenly spaced.

use crate::dispatch::gather;
use crate::geometry::whole;
use std::f32::consts::PI;

/// Maps directions to rows and columns of the image.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    /// Row (fractional) by sine of the elevation, evenly spaced from `lowest`; rows count from the top.
    table: Vec<f32>,
    per_sine: f32,
    /// Sines of the field of view's lower and upper rim, a row beyond the last beams.
    pub lowest: f32,
    /// See [`Rows::lowest`].
    pub highest: f32,
    /// Rows.
    pub count: usize,
    /// Most rows that fit a radian anywhere in the field of view.
    pub per_radian: f32,
}

impl Rows {
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

    /// Fractional rows at sines of elevation: 0 is the centre of the top row. Beyond the rim by at most a row; NaN never. All slices are
    /// equally long; `bins` and `next` are scratch.
    #[inline(always)]
    pub fn rows(&self, sines: &[f32], rows: &mut [f32], bins: &mut [u32], next: &mut [f32]) {
        let (lowest, per_sine, count) = (self.lowest, self.per_sine, sines.len());
        let (rows, bins, next) = (&mut rows[..count], &mut bins[..count], &mut next[..count]);
        for i in 0..count {
            bins[i] = whole(bin(sines[i], lowest, per_sine)) as u32;
        }
        gather(&self.table[..Self::BINS], bins, rows);
        gather(&self.table[1..], bins, next);
        for i in 0..count {
            let rest = bin(sines[i], lowest, per_sine) - bins[i] as i32 as f32;
            rows[i] += (next[i] - rows[i]) * rest;
        }
    }
}

/// Place in the table, fractional.
#[inline(always)]
fn bin(sine: f32, lowest: f32, per_sine: f32) -> f32 {
    let at = (sine - lowest) * per_sine;
    let at = if at > 0.0 { at } else { 0.0 };
    if at < Rows::BINS as f32 - 1.0 { at } else { Rows::BINS as f32 - 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_follow_uneven_elevations() {
        let elevations: Vec<f32> = [17.0f32, 12.0, 10.0, 9.0, 5.0, -1.0, -12.0].map(f32::to_radians).into();
        let table = Rows::new(&elevations);
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
