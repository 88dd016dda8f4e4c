//! How far the sensor saw in every direction, at every angular size: the pyramid that octants are held against.
//!
//! A texel of level L covers a *window* of 2 x 2 cells of 2^L x 2^L pixels, so that any patch no larger than such a cell
//! lies within one texel: classifying an octant reads one texel, whatever its size (DESIGN, core 4). The field of view's
//! rim and beams without return count as "saw nothing".

use crate::sensor::{BeamModel, RangeImage};
use std::f32::consts::{PI, TAU};

/// Most levels of the pyramid: cells of 64 x 64 pixels.
pub(super) const LEVELS: usize = 7;

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

    /// Fractional row at a sine of elevation: 0 is the centre of the top row. Beyond the rim by at most a row; NaN never.
    #[inline(always)]
    pub fn row(&self, sine: f32) -> f32 {
        let at = ((sine - self.lowest) * self.per_sine).clamp(0.0, Self::BINS as f32 - 1.0);
        let bin = at as usize;
        self.table[bin] + (self.table[bin + 1] - self.table[bin]) * (at - bin as f32)
    }
}

/// Nearest and farthest that any pixel of a texel saw, metres; nearest is 0 where a pixel saw nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub(super) struct Texel {
    pub near: f32,
    pub far: f32,
}

/// A patch of the image: a direction and how far around it, all in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Patch {
    pub row: f32,
    pub column: f32,
    pub row_radius: f32,
    pub column_radius: f32,
}

impl Patch {
    /// The smallest level whose cells are as large as the patch, by the exponent's bits.
    #[inline(always)]
    fn level(&self) -> Option<usize> {
        let size = 2.0 * if self.row_radius > self.column_radius { self.row_radius } else { self.column_radius };
        if size > (1 << (LEVELS - 1)) as f32 {
            return None;
        }
        let size = if size > 1.0 { size } else { 1.0 };
        Some(((size.to_bits() + 0x007f_ffff) >> 23) as usize - 127)
    }
}

/// The pyramid of one scan.
#[derive(Clone, Debug)]
pub struct Visibility {
    rows: Rows,
    columns: usize,
    /// Azimuth of the left rim of column 0 and columns per radian, negative when columns run clockwise.
    first_azimuth: f32,
    per_radian: f32,
    /// Windows by level: `(rows >> level) + 1` x `columns >> level`, the first row reaching over the top rim.
    levels: [Vec<Texel>; LEVELS],
    cells: Vec<Texel>,
    spare: Vec<Texel>,
}

/// A pixel before anything is known of it.
const BLANK: Texel = Texel { near: f32::INFINITY, far: -1.0 };
/// Ranges of beams on both sides of a gap differ by no more than this factor where the gap is on one surface.
const SAME_SURFACE: f32 = 1.1;
const NOTHING: Texel = Texel { near: 0.0, far: 0.0 };

