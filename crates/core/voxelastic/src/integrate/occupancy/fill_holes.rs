//! Hole filling in a range image: pixels without return between pixels with returns.

use super::texel::Texel;

/// A pixel without return.
pub(super) const EMPTY: Texel = Texel { near: f32::INFINITY, far: -1.0 };

/// Fills holes of at most `widest` pixels in a row, then of one pixel in a column, with the range interval of the two pixels beside them. `pixels` is a
/// row-major image of `columns` columns, whose rows are closed circles. The farther of the two pixels may be at most `similar` times as far as the nearer one,
/// so that they are on the same surface.
///
/// Between the beams of neighbouring rows nothing is measured either, so a hole of about that width loses nothing.
pub(super) fn fill_holes(pixels: &mut [Texel], before: &mut Vec<Texel>, columns: usize, widest: usize, similar: f32) {
    before.clear();
    before.extend_from_slice(pixels);
    for (from, to) in before.chunks(columns).zip(pixels.chunks_mut(columns)) {
        fill_row(from, to, widest, similar);
    }
    before.copy_from_slice(pixels);
    for c in columns..pixels.len().saturating_sub(columns) {
        if before[c].far < 0.0 {
            pixels[c] = bridge(before[c - columns], before[c + columns], similar);
        }
    }
}

/// Fills empty pixels next to pixels with returns, in any of the eight directions, with the range interval of these neighbours.
///
/// Queries of the pyramid extend a patch by half a pixel, to include the rays on all sides of it, which enlarges holes by half a pixel; dilation by one pixel
/// compensates for that. Patches more than half a pixel inside of a hole remain without return.
pub(super) fn dilate(pixels: &mut [Texel], before: &mut Vec<Texel>, columns: usize) {
    before.clear();
    before.extend_from_slice(pixels);
    let rows = pixels.len() / columns;
    for row in 0..rows {
        let lines = row.saturating_sub(1)..(row + 2).min(rows);
        for c in 0..columns {
            if before[row * columns + c].far >= 0.0 {
                continue;
            }
            let around = [if c == 0 { columns - 1 } else { c - 1 }, c, if c + 1 == columns { 0 } else { c + 1 }];
            let mut merged = EMPTY;
            for line in lines.clone() {
                for c in around {
                    let neighbour = before[line * columns + c];
                    // An empty one changes neither bound.
                    merged = Texel { near: merged.near.min(neighbour.near), far: merged.far.max(neighbour.far) };
                }
            }
            pixels[row * columns + c] = merged;
        }
    }
}

/// Fills holes of at most `gap` pixels in a row of pixels that is a closed circle.
fn fill_row(from: &[Texel], to: &mut [Texel], gap: usize, similar: f32) {
    let columns = from.len();
    let Some(first) = from.iter().position(|pixel| pixel.far >= 0.0) else { return };
    let mut last = first;
    // Once around, back to the first.
    let circle = (first + 1..columns).chain(columns..=first + columns);
    for c in circle {
        let here = from[if c < columns { c } else { c - columns }];
        if here.far < 0.0 {
            continue;
        }
        if (2..=gap + 1).contains(&(c - last)) {
            let between = bridge(from[last % columns], here, similar);
            (last + 1..c).for_each(|empty| to[empty % columns] = between);
        }
        last = c;
    }
}

/// The range interval of two pixels with returns; empty when they differ too much or one is empty.
fn bridge(a: Texel, b: Texel, similar: f32) -> Texel {
    let between = Texel { near: a.near.min(b.near), far: a.far.max(b.far) };
    if a.far >= 0.0 && b.far >= 0.0 && between.far <= similar * between.near { between } else { EMPTY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The nearest return among `reach` pixels on one side.
    fn neighbour(line: &[Texel], c: usize, step: isize, reach: usize) -> Option<(usize, Texel)> {
        let n = line.len() as isize;
        (1..=reach).map(|d| (d, line[(c as isize + step * d as isize).rem_euclid(n) as usize])).find(|(_, pixel)| pixel.far >= 0.0)
    }

    proptest! {
        #[test]
        fn holes_take_the_interval_of_both_sides(
            ranges in prop::collection::vec(prop_oneof![1 => 1f32..3.0, 1 => Just(0f32)], 6 * 24), widest in 1usize..5, similar in 1f32..2.5,
        ) {
            let merged = |&r: &f32| if r > 0.0 { Texel { near: r, far: r } } else { EMPTY };
            let image: Vec<Texel> = ranges.iter().map(merged).collect();
            let between = |a: Texel, b: Texel| {
                let (near, far) = (a.near.min(b.near), a.far.max(b.far));
                if far <= similar * near { Texel { near, far } } else { EMPTY }
            };
            let mut expected = image.clone();
            for (row, line) in image.chunks(24).enumerate() {
                for c in (0..24).filter(|&c| line[c].far < 0.0) {
                    if let (Some((left, a)), Some((right, b))) = (neighbour(line, c, -1, widest), neighbour(line, c, 1, widest))
                        && left + right <= widest + 1
                    {
                        expected[row * 24 + c] = between(a, b);
                    }
                }
            }
            let once = expected.clone();
            for c in (24..5 * 24).filter(|&c| once[c].far < 0.0) {
                if once[c - 24].far >= 0.0 && once[c + 24].far >= 0.0 {
                    expected[c] = between(once[c - 24], once[c + 24]);
                }
            }
            let mut filled = image;
            fill_holes(&mut filled, &mut Vec::new(), 24, widest, similar);
            prop_assert_eq!(&filled, &expected);
            dilate(&mut filled, &mut Vec::new(), 24);
            for (i, pixel) in filled.iter().enumerate() {
                let (row, column) = (i as i32 / 24, i as i32 % 24);
                let neighbour = |j: &usize| {
                    let turn = (*j as i32 % 24 - column).rem_euclid(24);
                    (*j as i32 / 24 - row).abs() <= 1 && (turn <= 1 || turn == 23)
                };
                let around: Vec<Texel> = (0..6 * 24).filter(neighbour).map(|j| expected[j]).filter(|p| p.far >= 0.0).collect();
                let near = around.iter().map(|p| p.near).fold(f32::INFINITY, f32::min);
                let far = around.iter().map(|p| p.far).fold(-1.0, f32::max);
                let grown = if expected[i].far < 0.0 { Texel { near, far } } else { expected[i] };
                prop_assert_eq!(*pixel, grown);
            }
        }
    }
}
