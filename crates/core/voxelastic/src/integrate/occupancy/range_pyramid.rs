//! The range pyramid: the nearest and farthest return of any patch of the range image, for patches of any size.
//!
//! A texel of level L covers a *window* of 2 x 2 cells of 2^L x 2^L pixels, so that any patch no larger than a cell is within one texel: classifying an octant
//! reads one texel, whatever its size. Pixels outside of the field of view and rays without return are marked by flags.
#![allow(clippy::needless_range_loop)] // Lanes index many arrays at once.

use super::fill_holes::{EMPTY, dilate, fill_holes};
use super::row_table::RowTable;
use super::texel::{OUTSIDE, Packed, Texel, halve, join, join_rows, pack};
use crate::sensor::{BeamModel, RangeImage};
use crate::simd::floor_positive;
use crate::simd::{Kernel, dispatch, gather};
use std::f32::consts::TAU;

/// Levels of the pyramid: cells of 1 x 1 to 64 x 64 pixels.
pub(super) const LEVELS: usize = 7;

/// Most directions that are queried together.
pub(super) const LANES: usize = 256;

/// Patches of the image that are queried together, one array per quantity.
#[derive(Clone, Debug)]
pub(super) struct PyramidQueries {
    /// Fractional row of the patch's centre, see [`RowTable::rows`].
    pub row: [f32; LANES],
    /// Fractional column of the patch's centre, see [`RangePyramid::columns_from`].
    pub column: [f32; LANES],
    /// Half height and half width of the patch, pixels.
    pub reach: [[f32; LANES]; 2],
    /// Level whose texels are large enough for the patch, see [`level_for`].
    pub level: [u32; LANES],
    /// The result.
    pub texel: [Packed; LANES],
    /// First window of that level, see [`RangePyramid::starts_of`].
    pub start: [u32; LANES],
    /// First window of the next finer level.
    pub start_finer: [u32; LANES],
    index: [u32; LANES],
    corners: [[u32; LANES]; 4],
}

impl PyramidQueries {
    pub fn new() -> Self {
        let (number, whole) = ([0.0; LANES], [0; LANES]);
        Self {
            row: number,
            column: number,
            reach: [number; 2],
            level: whole,
            texel: whole,
            index: whole,
            start: whole,
            start_finer: whole,
            corners: [whole; 4],
        }
    }
}

/// The finest level whose cells are at least as large as a patch that reaches so many rows and columns to each side; [`LEVELS`] or more if no level has cells of
/// that size.
#[inline(always)]
pub(super) fn level_for(rows: f32, columns: f32) -> u32 {
    let size = 2.0 * if rows > columns { rows } else { columns };
    let size = if size > 1.0 { size } else { 1.0 };
    // The exponent of the next power of two.
    ((size.to_bits() + 0x007f_ffff) >> 23) - 127
}

/// The pyramid of one scan.
#[derive(Clone, Debug)]
pub(super) struct RangePyramid {
    rows: RowTable,
    columns: usize,
    /// Azimuth of the left edge of column 0, and columns per radian, negative when columns run clockwise.
    first_azimuth: f32,
    per_radian: f32,
    /// Windows of all levels: `(rows >> level) + 1` x `columns >> level`, of which the first row extends over the top edge, and one more row that is outside.
    windows: Vec<Packed>,
    /// First window of each level.
    starts: [u32; LEVELS],
    metres_per_step: f32,
    /// Pixels after hole filling.
    singles: Vec<Packed>,
    /// Scratch memory: pixels, a copy of them during hole filling, and the cells of a level and of the next.
    pixels: Vec<Texel>,
    unfilled: Vec<Texel>,
    cells: Vec<Packed>,
    coarser: Vec<Packed>,
    /// A row of cells outside of the image.
    outside_row: Vec<Packed>,
}

/// Ranges on both sides of a hole differ by at most this factor where both are on one surface.
const SAME_SURFACE: f32 = 1.1;
/// Holes in a row are filled up to this many times the angle between rows.
const GAP_SPACINGS: f32 = 1.5;
/// Ranges are quantised to this many steps from 0 to the maximum range.
const STEPS: f32 = 32_000.0;

