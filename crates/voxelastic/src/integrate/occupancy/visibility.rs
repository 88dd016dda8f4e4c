//! How far the sensor saw in every direction, at every angular size: the pyramid that octants are held against.
//!
//! A texel of level L covers a *window* of 2 x 2 cells of 2^L x 2^L pixels, so that any patch no larger than such a cell
//! lies within one texel: classifying an octant reads one texel, whatever its size (DESIGN, core 4). The field of view's
//! rim and beams without return count as "saw nothing".
#![allow(clippy::needless_range_loop)] // A lane is an index into many arrays here.

use super::gaps::{BLANK, fill_gaps, grow};
use super::rows::Rows;
use super::texel::{NOTHING, Packed, Texel, halve, join, join_rows, pack};
use crate::dispatch::{Kernel, dispatch, gather};
use crate::geometry::whole;
use crate::sensor::{BeamModel, RangeImage};
use std::f32::consts::TAU;

/// Most levels of the pyramid: cells of 64 x 64 pixels.
pub(super) const LEVELS: usize = 7;

/// Most directions that are looked at together.
pub(super) const LANES: usize = 256;

/// Directions that are looked at together and how far around each, one array per quantity.
#[derive(Clone, Debug)]
pub(super) struct Looks {
    /// Fractional row and column, see [`Rows::rows`] and [`Visibility::columns_from`].
    pub row: [f32; LANES],
    /// See [`Looks::row`].
    pub column: [f32; LANES],
    /// How far around the direction, in pixels.
    pub reach: [[f32; LANES]; 2],
    /// Level whose texels are large enough for the reach, see [`level_for`].
    pub level: [u32; LANES],
    /// What was seen there.
    pub texel: [Packed; LANES],
    /// Where the windows of that level start, and those of the next finer one, see [`Visibility::starts_of`].
    pub start: [u32; LANES],
    /// See [`Looks::start`].
    pub start_closer: [u32; LANES],
    index: [u32; LANES],
    corners: [[u32; LANES]; 4],
}

impl Looks {
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
            start_closer: whole,
            corners: [whole; 4],
        }
    }
}

/// The smallest level whose cells are as large as what reaches so many rows and columns around a direction; [`LEVELS`] or more when no
/// texel is so large.
#[inline(always)]
pub(super) fn level_for(rows: f32, columns: f32) -> u32 {
    let size = 2.0 * if rows > columns { rows } else { columns };
    let size = if size > 1.0 { size } else { 1.0 };
    // The exponent of the next power of two.
    ((size.to_bits() + 0x007f_ffff) >> 23) - 127
}

/// The pyramid of one scan.
#[derive(Clone, Debug)]
pub struct Visibility {
    rows: Rows,
    columns: usize,
    /// Azimuth of the left rim of column 0 and columns per radian, negative when columns run clockwise.
    first_azimuth: f32,
    per_radian: f32,
    /// Windows of all levels: `(rows >> level) + 1` x `columns >> level`, the first row reaching over the top rim, and a blind row.
    windows: Vec<Packed>,
    /// Where each level starts.
    starts: [u32; LEVELS],
    metres_per_step: f32,
    /// Pixels with small gaps filled.
    singles: Vec<Packed>,
    /// Scratch space: pixels, the same before gaps were filled, and the cells of a level and of the next.
    pixels: Vec<Texel>,
    unfilled: Vec<Texel>,
    cells: Vec<Packed>,
    coarser: Vec<Packed>,
    /// A row that saw nothing.
    blind: Vec<Packed>,
}

