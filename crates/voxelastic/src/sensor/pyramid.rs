//! What a box of pixels sees, in a constant number of steps: min / max / coverage levels over the range image.

use super::image::RangeImage;

/// How much of a box of pixels saw anything: a return, or nothing up to the maximum range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// Every pixel did.
    All,
    /// Some did, or some may have.
    Some,
    /// None did: no return, too near, or outside of the field of view.
    None,
}

/// What a box of pixels sees. The bounds hold for every pixel of the box, and may be those of a slightly larger one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// No pixel that saw anything saw less far, metres; infinite when none saw a return.
    pub min: f32,
    /// No pixel saw a return farther away, metres; 0 when none saw anything, infinite when one saw beyond the maximum range.
    pub max: f32,
    /// How much of the box saw anything.
    pub coverage: Coverage,
}

/// A square of 2^level x 2^level pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Texel {
    min: f32,
    max: f32,
    /// Whether any pixel saw anything, and whether any did not.
    seen: bool,
    unseen: bool,
}

impl Texel {
    const EMPTY: Self = Self { min: f32::INFINITY, max: 0.0, seen: false, unseen: false };
    /// A pixel outside of the image.
    const OUTSIDE: Self = Self { unseen: true, ..Self::EMPTY };

    #[inline(always)]
    fn of(range: f32) -> Self {
        let seen = range > 0.0;
        Self { min: if seen { range } else { f32::INFINITY }, max: range, seen, unseen: !seen }
    }

    #[inline(always)]
    fn with(self, other: Self) -> Self {
        Self {
            min: if other.min < self.min { other.min } else { self.min },
            max: if other.max > self.max { other.max } else { self.max },
            seen: self.seen | other.seen,
            unseen: self.unseen | other.unseen,
        }
    }
}

/// One level: `rows` x `columns` texels.
#[derive(Clone, Debug, Default, PartialEq)]
struct Level {
    rows: usize,
    columns: usize,
    texels: Vec<Texel>,
}

/// The levels over one range image; level 0 has a texel for each pixel. Keeps its memory from scan to scan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pyramid {
    levels: Vec<Level>,
}

impl Pyramid {
    /// Builds the levels over `image`.
    pub fn build(&mut self, image: &RangeImage) {
        let (rows, columns) = (image.rows, image.columns);
        let count = rows.max(columns).next_power_of_two().ilog2() as usize + 1;
        self.levels.resize_with(count, Level::default);
        let first = &mut self.levels[0];
        (first.rows, first.columns) = (rows, columns);
        first.texels.clear();
        first.texels.extend(image.ranges.iter().map(|&r| Texel::of(r)));
        for level in 1..count {
            let (finer, coarser) = self.levels.split_at_mut(level);
            coarser[0].halve(&finer[level - 1]);
        }
    }

    /// What the pixels of `rows` x `columns` see, first and last included. Columns may lie beyond the ends of a turn (-3 is the
    /// third from the right); rows beyond the image are not in the field of view. At most twelve texels are read.
    pub fn classify(&self, rows: [i32; 2], columns: [i32; 2]) -> View {
        let Some(base) = self.levels.first().filter(|l| !l.texels.is_empty() && rows[0] <= rows[1] && columns[0] <= columns[1]) else {
            return Texel::OUTSIDE.into();
        };
        let (height, width) = (base.rows as i64, base.columns as i64);
        let first = i64::from(columns[0]).rem_euclid(width);
        let last = first + (i64::from(columns[1]) - i64::from(columns[0])).min(width - 1);
        let (top, bottom) = (i64::from(rows[0]).max(0), i64::from(rows[1]).min(height - 1));
        let clipped = top > i64::from(rows[0]) || bottom < i64::from(rows[1]);
        let mut all = if clipped { Texel::OUTSIDE } else { Texel::EMPTY };
        if top <= bottom {
            // Texels of half the box: it meets three of them at most in each direction.
            let size = (bottom - top + 1).max(last - first + 1) as u64;
            let level = (size.div_ceil(2).next_power_of_two().ilog2() as usize).min(self.levels.len() - 1);
            all = all.with(self.levels[level].read([top, bottom], [first, last.min(width - 1)], level));
            if last >= width {
                all = all.with(self.levels[level].read([top, bottom], [0, last - width], level));
            }
        }
        all.into()
    }
}

