//! Elevation to row by a table: beams need not be evenly spaced.

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

    /// Fractional rows at sines of elevation: 0 is the centre of the top row. Beyond the rim by at most a row; NaN never.
    #[inline(always)]
    pub fn rows(&self, sines: &[f32; 8]) -> [f32; 8] {
        let (lowest, per_sine) = (self.lowest, self.per_sine);
        let (mut bin, mut rest, mut low, mut high) = ([0u32; 8], [0f32; 8], [0f32; 8], [0f32; 8]);
        for i in 0..8 {
            let at = (sines[i] - lowest) * per_sine;
            let at = if at > 0.0 { at } else { 0.0 };
            let at = if at < Self::BINS as f32 - 1.0 { at } else { Self::BINS as f32 - 1.0 };
            bin[i] = at as u32;
            rest[i] = at - bin[i] as f32;
        }
        for i in 0..8 {
            let bin = bin[i] as usize;
            (low[i], high[i]) = (self.table[bin], self.table[bin + 1]);
        }
        let mut rows = [0f32; 8];
        for i in 0..8 {
            rows[i] = low[i] + (high[i] - low[i]) * rest[i];
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_follow_uneven_elevations() {
        let elevations: Vec<f32> = [17.0f32, 12.0, 10.0, 9.0, 5.0, -1.0, -12.0].map(f32::to_radians).into();
        let rows = Rows::new(&elevations);
        for (i, e) in elevations.iter().enumerate() {
            assert!((rows.rows(&[e.sin(); 8])[i % 8] - i as f32).abs() < 0.02, "row {i} at {}", rows.rows(&[e.sin(); 8])[i % 8]);
        }
        for w in 0..elevations.len() - 1 {
            let middle = 0.5 * (elevations[w] + elevations[w + 1]);
            assert!((rows.rows(&[middle.sin(); 8])[0] - w as f32 - 0.5).abs() < 0.02);
        }
    }
}