/// Ranges of beams on both sides of a gap differ by no more than this factor where the gap is on one surface.
const SAME_SURFACE: f32 = 1.1;
/// Gaps in a row are bridged up to this many times the angle between rows.
const GAP_SPACINGS: f32 = 1.5;
/// Steps from 0 to the maximum range, of which the pyramid's bounds are whole numbers.
const STEPS: f32 = 32_000.0;

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
            windows: Vec::new(),
            starts: [0; LEVELS],
            metres_per_step: 0.0,
            singles: Vec::new(),
            pixels: Vec::new(),
            unfilled: Vec::new(),
            cells: Vec::new(),
            coarser: Vec::new(),
            blind: Vec::new(),
        }
    }

    /// Rows padded so that every level divides them.
    fn padded_rows(&self) -> usize {
        self.rows.count.next_multiple_of(1 << (LEVELS - 1))
    }

    /// Column (fractional, not wrapped) of an azimuth in -pi to pi: the difference to the first of these, times the second.
    /// The centre of column c is at c + 0.5.
    #[inline(always)]
    pub(super) fn columns_from(&self) -> (f32, f32) {
        (self.first_azimuth, self.per_radian)
    }

    /// Builds the pyramid from a scan's image. A range of infinity saw up to `max_range`; 0 saw nothing, or up to
    /// `max_range` if `clear_no_return`. Small gaps between returns are
    /// closed: all of them with `fill`, for clouds that were no grid, otherwise those on one surface.
    pub fn build(&mut self, image: &RangeImage, max_range: f32, clear_no_return: bool, fill: bool) {
        let (rows, columns) = (self.padded_rows(), self.columns);
        self.pixels.clear();
        self.pixels.resize(self.rows.count * columns, BLANK);
        let unseen = if clear_no_return { max_range } else { -1.0 };
        for (line, ranges) in self.pixels.chunks_mut(columns).zip(image.ranges.chunks(image.columns)) {
            if image.columns == columns {
                dispatch(Line { ranges, max_range, unseen, pixels: line });
            } else {
                show_in_fewer(ranges, max_range, unseen, line);
            }
        }
        let widest = (GAP_SPACINGS * self.columns_per_radian() / self.rows.per_radian) as usize;
        let similar = if fill { f32::INFINITY } else { SAME_SURFACE };
        fill_gaps(&mut self.pixels, &mut self.unfilled, columns, widest.clamp(2, columns / 8 + 2), similar);
        grow(&mut self.pixels, &mut self.unfilled, columns);
        self.metres_per_step = max_range / STEPS;
        dispatch(Levels { visibility: self, rows, per_metre: STEPS / max_range });
    }

    /// Packs the pixels, halves the cells level by level, and for each level joins windows of 2 x 2 cells.
    #[inline(always)]
    fn build_levels(&mut self, rows: usize, per_metre: f32) {
        let Self { pixels, singles, cells, coarser, windows, starts, blind, .. } = self;
        let (mut height, mut width) = (rows, self.columns);
        blind.resize(width, NOTHING);
        singles.clear();
        singles.resize(rows * width, NOTHING);
        for (single, pixel) in singles.iter_mut().zip(pixels.iter()) {
            *single = pack(pixel, per_metre);
        }
        cells.clone_from(singles);
        // For looks beyond the rim.
        singles.push(NOTHING);
        windows.clear();
        for (level, start) in starts.iter_mut().enumerate() {
            *start = windows.len() as u32;
            // Above and below the image nothing was seen, nor in a row of windows more.
            windows.resize(windows.len() + (height + 2) * width, NOTHING);
            for (top, windows) in windows[*start as usize..].chunks_mut(width).take(height + 1).enumerate() {
                let upper = if top == 0 { &blind[..width] } else { &cells[(top - 1) * width..top * width] };
                let lower = if top == height { &blind[..width] } else { &cells[top * width..(top + 1) * width] };
                join_rows(upper, lower, windows);
            }
            if level + 1 < LEVELS {
                coarser.resize(height / 2 * (width / 2), NOTHING);
                for (pair, coarser) in cells.chunks(2 * width).zip(coarser.chunks_mut(width / 2)) {
                    let (upper, lower) = pair.split_at(width);
                    halve(upper, lower, coarser);
                }
                std::mem::swap(cells, coarser);
                (height, width) = (height / 2, width / 2);
            }
        }
    }

    /// Where the windows of a level below [`LEVELS`] start, and those of the next finer one.
    #[inline(always)]
    pub(super) fn starts_of(&self, level: u32) -> (u32, u32) {
        let level = level as usize % LEVELS;
        (self.starts[level], self.starts[level.saturating_sub(1)])
    }

    /// The texels that cover what the first `lanes` looks reach, all of levels below [`LEVELS`].
    #[inline(always)]
    pub(super) fn texels(&self, looks: &mut Looks, lanes: usize) {
        let Looks { row, column, reach: [rows, columns], level, texel, index, start, .. } = looks;
        let (place, index) = (self.place(), &mut index[..lanes]);
        for i in 0..lanes {
            index[i] = start[i] + place.index(place.top(row[i] - rows[i], level[i]), place.left(column[i] - columns[i], level[i]), level[i]);
        }
        gather(&self.windows, index, &mut texel[..lanes]);
    }

    /// As [`texels`](Self::texels), with less around the windows: of each four texels of half the size, when it is small
    /// the window's own pixels and at most a row below and a column to the right. Lowers the levels.
    #[inline(always)]
    pub(super) fn close_texels(&self, looks: &mut Looks, lanes: usize) {
        let Looks { row, column, reach: [rows, columns], level, texel, index, start_closer: start, corners, .. } = looks;
        let place = self.place();
        for i in 0..lanes {
            level[i] = level[i].saturating_sub(1);
        }
        let [a, b, c, d] = corners;
        for i in 0..lanes {
            let (start, level) = (start[i], level[i]);
            let (top, left) = (place.top(row[i] - rows[i], level), place.left(column[i] - columns[i], level));
            let (bottom, right) = (place.top(row[i] + rows[i], level), place.left(column[i] + columns[i], level));
            // A window reaches one cell further: the last ones start a cell early.
            let (bottom, right) = ((bottom - 1).max(top), (right - 1).max(left));
            a[i] = start + place.index(top, left, level);
            b[i] = start + place.index(top, right, level);
            c[i] = start + place.index(bottom, left, level);
            d[i] = start + place.index(bottom, right, level);
        }
        gather(&self.windows, &a[..lanes], &mut texel[..lanes]);
        for corner in [b, c, d] {
            gather(&self.windows, &corner[..lanes], &mut index[..lanes]);
            for i in 0..lanes {
                texel[i] = join(texel[i], index[i]);
            }
        }
    }

    /// The pixels that the first `lanes` looks point at; they saw something if one right beside them did.
    #[inline(always)]
    pub(super) fn pixels(&self, looks: &mut Looks, lanes: usize) {
        let Looks { row, column, texel, index, .. } = looks;
        let (place, index) = (self.place(), &mut index[..lanes]);
        let (rows, blind) = (self.rows.count as f32, place.rows * place.columns);
        for i in 0..lanes {
            let at = row[i] + 0.5;
            let pixel = whole(if at > 0.0 { at } else { 0.0 }) as u32 * place.columns + (place.left(column[i], 0) as u32 & (place.columns - 1));
            index[i] = if (at >= 0.0) & (at < rows) { pixel } else { blind };
        }
        gather(&self.singles, index, &mut texel[..lanes]);
    }

    /// How windows are laid out.
    #[inline(always)]
    fn place(&self) -> Place {
        Place {
            columns: self.columns as u32,
            rows: self.padded_rows() as u32,
            // An azimuth is at most a turn and a bit off the first column: indices stay positive.
            turns: 4.0 * self.columns as f32,
        }
    }

    /// Metres in a step of the texels.
    #[inline(always)]
    pub(super) fn metres_per_step(&self) -> f32 {
        self.metres_per_step
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

/// Where windows lie in the array of their level.
#[derive(Clone, Copy)]
struct Place {
    rows: u32,
    columns: u32,
    turns: f32,
}

/// Cells of `level` in a pixel.
#[inline(always)]
fn shrink(level: u32) -> f32 {
    f32::from_bits((127 - level) << 23)
}

impl Place {
    /// Window row of an image row. Row r is the pixel from r - 0.5 to r + 0.5; all rows above the image count as row -1 of
    /// their level, in window row 0.
    #[inline(always)]
    fn top(&self, row: f32, level: u32) -> i32 {
        let top = (row + 0.5) * shrink(level) + 1.0;
        whole(if top > 0.0 { top } else { 0.0 })
    }

    /// Window column of an image column, not wrapped.
    #[inline(always)]
    fn left(&self, column: f32, level: u32) -> i32 {
        whole((column + self.turns) * shrink(level))
    }

    /// Nothing was seen below the image: the row after the last is blind.
    #[inline(always)]
    fn index(&self, top: i32, left: i32, level: u32) -> u32 {
        let (last, width) = ((self.rows >> level) as i32, self.columns >> level);
        let top = if top > last { last + 1 } else { top };
        top as u32 * width + (left as u32 & (width - 1))
    }
}

/// A row of pixels from as many ranges.
struct Line<'a> {
    ranges: &'a [f32],
    max_range: f32,
    unseen: f32,
    pixels: &'a mut [Texel],
}

