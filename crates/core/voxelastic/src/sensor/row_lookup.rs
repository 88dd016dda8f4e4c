//! From an elevation to its row by one table look-up.
//!
//! Unlike the table in `integrate::occupancy`, which interpolates sines of elevations for many directions at a time, this look-up is exact: it decides to which
//! pixel a point belongs.

use crate::simd::{floor_positive, gather, larger, smaller};

/// Rows must be farther apart than their span divided by this, so that the table stays in the first-level cache.
pub(crate) const MAX_CELLS: usize = 8192;

/// Maps an elevation to a fractional row, for rows that need not be evenly spaced.
///
/// The span of elevations is divided into equal cells no larger than the smallest gap between rows. A cell then contains at most one row, so an elevation is in
/// the first gap of its cell or the next one: one comparison instead of a search.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RowLookup {
    top: f32,
    cells_per_radian: f32,
    /// Gap that contains the upper end of each cell; gap i is between the rows i and i + 1.
    first_gap: Vec<u32>,
    /// Elevation of each row, top to bottom; one more than there are gaps.
    elevation: Vec<f32>,
    /// 1 / angle of each gap.
    per_gap: Vec<f32>,
}

impl RowLookup {
    /// `elevations` must be strictly descending; with a single row, `lone_gap` is the height of its pixels.
    ///
    /// # Errors
    /// The index of a gap that is too small for the table.
    pub(crate) fn new(elevations: &[f32], lone_gap: f32) -> Result<Self, usize> {
        let mut elevation = elevations.to_vec();
        if let [only] = elevations {
            elevation.push(only - lone_gap);
        }
        let gaps = elevation.len() - 1;
        let span = elevation[0] - elevation[gaps];
        let tightest = (0..gaps).min_by(|&a, &b| (elevation[a] - elevation[a + 1]).total_cmp(&(elevation[b] - elevation[b + 1]))).unwrap_or(0);
        let gap = elevation[tightest] - elevation[tightest + 1];
        if gap.is_nan() || gap * MAX_CELLS as f32 <= span * 1.01 {
            return Err(tightest);
        }
        let cells = (span / gap * 1.005).ceil().max(1.0) as usize;
        let cells_per_radian = cells as f32 / span;
        let mut gap_at = 0;
        let first_gap = (0..cells)
            .map(|cell| {
                let upper_end = elevation[0] - cell as f32 / cells_per_radian;
                while gap_at + 1 < gaps && elevation[gap_at + 1] >= upper_end {
                    gap_at += 1;
                }
                gap_at as u32
            })
            .collect();
        let per_gap = elevation.windows(2).map(|pair| 1.0 / (pair[0] - pair[1])).collect();
        Ok(Self { top: elevation[0], cells_per_radian, first_gap, elevation, per_gap })
    }

    /// Fractional row of `elevation` (radians): whole at the rows themselves, linear between them, and beyond the first and
    /// last row with the outermost gap's slope.
    #[inline(always)]
    pub(crate) fn row(&self, elevation: f32) -> f32 {
        let cell = ((self.top - elevation) * self.cells_per_radian) as usize;
        let mut gap = self.first_gap[cell.min(self.first_gap.len() - 1)] as usize;
        gap += usize::from(elevation < self.elevation[gap + 1]);
        let gap = gap.min(self.per_gap.len() - 1);
        gap as f32 + (self.elevation[gap] - elevation) * self.per_gap[gap]
    }

