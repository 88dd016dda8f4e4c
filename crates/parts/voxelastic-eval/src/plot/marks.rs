//! The marks that plots are made of, drawn as SVG or on a canvas.

use crate::canvas::{Anchor, Canvas};
use crate::colour::Rgb;
use crate::picture::Size;
use std::fmt::Write;

/// Colour of text.
pub(super) const INK: Rgb = [40, 44, 52];
/// Colour of axes and tick labels.
pub(super) const SOFT: Rgb = [110, 116, 126];
/// Height of capitals.
pub(super) const CAPITAL: f32 = 8.6;

/// A mark, in user units from the top left.
#[derive(Clone, Debug)]
pub(super) enum Mark {
    Line { points: Vec<[f32; 2]>, width: f32, colour: Rgb },
    Box { at: [f32; 2], size: [f32; 2], colour: Rgb, alpha: u8 },
    Dot { at: [f32; 2], radius: f32, colour: Rgb },
    Text { text: String, at: [f32; 2], capital: f32, anchor: Anchor, colour: Rgb, turned: bool },
}

/// Horizontal text of the usual size; `at` is on its base line.
pub(super) fn text(text: &str, at: [f32; 2], anchor: Anchor, colour: Rgb) -> Mark {
    Mark::Text { text: text.into(), at, capital: CAPITAL, anchor, colour, turned: false }
}

/// An SVG element.
pub(super) fn svg(marks: &[Mark], size: Size) -> String {
    let (w, h) = (size.width, size.height);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" width=\"{w}\" height=\"{h}\" font-family=\"system-ui, sans-serif\">\n\
         <rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>\n"
    );
    for mark in marks {
        // Writing to a string cannot fail.
        let _ = write_mark(&mut out, mark);
    }
    out.push_str("</svg>\n");
    out
}

fn write_mark(out: &mut String, mark: &Mark) -> std::fmt::Result {
    match mark {
        Mark::Line { points, width, colour } => {
            out.write_str("<polyline points=\"")?;
            for (i, p) in points.iter().enumerate() {
                write!(out, "{}{:.1},{:.1}", if i == 0 { "" } else { " " }, p[0], p[1])?;
            }
            writeln!(
                out,
                "\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" stroke-linejoin=\"round\" stroke-linecap=\"round\"/>",
                hex(*colour)
            )
        }
        Mark::Box { at, size, colour, alpha } => {
            let opacity = f32::from(*alpha) / 255.0;
            let [x, y, w, h] = [at[0], at[1], size[0], size[1]];
            writeln!(
                out,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"{}\" fill-opacity=\"{opacity:.2}\"/>",
                hex(*colour)
            )
        }
        Mark::Dot { at, radius, colour } => {
            writeln!(out, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius}\" fill=\"{}\"/>", at[0], at[1], hex(*colour))
        }
        Mark::Text { text, at, capital, anchor, colour, turned } => {
            let anchor = match anchor {
                Anchor::Start => "start",
                Anchor::Middle => "middle",
                Anchor::End => "end",
            };
            let turn = if *turned { format!(" transform=\"rotate(-90 {:.1} {:.1})\"", at[0], at[1]) } else { String::new() };
            // Capitals are about 0.72 of the font size.
            let (size, fill) = (capital / 0.72, hex(*colour));
            let [x, y] = at;
            writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size:.1}\" text-anchor=\"{anchor}\" fill=\"{fill}\"{turn}>{}</text>",
                escaped(text)
            )
        }
    }
}

fn hex(c: Rgb) -> String {
    format!("#{:02x}{:02x}{:02x}", c[0], c[1], c[2])
}

/// Text escaped for XML, without control characters, which it forbids.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars().filter(|c| !c.is_control()) {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            _ => out.push(c),
        }
    }
    out
}

/// Draws the marks on a canvas, `scale` pixels per user unit.
pub(super) fn draw(canvas: &mut Canvas, marks: &[Mark], scale: f32) {
    let at = |p: &[f32; 2]| [p[0] * scale, p[1] * scale];
    for mark in marks {
        match mark {
            Mark::Line { points, width, colour } => {
                let points: Vec<[f32; 2]> = points.iter().map(at).collect();
                canvas.lines(std::iter::once(points.as_slice()), width * scale, *colour);
            }
            Mark::Box { at: p, size, colour, alpha } => canvas.fill(at(p), at(size), *colour, *alpha),
            Mark::Dot { at: p, radius, colour } => {
                let [x, y] = at(p);
                // A round cap at both ends of a line without length is a disc.
                canvas.lines(std::iter::once([[x, y], [x + 0.01, y]].as_slice()), 2.0 * radius * scale, *colour);
            }
            Mark::Text { text, at: p, capital, anchor, colour, turned } => canvas.text(text, at(p), capital * scale, *anchor, *colour, *turned),
        }
    }
}
