//! How far the sensor saw in every direction, at every angular size: the pyramid that octants are held against.
//!
//! A texel of level L covers a *window* of 2 x 2 cells of 2^L x 2^L pixels, so that any patch no larger than such a cell
//! lies within one texel: classifying an octant reads one texel, whatever its size (DESIGN, core 4). The field of view's
//! rim and beams without return count as "saw nothing".

use super::gaps::{BLANK, fill_gaps, grow};
use super::rows::Rows;
use crate::sensor::{BeamModel, RangeImage};
use std::f32::consts::TAU;

/// Most levels of the pyramid: cells of 64 x 64 pixels.
pub(super) const LEVELS: usize = 7;

/// Nearest and farthest that a pixel saw, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub(super) struct Texel {
    pub near: f32,
    pub far: f32,
}

/// How far around a direction something reaches, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reach {
    pub rows: f32,
    pub columns: f32,
}

/// Where to look for what lies within a [`Reach`] of a direction: the level whose texels are large enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Window {
    level: usize,
    reach: Reach,
}

/// Texels of eight directions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texels {
    /// The nearest and the farthest that any pixel with a return saw, metres; without such a pixel beyond the maximum range, and 0.
    pub near: [f32; 8],
    /// See [`Texels::near`].
    pub far: [f32; 8],
    /// Whether a pixel within the field of view saw nothing.
    pub hole: [bool; 8],
    /// Whether a part lies outside of the field of view.
    pub rim: [bool; 8],
}

/// A texel in four bytes: near rounded down in the lowest 15 bits, far rounded up in the next 15, in steps of the pyramid;
/// then whether a part of it is a hole, and whether a part lies beyond the rim of the field of view.
type Packed = u32;

const FIELD: Packed = 0x7fff;
const FAR_SHIFT: u32 = 15;
const HOLE_BIT: Packed = 1 << 30;
const RIM_BIT: Packed = 1 << 31;

/// The pyramid of one scan.
#[derive(Clone, Debug)]
pub struct Visibility {
    rows: Rows,
    columns: usize,
    /// Azimuth of the left rim of column 0 and columns per radian, negative when columns run clockwise.
    first_azimuth: f32,
    per_radian: f32,
    /// Windows by level: `(rows >> level) + 1` x `columns >> level`, the first row reaching over the top rim.
    levels: [Vec<Packed>; LEVELS],
    metres_per_step: f32,
    /// Scratch space: pixels, the same before gaps were filled, and the cells of a level and of the next.
    pixels: Vec<Texel>,
    unfilled: Vec<Texel>,
    cells: Vec<Packed>,
    coarser: Vec<Packed>,
}

