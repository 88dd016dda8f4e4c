//! Nearest and farthest returns in windows of a range image.

use super::cells::{Cells, HOLE, STEP};
use crate::simd::{Kernel, dispatch};

/// Levels of windows; cells of each are twice as large as those of the one before.
pub(super) const LEVELS: usize = 5;
/// Fewer cells of a window with a return tell nothing.
const LEAST_CELLS: u8 = 4;
/// Windows of 3 x 3 cells around each cell, at several levels.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Windows {
    columns: usize,
    /// Nearest and farthest return in steps, of the first level; zeros where nothing is known.
    fine: Vec<[u16; 2]>,
    /// Columns and nearest returns of the others.
    coarse: Vec<(usize, Vec<u16>)>,
}

impl Windows {
    pub fn new(cells: &Cells) -> Self {
        let mut windows = Self::default();
        dispatch(Build { cells, windows: &mut windows });
        windows
    }

    /// Nearest and farthest return around a cell, metres; none where nothing is known.
    pub fn around(&self, row: usize, column: usize) -> Option<[f32; 2]> {
        let [near, far] = self.fine[row * self.columns + column];
        (far > 0).then(|| [f32::from(near) * STEP, f32::from(far) * STEP])
    }

    /// Nearest return in the window of `level` around a cell, metres; none where nothing is known.
    pub fn nearest(&self, level: usize, row: usize, column: usize) -> Option<f32> {
        let near = match level.checked_sub(1) {
            None => self.fine[row * self.columns + column][0],
            Some(i) => {
                let (columns, near) = &self.coarse[i];
                near[(row >> level) * columns + (column >> level)]
            }
        };
        (near > 0).then(|| f32::from(near) * STEP)
    }
}

struct Build<'a> {
    cells: &'a Cells,
    windows: &'a mut Windows,
}

impl Kernel for Build<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { cells, windows } = self;
        let (mut rows, mut columns, mut cells) = (cells.rows, cells.columns, cells.steps.clone());
        let mut near = Vec::new();
        around(&cells, rows, columns, &mut near);
        let mut far = Vec::new();
        let no_holes: Vec<u16> = cells.iter().map(|&cell| if cell == HOLE { 0 } else { cell + 1 }).collect();
        over(&no_holes, rows, columns, 0, |a, b| a.max(b), &mut far);
        windows.columns = columns;
        windows.fine = near.iter().zip(&far).map(|(&near, &far)| if near == 0 { [0, 0] } else { [near, far] }).collect();
        for _ in 1..LEVELS {
            cells = halved(&cells, rows, columns);
            (rows, columns) = (rows.div_ceil(2), columns.div_ceil(2));
            let mut near = Vec::new();
            around(&cells, rows, columns, &mut near);
            windows.coarse.push((columns, near));
        }
    }
}

/// The nearest of the cells around each one; zero where too few have a return.
#[inline(always)]
fn around(cells: &[u16], rows: usize, columns: usize, near: &mut Vec<u16>) {
    let mut counts = Vec::new();
    let has: Vec<u8> = cells.iter().map(|&cell| u8::from(cell != HOLE)).collect();
    over(cells, rows, columns, HOLE, |a, b| a.min(b), near);
    over(&has, rows, columns, 0, |a, b| a + b, &mut counts);
    near.iter_mut().zip(&counts).for_each(|(near, &count)| *near = if count < LEAST_CELLS { 0 } else { *near });
}

/// The nine cells around each one taken together; `none` stands for those outside of the image. Columns are a circle.
#[inline(always)]
fn over<T: Copy + Default>(cells: &[T], rows: usize, columns: usize, none: T, both: impl Fn(T, T) -> T + Copy, out: &mut Vec<T>) {
    let mut lines = vec![T::default(); cells.len()];
    for (row, line) in cells.chunks_exact(columns).zip(lines.chunks_exact_mut(columns)) {
        for (three, out) in row.windows(3).zip(line.iter_mut().skip(1)) {
            *out = both(both(three[0], three[1]), three[2]);
        }
        for c in [0, columns - 1] {
            let (left, right) = ((c + columns - 1) % columns, (c + 1) % columns);
            line[c] = both(both(row[left], row[c]), row[right]);
        }
    }
    out.clear();
    out.resize(cells.len(), T::default());
    let edge = vec![none; columns];
    for (r, out) in out.chunks_exact_mut(columns).enumerate() {
        let line = |r: Option<usize>| r.filter(|r| *r < rows).map_or(&edge[..], |r| &lines[r * columns..(r + 1) * columns]);
        let (above, here, below) = (line(r.checked_sub(1)), line(Some(r)), line(Some(r + 1)));
        for (((out, &a), &b), &c) in out.iter_mut().zip(above).zip(here).zip(below) {
            *out = both(both(a, b), c);
        }
    }
}

