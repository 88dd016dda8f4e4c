//! A small stroke font, so that pictures have text without a font file.
//!
//! A glyph is drawn on a grid: y 0 is the top of capitals, 4 the top of small letters, c (12) the base line, g (16) the bottom of descenders.
//! Strokes are separated by blanks; each is a run of x y pairs in base 17; a stroke that begins with `~` is a smooth curve through control
//! points (closed when its ends agree).

/// Height of capitals in grid units.
const CAPITAL: f32 = 12.0;
/// Gap between letters in grid units.
const GAP: f32 = 3.0;

/// Strokes of a text as lists of points, and its width, for a given height of capitals, with the top left of the first capital at the origin.
pub(crate) fn strokes(text: &str, capital: f32) -> (Vec<Vec<[f32; 2]>>, f32) {
    let unit = capital / CAPITAL;
    let (mut out, mut x) = (Vec::new(), 0.0);
    for c in text.chars() {
        let (width, code) = glyph(c);
        for stroke in code.split_whitespace() {
            out.push(points(stroke).into_iter().map(|p| [(x + p[0]) * unit, p[1] * unit]).collect());
        }
        x += width + GAP;
    }
    (out, (x - GAP).max(0.0) * unit)
}

fn points(stroke: &str) -> Vec<[f32; 2]> {
    let (smooth, digits) = stroke.strip_prefix('~').map_or((false, stroke), |s| (true, s));
    let values: Vec<f32> = digits.chars().filter_map(|c| c.to_digit(17)).map(|d| d as f32).collect();
    let mut line: Vec<[f32; 2]> = values.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
    if smooth {
        for _ in 0..4 {
            line = cut_corners(&line);
        }
    }
    line
}

/// One round of Chaikin's corner cutting; ends stay unless the line is closed.
fn cut_corners(line: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let (Some(&first), Some(&last)) = (line.first(), line.last()) else { return Vec::new() };
    let closed = first == last;
    let mut out = Vec::with_capacity(line.len() * 2);
    if !closed {
        out.push(first);
    }
    for w in line.windows(2) {
        let at = |f: f32| [w[0][0] + (w[1][0] - w[0][0]) * f, w[0][1] + (w[1][1] - w[0][1]) * f];
        out.extend([at(0.25), at(0.75)]);
    }
    out.push(if closed { out[0] } else { last });
    out
}

