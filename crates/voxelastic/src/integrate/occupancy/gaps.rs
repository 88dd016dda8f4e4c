//! Small gaps in a range image: beams without return among beams that came back.

use super::texel::Texel;

/// A pixel that saw nothing.
pub(super) const BLANK: Texel = Texel { near: f32::INFINITY, far: -1.0 };

/// Empty pixels between two returns of a row, then of a column, take the nearer and the farther of them: `pixels` is a row-major
/// image of `columns` columns, whose rows close on themselves. A gap in a grid is a beam that found nothing, so there the two
/// must see the same surface: `similar` is how much farther the farther one may be.
///
/// Between the beams of neighbouring rows nothing is measured either; so a gap may be about as wide, `widest` pixels, and one
/// row high.
pub(super) fn fill_gaps(pixels: &mut [Texel], before: &mut Vec<Texel>, columns: usize, widest: usize, similar: f32) {
    before.clear();
    before.extend_from_slice(pixels);
    for (from, to) in before.chunks(columns).zip(pixels.chunks_mut(columns)) {
        fill_circle(from, to, widest, similar);
    }
    before.copy_from_slice(pixels);
    for c in columns..pixels.len().saturating_sub(columns) {
        if before[c].far < 0.0 {
            pixels[c] = bridge(before[c - columns], before[c + columns], similar);
        }
    }
}

/// Empty pixels beside one that saw something, in any of the eight directions, take the nearest and the farthest of those.
///
/// What looks at a patch of the image looks half a pixel around it too, for the beams on all sides; this keeps holes from
/// growing by that. In return nothing more than half a pixel inside of a hole counts as seen.
pub(super) fn grow(pixels: &mut [Texel], before: &mut Vec<Texel>, columns: usize) {
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
            let mut seen = BLANK;
            for line in lines.clone() {
                for c in around {
                    let beside = before[line * columns + c];
                    // A blank one changes neither.
                    seen = Texel { near: seen.near.min(beside.near), far: seen.far.max(beside.far) };
                }
            }
            pixels[row * columns + c] = seen;
        }
    }
}

/// Fills gaps of at most `gap` pixels in a row of pixels that closes on itself.
fn fill_circle(from: &[Texel], to: &mut [Texel], gap: usize, similar: f32) {
    let columns = from.len();
    let Some(first) = from.iter().position(|pixel| pixel.far >= 0.0) else { return };
    let mut last = first;
    // Once round, back to the first.
    let round = (first + 1..columns).chain(columns..=first + columns);
    for c in round {
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

/// What lies between two pixels that saw something; nothing when they are too different.
fn bridge(a: Texel, b: Texel, similar: f32) -> Texel {
    let between = Texel { near: a.near.min(b.near), far: a.far.max(b.far) };
    if a.far >= 0.0 && b.far >= 0.0 && between.far <= similar * between.near { between } else { BLANK }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The nearest return among `reach` pixels on one side.
    fn beside(line: &[Texel], c: usize, step: isize, reach: usize) -> Option<(usize, Texel)> {
        let n = line.len() as isize;
        (1..=reach).map(|d| (d, line[(c as isize + step * d as isize).rem_euclid(n) as usize])).find(|(_, pixel)| pixel.far >= 0.0)
    }

    proptest! {
        #[test]
        fn gaps_take_what_both_sides_saw(
            ranges in prop::collection::vec(prop_oneof![1 => 1f32..3.0, 1 => Just(0f32)], 6 * 24), widest in 1usize..5, similar in 1f32..2.5,
        ) {
            let seen = |&r: &f32| if r > 0.0 { Texel { near: r, far: r } } else { BLANK };
            let image: Vec<Texel> = ranges.iter().map(seen).collect();
            let between = |a: Texel, b: Texel| {
                let (near, far) = (a.near.min(b.near), a.far.max(b.far));
                if far <= similar * near { Texel { near, far } } else { BLANK }
            };
            let mut expected = image.clone();
            for (row, line) in image.chunks(24).enumerate() {
                for c in (0..24).filter(|&c| line[c].far < 0.0) {
                    if let (Some((left, a)), Some((right, b))) = (beside(line, c, -1, widest), beside(line, c, 1, widest))
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
            fill_gaps(&mut filled, &mut Vec::new(), 24, widest, similar);
            prop_assert_eq!(&filled, &expected);
            grow(&mut filled, &mut Vec::new(), 24);
            for (i, pixel) in filled.iter().enumerate() {
                let (row, column) = (i as i32 / 24, i as i32 % 24);
                let beside = |j: &usize| {
                    let turn = (*j as i32 % 24 - column).rem_euclid(24);
                    (*j as i32 / 24 - row).abs() <= 1 && (turn <= 1 || turn == 23)
                };
                let around: Vec<Texel> = (0..6 * 24).filter(beside).map(|j| expected[j]).filter(|p| p.far >= 0.0).collect();
                let near = around.iter().map(|p| p.near).fold(f32::INFINITY, f32::min);
                let far = around.iter().map(|p| p.far).fold(-1.0, f32::max);
                let grown = if expected[i].far < 0.0 { Texel { near, far } } else { expected[i] };
                prop_assert_eq!(*pixel, grown);
            }
        }
    }
}