/// Cells of twice the size. One has a return if half of its four have. Missing cells at the end of odd rows and columns are as their neighbours.
#[inline(always)]
fn halved(cells: &[u16], rows: usize, columns: usize) -> Vec<u16> {
    let half = columns.div_ceil(2);
    let mut halved = vec![HOLE; rows.div_ceil(2) * half];
    let four = |a: u16, b: u16, c: u16, d: u16| {
        let count = u8::from(a != HOLE) + u8::from(b != HOLE) + u8::from(c != HOLE) + u8::from(d != HOLE);
        if count >= 2 { a.min(b).min(c).min(d) } else { HOLE }
    };
    for (r, out) in halved.chunks_exact_mut(half).enumerate() {
        let line = |r: usize| &cells[r.min(rows - 1) * columns..][..columns];
        let (above, below) = (line(2 * r), line(2 * r + 1));
        for ((out, a), b) in out.iter_mut().zip(above.chunks_exact(2)).zip(below.chunks_exact(2)) {
            *out = four(a[0], a[1], b[0], b[1]);
        }
        if columns % 2 == 1 {
            let (a, b) = (above[columns - 1], below[columns - 1]);
            out[half - 1] = four(a, a, b, b);
        }
    }
    halved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::RangeImage;
    use proptest::prelude::*;

    /// Nearest and farthest return of the cells around (row, column), cells of 2^level pixels, as it is defined.
    fn slow(image: &Cells, level: usize, row: usize, column: usize) -> Option<[f32; 2]> {
        // A cell has a return if half of its four cells of the level below have; the missing ones of odd images are as their neighbours.
        fn cell(image: &Cells, level: usize, row: usize, column: usize) -> Option<[u16; 2]> {
            let edge = |size: usize, level: usize| (0..level).fold(size, |size, _| size.div_ceil(2));
            if level == 0 {
                let steps = image.steps[row * image.columns + column];
                return (steps != HOLE).then(|| [steps, steps + 1]);
            }
            let (rows, columns) = (edge(image.rows, level - 1), edge(image.columns, level - 1));
            let below =
                [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(r, c)| cell(image, level - 1, (2 * row + r).min(rows - 1), (2 * column + c).min(columns - 1)));
            let found: Vec<[u16; 2]> = below.into_iter().flatten().collect();
            (found.len() >= 2).then(|| found.iter().fold([u16::MAX, 0], |all, c| [all[0].min(c[0]), all[1].max(c[1])]))
        }
        let edge = |size: usize| (0..level).fold(size, |size, _| size.div_ceil(2));
        let (rows, columns) = (edge(image.rows), edge(image.columns));
        let (row, column) = (row >> level, column >> level);
        let mut found = Vec::new();
        for r in row.saturating_sub(1)..(row + 2).min(rows) {
            for c in [column + columns - 1, column, column + 1] {
                found.extend(cell(image, level, r, c % columns));
            }
        }
        let steps = |s: u16| f32::from(s) * STEP;
        (found.len() >= usize::from(LEAST_CELLS))
            .then(|| found.iter().fold([u16::MAX, 0], |all, c| [all[0].min(c[0]), all[1].max(c[1])]))
            .map(|[near, far]| [steps(near), steps(far)])
    }

    proptest! {
        #[test]
        fn windows_are_as_defined(
            rows in 1usize..9,
            columns in 3usize..40,
            ranges in prop::collection::vec(prop_oneof![1 => Just(0.0f32), 3 => 0.005f32..80.0, 1 => Just(f32::INFINITY)], 9 * 40),
        ) {
            let ranges = ranges[..rows * columns].to_vec();
            let image = RangeImage { rows, columns, points: vec![0; ranges.len()], ranges };
            let image = Cells::of_image(&image);
            let windows = Windows::new(&image);
            for (row, column) in (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))) {
                prop_assert_eq!(windows.around(row, column), slow(&image, 0, row, column), "{} {}", row, column);
                for level in 0..LEVELS {
                    prop_assert_eq!(windows.nearest(level, row, column), slow(&image, level, row, column).map(|w| w[0]), "{} {} {}", level, row, column);
                }
            }
        }
    }
}