/// Width and strokes of a character; a box for one that is not known.
#[rustfmt::skip]
fn glyph(c: char) -> (f32, &'static str) {
    match c {
        ' ' => (3.0, ""),
        '0' => (6.0, "~00606c0c00"), '1' => (4.0, "03404c"), '2' => (6.0, "~030060650c 0c6c"), '3' => (6.0, "~0200606626 ~26666c0c0a"),
        '4' => (6.0, "4c400868"), '5' => (6.0, "601006 ~0614646c1c0a"), '6' => (6.0, "~501208 ~04646c0c04"), '7' => (6.0, "00602c"),
        '8' => (6.0, "~0060660600 ~06666c0c06"), '9' => (6.0, "~0060680800 ~646a1c"),
        'A' => (6.0, "0c306c 1858"), 'B' => (6.0, "0c00 ~00606606 ~06767c0c"), 'C' => (6.0, "~6260000c6c6a"), 'D' => (6.0, "000c ~00707c0c"),
        'E' => (5.0, "50000c5c 0646"), 'F' => (5.0, "50000c 0646"), 'G' => (6.0, "~6260000c6c67 6737"), 'H' => (6.0, "000c 606c 0666"),
        'I' => (0.0, "000c"), 'J' => (5.0, "~505c0c09"), 'K' => (6.0, "000c 6007 256c"), 'L' => (5.0, "000c5c"), 'M' => (8.0, "0c0048808c"),
        'N' => (6.0, "0c006c60"), 'O' => (7.0, "~00707c0c00"), 'P' => (6.0, "0c00 ~00707707"), 'Q' => (7.0, "~00707c0c00 497d"),
        'R' => (6.0, "0c00 ~00707707 376c"), 'S' => (6.0, "~62600006666c0c0a"), 'T' => (6.0, "0060 303c"), 'U' => (6.0, "~00080c6c6860"),
        'V' => (6.0, "003c60"), 'W' => (8.0, "002c426c80"), 'X' => (6.0, "006c 600c"), 'Y' => (6.0, "003660 363c"), 'Z' => (6.0, "00600c6c"),
        'a' => (5.0, "~04545c0c04 545c"), 'b' => (5.0, "000c ~04545c0c04"), 'c' => (5.0, "~5654040c5c5a"), 'd' => (5.0, "505c ~04545c0c04"),
        'e' => (5.0, "0858 ~5854040c5c5b"), 'f' => (4.0, "~402024 242c 0444"), 'g' => (5.0, "~04545c0c04 545c ~5c5g0g0f"),
        'h' => (5.0, "000c ~08045458 585c"), 'i' => (0.0, "040c 0001"), 'j' => (2.0, "242c ~2c2g0g 2021"), 'k' => (5.0, "000c 5409 275c"),
        'l' => (0.0, "000c"), 'm' => (8.0, "040c ~08044448 484c ~48448488 888c"), 'n' => (5.0, "040c ~08045458 585c"), 'o' => (5.0, "~04545c0c04"),
        'p' => (5.0, "040g ~04545c0c04"), 'q' => (5.0, "545g ~04545c0c04"), 'r' => (4.0, "040c ~080444"), 's' => (5.0, "~56540408585c0c0a"),
        't' => (4.0, "2029 ~292c4c 0444"), 'u' => (5.0, "~04080c5c5854 545c"), 'v' => (4.0, "042c44"), 'w' => (8.0, "042c446c84"),
        'x' => (5.0, "045c 540c"), 'y' => (4.0, "042c 441g"), 'z' => (5.0, "04540c5c"),
        '&' => (7.0, "7c13 ~1310404325 ~25060c6c77"),
        '.' => (0.0, "0b0c"), ',' => (1.0, "1b0e"), '-' => (5.0, "0757"), '+' => (6.0, "0767 343a"), '=' => (6.0, "0565 0969"), '/' => (5.0, "0d50"),
        '%' => (7.0, "~0030340400 700c ~48787c4c48"), '(' => (2.0, "~2003092c"), ')' => (2.0, "~0023290c"), ':' => (0.0, "0506 0b0c"),
        '<' => (5.0, "53075b"), '>' => (5.0, "03570b"), '_' => (6.0, "0d6d"), '[' => (2.0, "20000c2c"), ']' => (2.0, "00202c0c"),
        '\u{b0}' => (4.0, "~0040440400"), '\u{b5}' => (5.0, "040g ~04080c5c5854 545c"), '\u{b2}' => (3.0, "~0100303305 0535"),
        '\u{d7}' => (4.0, "0549 4509"), '!' => (0.0, "0008 0b0c"), '?' => (6.0, "~0200606637 3738 3b3c"), '\'' => (0.0, "0002"),
        _ => (6.0, "00606c0c00"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_printable_character_has_strokes_within_its_grid() {
        for c in ('0'..='9').chain('a'..='z').chain('A'..='Z').chain(".,-+=/%()<>_[]:\u{b0}\u{b5}\u{b2}\u{d7}".chars()) {
            let (width, code) = glyph(c);
            assert_ne!(code, "00606c0c00", "{c}");
            for p in code.split_whitespace().flat_map(points) {
                assert!(p[0] <= width.max(1.0) + 1.0 && p[1] <= 16.0, "{c} {p:?}");
            }
        }
    }

    #[test]
    fn text_width_scales_with_height() {
        let (_, one) = strokes("12.5 m", 12.0);
        let (_, two) = strokes("12.5 m", 24.0);
        assert!((two - 2.0 * one).abs() < 1e-4 && one > 30.0);
    }
}