impl RangePyramid {
    /// A pyramid for images of `model`; the number of columns is reduced to the next smaller power of two.
    pub fn new(model: &BeamModel) -> Self {
        let columns = 1usize << model.columns().max(1).ilog2();
        let mean_azimuth = |column: f32| (0..model.rows()).map(|row| model.azimuth(row as f32, column)).sum::<f32>() / model.rows() as f32;
        let per_radian = (columns as f32 / TAU).copysign(mean_azimuth(1.0) - mean_azimuth(0.0));
        Self {
            rows: RowTable::new(model.elevations()),
            columns,
            first_azimuth: mean_azimuth(-0.5),
            per_radian,
            windows: Vec::new(),
            starts: [0; LEVELS],
            metres_per_step: 0.0,
            singles: Vec::new(),
            pixels: Vec::new(),
            unfilled: Vec::new(),
            cells: Vec::new(),
            coarser: Vec::new(),
            outside_row: Vec::new(),
        }
    }

    /// Number of rows, padded to a multiple of the largest cells.
    fn padded_rows(&self) -> usize {
        self.rows.count.next_multiple_of(1 << (LEVELS - 1))
    }

    /// The fractional column, not wrapped, of an azimuth in -pi to pi is its difference to the first of these times the second. The centre of column c is at
    /// c + 0.5.
    #[inline(always)]
    pub(super) fn columns_from(&self) -> (f32, f32) {
        (self.first_azimuth, self.per_radian)
    }

    /// Builds the pyramid from a range image. Infinite ranges count as `max_range`; 0 means no return, or `max_range` with `clear_no_return`. Small holes between
    /// returns are filled: all of them with `fill`, for clouds that are not the sensor's grid, else those within one surface.
    pub fn build(&mut self, image: &RangeImage, max_range: f32, clear_no_return: bool, fill: bool) {
        let (rows, columns) = (self.padded_rows(), self.columns);
        self.pixels.clear();
        self.pixels.resize(self.rows.count * columns, EMPTY);
        let no_return = if clear_no_return { max_range } else { -1.0 };
        for (row_pixels, ranges) in self.pixels.chunks_mut(columns).zip(image.ranges.chunks(image.columns)) {
            if image.columns == columns {
                dispatch(PixelRow { ranges, max_range, no_return, pixels: row_pixels });
            } else {
                reduce_columns(ranges, max_range, no_return, row_pixels);
            }
        }
        let widest = (GAP_SPACINGS * self.columns_per_radian() / self.rows.per_radian) as usize;
        let similar = if fill { f32::INFINITY } else { SAME_SURFACE };
        fill_holes(&mut self.pixels, &mut self.unfilled, columns, widest.clamp(2, columns / 8 + 2), similar);
        dilate(&mut self.pixels, &mut self.unfilled, columns);
        self.metres_per_step = max_range / STEPS;
        dispatch(BuildLevels { visibility: self, rows, per_metre: STEPS / max_range });
    }

    /// Packs the pixels, halves the resolution of the cells level by level, and joins 2 x 2 cells to a window on each level.
    #[inline(always)]
    fn build_levels(&mut self, rows: usize, per_metre: f32) {
        let Self { pixels, singles, cells, coarser, windows, starts, outside_row, .. } = self;
        let (mut height, mut width) = (rows, self.columns);
        outside_row.resize(width, OUTSIDE);
        singles.clear();
        singles.resize(rows * width, OUTSIDE);
        for (single, pixel) in singles.iter_mut().zip(pixels.iter()) {
            *single = pack(pixel, per_metre);
        }
        cells.clone_from(singles);
        // For queries outside of the field of view.
        singles.push(OUTSIDE);
        windows.clear();
        for (level, start) in starts.iter_mut().enumerate() {
            *start = windows.len() as u32;
            // Cells above and below the image are outside, and so is one more row of windows.
            windows.resize(windows.len() + (height + 2) * width, OUTSIDE);
            for (top, windows) in windows[*start as usize..].chunks_mut(width).take(height + 1).enumerate() {
                let upper = if top == 0 { &outside_row[..width] } else { &cells[(top - 1) * width..top * width] };
                let lower = if top == height { &outside_row[..width] } else { &cells[top * width..(top + 1) * width] };
                join_rows(upper, lower, windows);
            }
            if level + 1 < LEVELS {
                coarser.resize(height / 2 * (width / 2), OUTSIDE);
                for (pair, coarser) in cells.chunks(2 * width).zip(coarser.chunks_mut(width / 2)) {
                    let (upper, lower) = pair.split_at(width);
                    halve(upper, lower, coarser);
                }
                std::mem::swap(cells, coarser);
                (height, width) = (height / 2, width / 2);
            }
        }
    }