    /// As [`row`](Self::row), for up to `N` elevations at a time, in vector instructions; the same bits.
    #[inline(always)]
    pub(crate) fn rows<const N: usize>(&self, elevations: &[f32], rows: &mut [f32]) {
        let count = elevations.len().min(rows.len()).min(N);
        let (mut index, mut next, mut gap) = ([0u32; N], [0u32; N], [0u32; N]);
        let (mut lower, mut upper, mut per_gap) = ([0f32; N], [0f32; N], [0f32; N]);
        let (last_cell, last_gap) = ((self.first_gap.len() - 1) as f32, (self.per_gap.len() - 1) as u32);
        for i in 0..count {
            let cell = (self.top - elevations[i]) * self.cells_per_radian;
            index[i] = floor_positive(larger(smaller(cell, last_cell), 0.0)) as u32;
        }
        gather(&self.first_gap, &index[..count], &mut gap[..count]);
        for i in 0..count {
            next[i] = gap[i] + 1;
        }
        gather(&self.elevation, &next[..count], &mut lower[..count]);
        for i in 0..count {
            let beyond = gap[i] + u32::from(elevations[i] < lower[i]);
            gap[i] = if beyond < last_gap { beyond } else { last_gap };
        }
        gather(&self.elevation, &gap[..count], &mut upper[..count]);
        gather(&self.per_gap, &gap[..count], &mut per_gap[..count]);
        for i in 0..count {
            rows[i] = gap[i] as f32 + (upper[i] - elevations[i]) * per_gap[i];
        }
    }

    /// Elevation of a fractional row: the inverse of [`RowLookup::row`].
    #[inline(always)]
    pub(crate) fn elevation(&self, row: f32) -> f32 {
        let gap = (row.max(0.0) as usize).min(self.per_gap.len() - 1);
        let (upper, lower) = (self.elevation[gap], self.elevation[gap + 1]);
        upper + (lower - upper) * (row - gap as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The obvious way: search all gaps.
    fn row_by_search(elevations: &[f32], elevation: f32) -> f32 {
        let last = elevations.len() - 2;
        let gap = (0..=last).find(|&i| elevation >= elevations[i + 1]).unwrap_or(last);
        gap as f32 + (elevations[gap] - elevation) / (elevations[gap] - elevations[gap + 1])
    }

    proptest! {
        #[test]
        fn look_up_equals_search(
            top in -0.5f32..1.5,
            gaps in prop::collection::vec(0.0005f32..0.03, 1..130),
            probes in prop::collection::vec(-0.2f32..1.2, 50),
        ) {
            let mut elevations = vec![top];
            gaps.iter().for_each(|g| elevations.push(elevations[elevations.len() - 1] - g));
            let table = RowLookup::new(&elevations, 0.01).map_err(|_| TestCaseError::reject("rows too close"))?;
            let span = top - elevations[elevations.len() - 1];
            for (i, p) in probes.iter().enumerate() {
                // Half of the probes are the rows themselves, where the look-up must decide between two gaps.
                let elevation = if i % 2 == 0 { top - p * span } else { elevations[i % elevations.len()] };
                let (fast, slow) = (table.row(elevation), row_by_search(&elevations, elevation));
                prop_assert!((fast - slow).abs() < 2e-3 * slow.abs().max(1.0), "{} {}", fast, slow);
                prop_assert!((table.elevation(fast) - elevation).abs() < 1e-5);
            }
            let elevations: Vec<f32> = probes.iter().map(|p| top - p * span).chain([f32::NAN, f32::INFINITY, -9.0]).collect();
            let mut rows = vec![0.0; elevations.len()];
            table.rows::<64>(&elevations, &mut rows);
            for (&elevation, row) in elevations.iter().zip(rows).take(probes.len()) {
                prop_assert_eq!(row.to_bits(), table.row(elevation).to_bits());
            }
        }
    }

    #[test]
    fn rows_that_coincide_are_refused() {
        assert_eq!(RowLookup::new(&[0.3, 0.1, 0.1, 0.0], 0.01), Err(1));
        assert_eq!(RowLookup::new(&[1.0, 0.00001, 0.0], 0.01), Err(1));
    }

    #[test]
    fn a_single_row_has_pixels_of_its_own_height() {
        let table = RowLookup::new(&[0.2], 0.01).unwrap_or_else(|_| unreachable!());
        assert!((table.row(0.2) - 0.0).abs() < 1e-5 && (table.row(0.205) + 0.5).abs() < 1e-4);
    }
}