/// Ranges of beams on both sides of a gap differ by no more than this factor where the gap is on one surface.
const SAME_SURFACE: f32 = 1.1;
/// Gaps in a row are bridged up to this many times the angle between rows.
const GAP_SPACINGS: f32 = 1.5;
/// Outside of the field of view.
const NOTHING: Packed = RIM_BIT | FIELD;
/// A beam without return.
const HOLE: Packed = HOLE_BIT | FIELD;
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
            levels: std::array::from_fn(|_| Vec::new()),
            metres_per_step: 0.0,
            pixels: Vec::new(),
            unfilled: Vec::new(),
            cells: Vec::new(),
            coarser: Vec::new(),
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
        self.pixels.resize(rows * columns, BLANK);
        for row in 0..image.rows.min(self.rows.count) {
            let line = &mut self.pixels[row * columns..(row + 1) * columns];
            for (column, &range) in image.ranges[row * image.columns..(row + 1) * image.columns].iter().enumerate() {
                let pixel = &mut line[column * columns / image.columns];
                if range > 0.0 || clear_no_return {
                    let seen = if range > 0.0 { range.min(max_range) } else { max_range };
                    *pixel = Texel { near: pixel.near.min(seen), far: pixel.far.max(seen) };
                }
            }
        }
        let widest = (GAP_SPACINGS * self.columns_per_radian() / self.rows.per_radian) as usize;
        let similar = if fill { f32::INFINITY } else { SAME_SURFACE };
        let seen = &mut self.pixels[..self.rows.count * columns];
        fill_gaps(seen, &mut self.unfilled, columns, widest.clamp(2, columns / 8 + 2), similar);
        grow(seen, &mut self.unfilled, columns);
        self.metres_per_step = max_range / STEPS;
        let per_metre = STEPS / max_range;
        self.cells.clear();
        self.cells.extend(self.pixels[..self.rows.count * columns].iter().map(|pixel| pack(pixel, per_metre)));
        self.cells.resize(rows * columns, NOTHING);
        self.build_levels(rows);
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
                        windows.extend((0..width).map(|c| join([one[c], one[(c + 1) & (width - 1)], NOTHING, NOTHING])));
                    }
                    (None, None) => {}
                }
            }
            // Below the image nothing was seen.
            windows.resize(windows.len() + width, NOTHING);
            if level + 1 < LEVELS {
                self.coarser.clear();
                for row in 0..height / 2 {
                    let (a, b) = (&self.cells[2 * row * width..], &self.cells[(2 * row + 1) * width..]);
                    self.coarser.extend((0..width / 2).map(|c| join([a[2 * c], a[2 * c + 1], b[2 * c], b[2 * c + 1]])));
                }
                std::mem::swap(&mut self.cells, &mut self.coarser);
                (height, width) = (height / 2, width / 2);
            }
        }
    }

    /// The smallest level whose cells are as large as the reach around a direction; none when no texel is so large.
    #[inline(always)]
    pub(super) fn window_for(&self, reach: Reach) -> Option<Window> {
        let size = 2.0 * if reach.rows > reach.columns { reach.rows } else { reach.columns };
        if size > (1 << (LEVELS - 1)) as f32 {
            return None;
        }
        let size = if size > 1.0 { size } else { 1.0 };
        // The exponent of the next power of two.
        Some(Window { level: ((size.to_bits() + 0x007f_ffff) >> 23) as usize - 127, reach })
    }

    /// The texels that cover the window around eight directions: `row` and `column` fractional, see [`Rows::rows`] and
    /// [`columns_from`](Self::columns_from).
    #[inline(always)]
    pub(super) fn texels(&self, window: &Window, row: &[f32; 8], column: &[f32; 8]) -> Texels {
        let (level, place, reach) = (&self.levels[window.level], self.place(window.level), window.reach);
        // Loops, here and below: closures would not take part in the kernel's vector instructions.
        let (mut index, mut packed) = ([0u32; 8], [NOTHING; 8]);
        for i in 0..8 {
            index[i] = place.index(place.top(row[i] - reach.rows), place.left(column[i] - reach.columns));
        }
        for i in 0..8 {
            packed[i] = level[index[i] as usize];
        }
        self.unpack(&packed)
    }

    /// As [`texels`](Self::texels), with less around the windows: of each four texels of half the size, when it is small
    /// the window's own pixels and at most a row below and a column to the right.
    #[inline(always)]
    pub(super) fn close_texels(&self, window: &Window, row: &[f32; 8], column: &[f32; 8]) -> Texels {
        let finer = window.level.saturating_sub(1);
        let (level, place, reach) = (&self.levels[finer], self.place(finer), window.reach);
        let mut index = [[0u32; 8]; 4];
        for i in 0..8 {
            let (top, left) = (place.top(row[i] - reach.rows), place.left(column[i] - reach.columns));
            let (bottom, right) = (place.top(row[i] + reach.rows), place.left(column[i] + reach.columns));
            // A window reaches one cell further: the last ones start a cell early.
            let (bottom, right) = ((bottom - 1).max(top), (right - 1).max(left));
            index[0][i] = place.index(top, left);
            index[1][i] = place.index(top, right);
            index[2][i] = place.index(bottom, left);
            index[3][i] = place.index(bottom, right);
        }
        let mut corners = [[NOTHING; 8]; 4];
        for corner in 0..4 {
            for i in 0..8 {
                corners[corner][i] = level[index[corner][i] as usize];
            }
        }
        let mut packed = [NOTHING; 8];
        for i in 0..8 {
            packed[i] = join([corners[0][i], corners[1][i], corners[2][i], corners[3][i]]);
        }
        self.unpack(&packed)
    }

    /// Texels in metres.
    #[inline(always)]
    fn unpack(&self, packed: &[Packed; 8]) -> Texels {
        let step = self.metres_per_step;
        let mut texels = Texels { near: [0.0; 8], far: [0.0; 8], hole: [false; 8], rim: [false; 8] };
        for (i, &packed) in packed.iter().enumerate() {
            texels.near[i] = (packed & FIELD) as f32 * step;
            texels.far[i] = (packed >> FAR_SHIFT & FIELD) as f32 * step;
            texels.hole[i] = packed & HOLE_BIT != 0;
            texels.rim[i] = packed & RIM_BIT != 0;
        }
        texels
    }

    /// How cells of `level` are laid out.
    #[inline(always)]
    fn place(&self, level: usize) -> Place {
        let shrink = 1.0 / (1u32 << level) as f32;
        Place {
            shrink,
            width: (self.columns >> level) as u32,
            last: (self.padded_rows() >> level) as i32,
            // An azimuth is at most a turn and a bit off the first column: indices stay positive.
            turns: 4.0 * self.columns as f32,
        }
    }

    /// Whether the pixel at a row and column, or one right beside it, had a return.
    #[inline(always)]
    pub(super) fn saw(&self, row: f32, column: f32) -> bool {
        let (row, column) = (row + 0.5, column + 4.0 * self.columns as f32);
        if row < 0.0 || row >= self.rows.count as f32 {
            return false;
        }
        self.pixels[row as usize * self.columns + (column as usize & (self.columns - 1))].far >= 0.0
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

/// Where windows of one level lie in its array.
#[derive(Clone, Copy)]
struct Place {
    shrink: f32,
    width: u32,
    last: i32,
    turns: f32,
}

impl Place {
    /// Window row of an image row. Row r is the pixel from r - 0.5 to r + 0.5; all rows above the image count as row -1 of
    /// their level, in window row 0.
    #[inline(always)]
    fn top(&self, row: f32) -> i32 {
        let top = (row + 0.5) * self.shrink + 1.0;
        (if top > 0.0 { top } else { 0.0 }) as i32
    }

    /// Window column of an image column, not wrapped.
    #[inline(always)]
    fn left(&self, column: f32) -> i32 {
        ((column + self.turns) * self.shrink) as i32
    }

    /// Nothing was seen below the image: the row after the last is blind.
    #[inline(always)]
    fn index(&self, top: i32, left: i32) -> u32 {
        let top = if top > self.last { self.last + 1 } else { top };
        top as u32 * self.width + (left as u32 & (self.width - 1))
    }
}

#[inline(always)]
fn join(t: [Packed; 4]) -> Packed {
    let (mut near, mut far, mut flags) = (FIELD, 0, 0);
    for p in t {
        near = near.min(p & FIELD);
        far = far.max(p & FIELD << FAR_SHIFT);
        flags |= p & (HOLE_BIT | RIM_BIT);
    }
    flags | far | near
}

/// A pixel in steps: what it saw lies within the packed bounds. A blank one saw nothing.
#[inline(always)]
fn pack(pixel: &Texel, per_metre: f32) -> Packed {
    if pixel.far < 0.0 {
        return HOLE;
    }
    // The products' rounding must not push a bound inwards.
    let near = pixel.near * per_metre * (1.0 - 2.0 * f32::EPSILON);
    let far = pixel.far * per_metre * (1.0 + 2.0 * f32::EPSILON);
    (far.ceil() as u32) << FAR_SHIFT | near as u32
}

#[cfg(test)]
mod tests {
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
            let Some(window) = image.window_for(Reach { rows: row_radius, columns: column_radius }) else {
                prop_assert!(2.0 * row_radius.max(column_radius) > 64.0);
                return Ok(());
            };
            let texels = image.texels(&window, &[row; 8], &[column; 8]);
            let close = image.close_texels(&window, &[row; 8], &[column; 8]);
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
                prop_assert!((near == 60.0 || t.near[3] <= near) && t.far[3] >= far, "{t:?} against {near} {far}");
                prop_assert!(t.hole[5] >= hole && t.rim[6] >= rim, "{t:?} against {hole} {rim}");
            }
            if row_radius.max(column_radius) <= 1.0 {
                let (near, far, hole, rim) = bounds(1);
                prop_assert!(close.near[0] >= near - 4e-3 && close.far[0] <= far + 4e-3, "close for small patches: {close:?} against {near} {far}");
                prop_assert!(close.hole[0] <= hole && close.rim[0] <= rim);
            }
            let inside = (0.0..16.0).contains(&(row + 0.5));
            prop_assert_eq!(image.saw(row, column), inside && filled[(row + 0.5) as usize * 64 + column as usize].far >= 0.0);
        }
    }
}