    /// First window of a level below [`LEVELS`], and of the next finer level.
    #[inline(always)]
    pub(super) fn starts_of(&self, level: u32) -> (u32, u32) {
        let level = level as usize % LEVELS;
        (self.starts[level], self.starts[level.saturating_sub(1)])
    }

    /// Reads the texels that cover the patches of the first `lanes` queries, whose levels must be below [`LEVELS`].
    #[inline(always)]
    pub(super) fn texels(&self, queries: &mut PyramidQueries, lanes: usize) {
        let PyramidQueries { row, column, reach: [rows, columns], level, texel, index, start, .. } = queries;
        let (layout, index) = (self.layout(), &mut index[..lanes]);
        for i in 0..lanes {
            index[i] = start[i] + layout.index(layout.top(row[i] - rows[i], level[i]), layout.left(column[i] - columns[i], level[i]), level[i]);
        }
        gather(&self.windows, index, &mut texel[..lanes]);
    }

    /// As [`texels`](Self::texels), with tighter windows: each patch is covered by up to four texels of half the size; for small patches these are the patch's
    /// own pixels and at most one row below and one column to the right. Lowers the levels.
    #[inline(always)]
    pub(super) fn finer_texels(&self, queries: &mut PyramidQueries, lanes: usize) {
        let PyramidQueries { row, column, reach: [rows, columns], level, texel, index, start_finer: start, corners, .. } = queries;
        let layout = self.layout();
        for i in 0..lanes {
            level[i] = level[i].saturating_sub(1);
        }
        let [a, b, c, d] = corners;
        for i in 0..lanes {
            let (start, level) = (start[i], level[i]);
            let (top, left) = (layout.top(row[i] - rows[i], level), layout.left(column[i] - columns[i], level));
            let (bottom, right) = (layout.top(row[i] + rows[i], level), layout.left(column[i] + columns[i], level));
            // A window is two cells wide, so the last ones start one cell earlier.
            let (bottom, right) = ((bottom - 1).max(top), (right - 1).max(left));
            a[i] = start + layout.index(top, left, level);
            b[i] = start + layout.index(top, right, level);
            c[i] = start + layout.index(bottom, left, level);
            d[i] = start + layout.index(bottom, right, level);
        }
        gather(&self.windows, &a[..lanes], &mut texel[..lanes]);
        for corner in [b, c, d] {
            gather(&self.windows, &corner[..lanes], &mut index[..lanes]);
            for i in 0..lanes {
                texel[i] = join(texel[i], index[i]);
            }
        }
    }

    /// Reads the pixels at the centres of the first `lanes` patches, after hole filling and dilation.
    #[inline(always)]
    pub(super) fn pixels(&self, queries: &mut PyramidQueries, lanes: usize) {
        let PyramidQueries { row, column, texel, index, .. } = queries;
        let (layout, index) = (self.layout(), &mut index[..lanes]);
        let (rows, outside_row) = (self.rows.count as f32, layout.rows * layout.columns);
        for i in 0..lanes {
            let at = row[i] + 0.5;
            let pixel =
                floor_positive(if at > 0.0 { at } else { 0.0 }) as u32 * layout.columns + (layout.left(column[i], 0) as u32 & (layout.columns - 1));
            index[i] = if (at >= 0.0) & (at < rows) { pixel } else { outside_row };
        }
        gather(&self.singles, index, &mut texel[..lanes]);
    }