impl Visibility {
    /// For images of `model`; its columns are reduced to the next smaller power of two.
    pub fn new(model: &BeamModel) -> Self {
        let columns = 1usize << model.columns().max(1).ilog2();
        let mean_azimuth = |column: f32| (0..model.rows()).map(|row| model.azimuth(row as f32, column)).sum::<f32>() / model.rows() as f32;
        let per_radian = (columns as f32 / TAU).copysign(mean_azimuth(1.0) - mean_azimuth(0.0));
        Self {
            rows: Rows::new(model.elevations()),
            columns,
            first_azimuth: mean_azimuth(-0.5),
            per_radian,
            levels: std::array::from_fn(|_| Vec::new()),
            cells: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// Rows padded so that every level divides them.
    fn padded_rows(&self) -> usize {
        self.rows.count.next_multiple_of(1 << (LEVELS - 1))
    }

    /// Column (fractional) of an azimuth in -pi to pi, not wrapped; the centre of column c is at c + 0.5.
    #[inline(always)]
    pub(super) fn column(&self, azimuth: f32) -> f32 {
        (azimuth - self.first_azimuth) * self.per_radian
    }

    /// Builds the pyramid from a scan's image. A range of infinity saw up to `max_range`; 0 saw nothing, or up to
    /// `max_range` if `clear_no_return`. Gaps of a pixel or two between returns are
    /// closed: all of them with `fill`, for clouds that were no grid, otherwise those on one surface.
    pub fn build(&mut self, image: &RangeImage, max_range: f32, clear_no_return: bool, fill: bool) {
        let (rows, columns) = (self.padded_rows(), self.columns);
        self.cells.clear();
        self.cells.resize(rows * columns, BLANK);
        for row in 0..image.rows.min(self.rows.count) {
            let line = &mut self.cells[row * columns..(row + 1) * columns];
            for (column, &range) in image.ranges[row * image.columns..(row + 1) * image.columns].iter().enumerate() {
                let cell = &mut line[column * columns / image.columns];
                if range > 0.0 || clear_no_return {
                    let seen = if range > 0.0 { range.min(max_range) } else { max_range };
                    *cell = Texel { near: cell.near.min(seen), far: cell.far.max(seen) };
                }
            }
        }
        self.fill_gaps(if fill { f32::INFINITY } else { SAME_SURFACE });
        for cell in &mut self.cells {
            if cell.far < 0.0 {
                *cell = NOTHING;
            }
        }
        self.build_levels(rows);
    }

    /// Empty pixels between two returns of a row take the nearer of them. A gap in a grid is a beam that found nothing, so
    /// there the two must see the same surface: `similar` is how much farther the farther one may be.
    fn fill_gaps(&mut self, similar: f32) {
        /// Empty pixels in a row that are bridged.
        const GAP: usize = 2;
        let columns = self.columns;
        self.spare.clone_from(&self.cells);
        for row in 0..self.rows.count {
            let line = &self.spare[row * columns..(row + 1) * columns];
            let seen = |c: usize| (line[c % columns].far >= 0.0).then_some(line[c % columns]);
            for c in (0..columns).filter(|&c| line[c].far < 0.0) {
                let left = (1..=GAP).find_map(|d| seen(c + columns - d));
                let right = (1..=GAP).find_map(|d| seen(c + d));
                if let (Some(a), Some(b)) = (left, right)
                    && a.far.max(b.far) <= similar * a.near.min(b.near)
                {
                    self.cells[row * columns + c] = Texel { near: a.near.min(b.near), far: a.far.max(b.far) };
                }
            }
        }
    }

    /// Halves the cells level by level, and for each level joins windows of 2 x 2 cells.
    fn build_levels(&mut self, rows: usize) {
        let (mut height, mut width) = (rows, self.columns);
        for level in 0..LEVELS {
            let windows = &mut self.levels[level];
            windows.clear();
            for top in 0..=height {
                // Rows beyond the image are blind.
                let upper = top.checked_sub(1).map(|r| &self.cells[r * width..(r + 1) * width]);
                let lower = (top < height).then(|| &self.cells[top * width..(top + 1) * width]);
                match (upper, lower) {
                    (Some(a), Some(b)) => windows.extend((0..width).map(|c| {
                        let d = (c + 1) & (width - 1);
                        join([a[c], a[d], b[c], b[d]])
                    })),
                    (None, Some(one)) | (Some(one), None) => {
                        windows.extend((0..width).map(|c| Texel { near: 0.0, ..join([one[c], one[(c + 1) & (width - 1)], one[c], one[c]]) }));
                    }
                    (None, None) => {}
                }
            }
            if level + 1 < LEVELS {
                self.spare.clear();
                for row in 0..height / 2 {
                    let (a, b) = (&self.cells[2 * row * width..], &self.cells[(2 * row + 1) * width..]);
                    self.spare.extend((0..width / 2).map(|c| join([a[2 * c], a[2 * c + 1], b[2 * c], b[2 * c + 1]])));
                }
                std::mem::swap(&mut self.cells, &mut self.spare);
                (height, width) = (height / 2, width / 2);
            }
        }
    }

    /// The texel that covers the patch within `row_radius` and `column_radius` pixels of a direction; none when the patch
    /// is larger than any texel.
    #[inline(always)]
    pub(super) fn texel(&self, patch: &Patch) -> Option<Texel> {
        let level = patch.level()?;
        let (top, left) = self.cell(patch.row - patch.row_radius, patch.column - patch.column_radius, level);
        Some(self.window(level, top, left))
    }

    /// As [`texel`](Self::texel), with less around the patch: four texels of half the size, when it is small
    /// the patch's own pixels and at most a row below and a column to the right.
    #[inline(always)]
    pub(super) fn close_texel(&self, patch: &Patch) -> Option<Texel> {
        let level = patch.level()?.saturating_sub(1);
        let (top, left) = self.cell(patch.row - patch.row_radius, patch.column - patch.column_radius, level);
        let (bottom, right) = self.cell(patch.row + patch.row_radius, patch.column + patch.column_radius, level);
        // A window reaches one cell further: the last ones start a cell early.
        let (bottom, right) = ((bottom - 1).max(top), (right - 1).max(left));
        Some(join([
            self.window(level, top, left),
            self.window(level, top, right),
            self.window(level, bottom, left),
            self.window(level, bottom, right),
        ]))
    }

    /// The cell of `level` at a row and column (fractional, see [`Rows::row`] and [`column`](Self::column)); not wrapped.
    #[inline(always)]
    fn cell(&self, row: f32, column: f32, level: usize) -> (i32, i32) {
        let shrink = 1.0 / (1u32 << level) as f32;
        // Row r is the pixel from r - 0.5 to r + 0.5. Rows above the image all count as row -1 of their level. An azimuth is
        // at most a turn and a bit off the first column.
        let top = ((row + 0.5) * shrink + 1.0).max(0.0) as i32 - 1;
        (top, ((column + 4.0 * self.columns as f32) * shrink) as i32)
    }

    /// The window of `level` that starts at a cell; nothing was seen below the image.
    #[inline(always)]
    fn window(&self, level: usize, top: i32, left: i32) -> Texel {
        let width = self.columns >> level;
        let last = self.padded_rows() >> level;
        let row = (top + 1) as usize;
        if row > last { NOTHING } else { self.levels[level][row * width + (left as usize & (width - 1))] }
    }

    /// Rows of the sensor.
    pub(super) fn rows(&self) -> &Rows {
        &self.rows
    }

    /// Columns per radian.
    #[inline(always)]
    pub(super) fn columns_per_radian(&self) -> f32 {
        self.per_radian.abs()
    }
}

#[inline(always)]
fn join(t: [Texel; 4]) -> Texel {
    Texel { near: t[0].near.min(t[1].near).min(t[2].near.min(t[3].near)), far: t[0].far.max(t[1].far).max(t[2].far.max(t[3].far)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn rows_follow_uneven_elevations() {
        let elevations: Vec<f32> = [17.0f32, 12.0, 10.0, 9.0, 5.0, -1.0, -12.0].map(f32::to_radians).into();
        let rows = Rows::new(&elevations);
        for (i, e) in elevations.iter().enumerate() {
            assert!((rows.row(e.sin()) - i as f32).abs() < 0.02, "row {i} at {}", rows.row(e.sin()));
        }
        for w in 0..elevations.len() - 1 {
            let middle = 0.5 * (elevations[w] + elevations[w + 1]);
            assert!((rows.row(middle.sin()) - w as f32 - 0.5).abs() < 0.02);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn texels_bound_every_pixel_of_the_patch(
            ranges in prop::collection::vec(prop_oneof![3 => 1f32..50.0, 1 => Just(0f32)], 16 * 64),
            row in -2f32..18.0, column in 0f32..64.0, row_radius in 0f32..9.0, column_radius in 0f32..20.0,
        ) {
            let model = BeamModel::even(16, 64, 0.3, -0.3).map_err(|e| TestCaseError::fail(e.to_string()))?;
            let mut image = Visibility::new(&model);
            image.build(&RangeImage { rows: 16, columns: 64, ranges: ranges.clone(), points: Vec::new() }, 60.0, false, false);
            let patch = Patch { row, column, row_radius, column_radius };
            let (Some(texel), Some(close)) = (image.texel(&patch), image.close_texel(&patch)) else {
                prop_assert!(2.0 * row_radius.max(column_radius) > 64.0);
                return Ok(());
            };
            // A gap between two beams that saw the same surface shows that surface.
            let pixel = |row: usize, column: i32| {
                let at = |c: i32| ranges[row * 64 + c.rem_euclid(64) as usize];
                let beside = |step: i32| (1..=2).map(|d| at(column + d * step)).find(|&r| r > 0.0);
                match (at(column), beside(-1), beside(1)) {
                    (0.0, Some(a), Some(b)) if a.max(b) <= SAME_SURFACE * a.min(b) => (a.min(b), a.max(b)),
                    (range, ..) => (range, range),
                }
            };
            // What is above the image counts as the row above it.
            let bounds = |more: i32| {
                let (mut near, mut far) = (f32::INFINITY, 0f32);
                for r in (row + 0.5 - row_radius).floor() as i32..=((row + 0.5 + row_radius).floor() as i32).max(-1) + more {
                    for c in (column - column_radius).floor() as i32..=(column + column_radius).floor() as i32 + more {
                        let seen = if (0..16).contains(&r) { pixel(r as usize, c) } else { (0.0, 0.0) };
                        near = near.min(seen.0);
                        far = far.max(seen.1);
                    }
                }
                (near, far)
            };
            let (near, far) = bounds(0);
            prop_assert!(texel.near <= near + 1e-3 && texel.far >= far - 1e-3, "{texel:?} against {near} {far}");
            prop_assert!(close.near <= near + 1e-3 && close.far >= far - 1e-3, "{close:?} against {near} {far}");
            if row_radius.max(column_radius) <= 1.0 {
                let (near, far) = bounds(1);
                prop_assert!(close.near >= near && close.far <= far, "close for small patches: {close:?} against {near} {far}");
            }
        }
    }
}