impl Kernel for Line<'_> {
    #[inline(always)]
    fn run(self) {
        for (pixel, &range) in self.pixels.iter_mut().zip(self.ranges) {
            let known = if range < self.max_range { range } else { self.max_range };
            let seen = if range > 0.0 { known } else { self.unseen };
            *pixel = Texel { near: if seen < 0.0 { f32::INFINITY } else { seen }, far: seen };
        }
    }
}

/// A row of pixels from more ranges.
fn show_in_fewer(ranges: &[f32], max_range: f32, unseen: f32, pixels: &mut [Texel]) {
    let columns = pixels.len();
    for (column, &range) in ranges.iter().enumerate() {
        let seen = if range > 0.0 { range.min(max_range) } else { unseen };
        if seen >= 0.0 {
            let pixel = &mut pixels[column * columns / ranges.len()];
            *pixel = Texel { near: pixel.near.min(seen), far: pixel.far.max(seen) };
        }
    }
}

/// The pyramid from pixels.
struct Levels<'a> {
    visibility: &'a mut Visibility,
    rows: usize,
    per_metre: f32,
}

impl Kernel for Levels<'_> {
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
            let mut image = Visibility::new(&model);
            image.build(&RangeImage { rows: 16, columns: 64, ranges: ranges.clone(), points: Vec::new() }, 60.0, false, false);
            let mut looks = Looks::new();
            (looks.row, looks.column, looks.reach) = ([row; LANES], [column; LANES], [[row_radius; LANES], [column_radius; LANES]]);
            looks.level = [level_for(row_radius, column_radius); LANES];
            if looks.level[0] >= LEVELS as u32 {
                prop_assert!(2.0 * row_radius.max(column_radius) > 64.0);
                return Ok(());
            }
            let (start, closer) = image.starts_of(looks.level[0]);
            (looks.start, looks.start_closer) = ([start; LANES], [closer; LANES]);
            let mut seen = |look: &dyn Fn(&Visibility, &mut Looks, usize)| {
                look(&image, &mut looks, 9);
                looks.texel[7]
            };
            let texels = seen(&Visibility::texels);
            let close = seen(&Visibility::close_texels);
            let single = seen(&Visibility::pixels);
            let near_of = |texel: Packed| near_of(texel) * image.metres_per_step();
            let far_of = |texel: Packed| far_of(texel) * image.metres_per_step();
            let (has_hole, has_rim) = (|texel: Packed| texel & HOLE_BIT != 0, |texel: Packed| texel & RIM_BIT != 0);
            let mut filled: Vec<Texel> = ranges.iter().map(|&r| if r > 0.0 { Texel { near: r, far: r } } else { BLANK }).collect();
            fill_gaps(&mut filled, &mut Vec::new(), 64, 2, SAME_SURFACE);
            grow(&mut filled, &mut Vec::new(), 64);
            // What is above the image counts as the row above it.
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
            for t in [texels, close] {
                prop_assert!((near == 60.0 || near_of(t) <= near) && far_of(t) >= far, "{t:x} against {near} {far}");
                prop_assert!(has_hole(t) >= hole && has_rim(t) >= rim, "{t:x} against {hole} {rim}");
            }
            if row_radius.max(column_radius) <= 1.0 {
                let (near, far, hole, rim) = bounds(1);
                prop_assert!(near_of(close) >= near - 4e-3 && far_of(close) <= far + 4e-3, "close for small patches: {close:x} against {near} {far}");
                prop_assert!(has_hole(close) <= hole && has_rim(close) <= rim);
            }
            let inside = (0.0..16.0).contains(&(row + 0.5));
            prop_assert_eq!(single & (HOLE_BIT | RIM_BIT) == 0, inside && filled[(row + 0.5) as usize * 64 + column as usize].far >= 0.0);
        }
    }
}