    /// The layout of the windows in memory.
    #[inline(always)]
    fn layout(&self) -> WindowLayout {
        WindowLayout {
            columns: self.columns as u32,
            rows: self.padded_rows() as u32,
            // An azimuth is little more than a turn off the first column, so indices stay positive.
            column_offset: 4.0 * self.columns as f32,
        }
    }

    /// Metres per step of the texels.
    #[inline(always)]
    pub(super) fn metres_per_step(&self) -> f32 {
        self.metres_per_step
    }

    /// Rows of the sensor by elevation.
    pub(super) fn rows(&self) -> &RowTable {
        &self.rows
    }

    /// Columns per radian.
    #[inline(always)]
    pub(super) fn columns_per_radian(&self) -> f32 {
        self.per_radian.abs()
    }
}

/// Layout of the windows of a level.
#[derive(Clone, Copy)]
struct WindowLayout {
    rows: u32,
    columns: u32,
    column_offset: f32,
}

/// Cells of `level` per pixel: 2^-level.
#[inline(always)]
fn cells_per_pixel(level: u32) -> f32 {
    f32::from_bits((127 - level) << 23)
}

impl WindowLayout {
    /// Window row of an image row. Row r covers r - 0.5 to r + 0.5; all rows above the image count as row -1 of their level, in window row 0.
    #[inline(always)]
    fn top(&self, row: f32, level: u32) -> i32 {
        let top = (row + 0.5) * cells_per_pixel(level) + 1.0;
        floor_positive(if top > 0.0 { top } else { 0.0 })
    }

    /// Window column of an image column, not wrapped.
    #[inline(always)]
    fn left(&self, column: f32, level: u32) -> i32 {
        floor_positive((column + self.column_offset) * cells_per_pixel(level))
    }

    /// Index of a window; rows below the image are mapped to the last row, which is outside.
    #[inline(always)]
    fn index(&self, top: i32, left: i32, level: u32) -> u32 {
        let (last, width) = ((self.rows >> level) as i32, self.columns >> level);
        let top = if top > last { last + 1 } else { top };
        top as u32 * width + (left as u32 & (width - 1))
    }
}

/// Fills a row of pixels from as many ranges.
struct PixelRow<'a> {
    ranges: &'a [f32],
    max_range: f32,
    no_return: f32,
    pixels: &'a mut [Texel],
}

impl Kernel for PixelRow<'_> {
    #[inline(always)]
    fn run(self) {
        for (pixel, &range) in self.pixels.iter_mut().zip(self.ranges) {
            let limited = if range < self.max_range { range } else { self.max_range };
            let range_or_none = if range > 0.0 { limited } else { self.no_return };
            *pixel = Texel { near: if range_or_none < 0.0 { f32::INFINITY } else { range_or_none }, far: range_or_none };
        }
    }
}

/// Fills a row of pixels from more ranges.
fn reduce_columns(ranges: &[f32], max_range: f32, no_return: f32, pixels: &mut [Texel]) {
    let columns = pixels.len();
    for (column, &range) in ranges.iter().enumerate() {
        let range_or_none = if range > 0.0 { range.min(max_range) } else { no_return };
        if range_or_none >= 0.0 {
            let pixel = &mut pixels[column * columns / ranges.len()];
            *pixel = Texel { near: pixel.near.min(range_or_none), far: pixel.far.max(range_or_none) };
        }
    }
}

/// Builds the pyramid from its pixels.
struct BuildLevels<'a> {
    visibility: &'a mut RangePyramid,
    rows: usize,
    per_metre: f32,
}

impl Kernel for BuildLevels<'_> {
    #[inline(always)]
    fn run(self) {
        self.visibility.build_levels(self.rows, self.per_metre);
    }
}