impl Level {
    /// Makes this level from the next finer one.
    fn halve(&mut self, finer: &Self) {
        (self.rows, self.columns) = (finer.rows.div_ceil(2), finer.columns.div_ceil(2));
        self.texels.clear();
        for rows in finer.texels.chunks(2 * finer.columns) {
            let (upper, lower) = rows.split_at(finer.columns);
            let lower = if lower.is_empty() { upper } else { lower };
            let pairs = upper.chunks(2).zip(lower.chunks(2));
            self.texels.extend(pairs.map(|(a, b)| a[0].with(b[0]).with(a[a.len() - 1]).with(b[b.len() - 1])));
        }
    }

    /// Joins the texels that hold these pixels, first and last included.
    fn read(&self, rows: [i64; 2], columns: [i64; 2], level: usize) -> Texel {
        let [top, bottom, first, last] = [rows[0], rows[1], columns[0], columns[1]].map(|pixel| (pixel >> level) as usize);
        let mut all = Texel::EMPTY;
        for row in top..=bottom {
            for texel in &self.texels[row * self.columns + first..=row * self.columns + last] {
                all = all.with(*texel);
            }
        }
        all
    }
}

impl From<Texel> for View {
    fn from(texel: Texel) -> Self {
        let coverage = match (texel.seen, texel.unseen) {
            (true, false) => Coverage::All,
            (true, true) => Coverage::Some,
            (false, _) => Coverage::None,
        };
        Self { min: texel.min, max: texel.max, coverage }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The obvious way: look at every pixel.
    fn brute_force(image: &RangeImage, rows: [i32; 2], columns: [i32; 2]) -> View {
        let mut all = Texel::EMPTY;
        for row in rows[0]..=rows[1] {
            for column in columns[0]..=columns[1] {
                let inside = (0..image.rows as i32).contains(&row);
                let column = column.rem_euclid(image.columns as i32) as usize;
                all = all.with(if inside { Texel::of(image.range(row as usize, column)) } else { Texel::OUTSIDE });
            }
        }
        all.into()
    }

    fn image() -> impl Strategy<Value = RangeImage> {
        let size = (1usize..40, prop_oneof![Just(64usize), Just(50), 1usize..90]);
        size.prop_flat_map(|(rows, columns)| {
            let range = prop_oneof![1 => Just(0.0f32), 1 => Just(f32::INFINITY), 8 => 0.5f32..60.0];
            // Patches of one kind, so that whole boxes are seen or unseen now and then.
            prop::collection::vec(range, rows * columns).prop_map(move |mut ranges| {
                for i in 0..ranges.len() {
                    if i % columns % 16 != 0 && (i / columns) % 4 < 2 && ranges[i - 1] == 0.0 {
                        ranges[i] = 0.0;
                    } else if (i / columns) % 8 > 3 && (i % columns) % 40 > 8 {
                        ranges[i] = ranges[i].clamp(2.0, 50.0);
                    }
                }
                RangeImage { rows, columns, points: vec![0; ranges.len()], ranges }
            })
        })
    }

    proptest! {
        #[test]
        fn bounds_hold(image in image(), boxes in prop::collection::vec((-10i32..50, 0i32..45, -200i32..200, 0i32..120), 30)) {
            let mut pyramid = Pyramid::default();
            pyramid.build(&image);
            for (row, height, column, width) in boxes {
                let (rows, columns) = ([row, row + height], [column, column + width]);
                let (fast, slow) = (pyramid.classify(rows, columns), brute_force(&image, rows, columns));
                prop_assert!(fast.min <= slow.min && fast.max >= slow.max, "{:?} {:?}", fast, slow);
                match fast.coverage {
                    Coverage::Some => {}
                    sure => prop_assert_eq!(sure, slow.coverage),
                }
                if height <= 1 && width <= 1 {
                    prop_assert_eq!(fast, slow, "boxes of two pixels are exact");
                }
            }
        }
    }

    #[test]
    fn the_empty_pyramid_sees_nothing() {
        assert_eq!(Pyramid::default().classify([0, 3], [0, 3]).coverage, Coverage::None);
        let mut pyramid = Pyramid::default();
        pyramid.build(&RangeImage { rows: 2, columns: 4, ranges: vec![5.0; 8], points: vec![0; 8] });
        assert_eq!(pyramid.classify([1, 0], [0, 3]).coverage, Coverage::None);
        assert_eq!(pyramid.classify([0, 1], [i32::MIN, i32::MAX]), View { min: 5.0, max: 5.0, coverage: Coverage::All });
        assert_eq!(pyramid.classify([i32::MIN, i32::MAX], [0, 0]).coverage, Coverage::Some);
    }
}