#[cfg(test)]
mod tests {
    use super::super::texel::{HOLE_BIT, RIM_BIT, far_of, near_of};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn texels_bound_every_pixel_of_the_patch(
            ranges in prop::collection::vec(prop_oneof![3 => 1f32..50.0, 1 => Just(0f32)], 16 * 64),
            row in -2f32..18.0, column in 0f32..64.0, row_radius in 0f32..9.0, column_radius in 0f32..20.0,
        ) {
            let model = BeamModel::even(16, 64, 0.3, -0.3).map_err(|e| TestCaseError::fail(e.to_string()))?;
            let mut image = RangePyramid::new(&model);
            image.build(&RangeImage { rows: 16, columns: 64, ranges: ranges.clone(), points: Vec::new() }, 60.0, false, false);
            let mut queries = PyramidQueries::new();
            (queries.row, queries.column, queries.reach) = ([row; LANES], [column; LANES], [[row_radius; LANES], [column_radius; LANES]]);
            queries.level = [level_for(row_radius, column_radius); LANES];
            if queries.level[0] >= LEVELS as u32 {
                prop_assert!(2.0 * row_radius.max(column_radius) > 64.0);
                return Ok(());
            }
            let (start, finer) = image.starts_of(queries.level[0]);
            (queries.start, queries.start_finer) = ([start; LANES], [finer; LANES]);
            let mut range_or_none = |query: &dyn Fn(&RangePyramid, &mut PyramidQueries, usize)| {
                query(&image, &mut queries, 9);
                queries.texel[7]
            };
            let texels = range_or_none(&RangePyramid::texels);
            let fine = range_or_none(&RangePyramid::finer_texels);
            let single = range_or_none(&RangePyramid::pixels);
            let near_of = |texel: Packed| near_of(texel) * image.metres_per_step();
            let far_of = |texel: Packed| far_of(texel) * image.metres_per_step();
            let (has_hole, has_rim) = (|texel: Packed| texel & HOLE_BIT != 0, |texel: Packed| texel & RIM_BIT != 0);
            let mut filled: Vec<Texel> = ranges.iter().map(|&r| if r > 0.0 { Texel { near: r, far: r } } else { EMPTY }).collect();
            fill_holes(&mut filled, &mut Vec::new(), 64, 2, SAME_SURFACE);
            dilate(&mut filled, &mut Vec::new(), 64);
            // All rows above the image count as one row.
            let bounds = |more: i32| {
                let (mut near, mut far, mut hole, mut rim) = (60f32, 0f32, false, false);
                for r in (row + 0.5 - row_radius).floor() as i32..=((row + 0.5 + row_radius).floor() as i32).max(-1) + more {
                    for c in (column - column_radius).floor() as i32..=(column + column_radius).floor() as i32 + more {
                        match (0..16).contains(&r).then(|| filled[r as usize * 64 + c.rem_euclid(64) as usize]) {
                            None => rim = true,
                            Some(pixel) if pixel.far < 0.0 => hole = true,
                            Some(pixel) => (near, far) = (near.min(pixel.near), far.max(pixel.far)),
                        }
                    }
                }
                (near, far, hole, rim)
            };
            let (near, far, hole, rim) = bounds(0);
            for t in [texels, fine] {
                prop_assert!((near == 60.0 || near_of(t) <= near) && far_of(t) >= far, "{t:x} against {near} {far}");
                prop_assert!(has_hole(t) >= hole && has_rim(t) >= rim, "{t:x} against {hole} {rim}");
            }
            if row_radius.max(column_radius) <= 1.0 {
                let (near, far, hole, rim) = bounds(1);
                prop_assert!(near_of(fine) >= near - 4e-3 && far_of(fine) <= far + 4e-3, "fine for small patches: {fine:x} against {near} {far}");
                prop_assert!(has_hole(fine) <= hole && has_rim(fine) <= rim);
            }
            let inside = (0.0..16.0).contains(&(row + 0.5));
            prop_assert_eq!(single & (HOLE_BIT | RIM_BIT) == 0, inside && filled[(row + 0.5) as usize * 64 + column as usize].far >= 0.0);
        }
    }
}
