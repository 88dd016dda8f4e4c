//! Overlays of a rendered picture: title, scale bar, colour bar.

use super::camera::{Camera, Projection};
use super::scene::{Legend, Scene};
use crate::canvas::{Anchor, Canvas};
use crate::colour::{Rgb, to_linear};
use crate::picture::Picture;
use crate::round_number::round_number;

/// Draws the overlays of the scene's style.
pub(super) fn draw(picture: &mut Picture, scene: &Scene<'_>, camera: &Camera) {
    let style = &scene.style;
    let bar = style.scale_bar && matches!(camera.projection, Projection::Orthographic { .. });
    if !bar && style.legend.is_none() && style.title.is_empty() {
        return;
    }
    let Ok(mut canvas) = Canvas::from_picture(picture) else { return };
    let pen = Pen::new(picture, style.background);
    if bar {
        let focal = camera.lens(picture.size.width, picture.size.height).focal;
        scale_bar(&mut canvas, &pen, f64::from(focal));
    }
    if let Some(legend) = &style.legend {
        colour_bar(&mut canvas, &pen, legend);
    }
    if !style.title.is_empty() {
        canvas.haloed_text(&style.title, [pen.margin, pen.margin + 1.2 * pen.capital], 1.2 * pen.capital, Anchor::Start, pen.colours());
    }
    *picture = canvas.into_picture();
}

/// Sizes and colours of the overlays, from the size and background of the picture.
struct Pen {
    width: f32,
    height: f32,
    capital: f32,
    margin: f32,
    ink: Rgb,
    paper: Rgb,
}

impl Pen {
    fn new(picture: &Picture, background: Rgb) -> Self {
        let (width, height) = (picture.size.width as f32, picture.size.height as f32);
        let capital = (width.min(height) / 72.0).clamp(6.0, 60.0);
        let lightness = background.iter().map(|&c| to_linear(c)).sum::<f32>() / 3.0;
        let ink = if lightness > 0.25 { [34, 36, 42] } else { [232, 232, 228] };
        Self { width, height, capital, margin: 2.2 * capital, ink, paper: background }
    }

    fn colours(&self) -> [Rgb; 2] {
        [self.ink, self.paper]
    }
}

fn scale_bar(canvas: &mut Canvas, pen: &Pen, pixels_per_metre: f64) {
    let metres = round_number(f64::from(pen.width) * 0.22 / pixels_per_metre);
    let length = (metres * pixels_per_metre) as f32;
    let (x, y, tick) = (pen.margin, pen.height - pen.margin, 0.45 * pen.capital);
    let line = [[x, y - tick], [x, y], [x + length, y], [x + length, y - tick]];
    canvas.lines([line.as_slice()].into_iter(), 0.5 * pen.capital, pen.paper);
    canvas.lines([line.as_slice()].into_iter(), (0.16 * pen.capital).max(1.2), pen.ink);
    let label = if metres >= 1000.0 {
        format!("{} km", metres / 1000.0)
    } else if metres >= 1.0 {
        format!("{metres} m")
    } else if metres >= 0.01 {
        format!("{} cm", (metres * 100.0).round())
    } else {
        format!("{:.2} mm", metres * 1000.0)
    };
    canvas.haloed_text(&label, [x + length / 2.0, y - 0.7 * pen.capital], pen.capital, Anchor::Middle, pen.colours());
}

fn colour_bar(canvas: &mut Canvas, pen: &Pen, legend: &Legend) {
    let length = (pen.width * 0.25).clamp(40.0, 600.0);
    let (x, y, thick) = (pen.width - pen.margin - length, pen.height - pen.margin - 1.5 * pen.capital, 0.9 * pen.capital);
    let steps = length.ceil() as usize;
    for i in 0..steps {
        let t = (i as f32 + 0.5) / steps as f32;
        canvas.fill([x + i as f32 * length / steps as f32, y - thick], [length / steps as f32 + 0.5, thick], legend.ramp.at(t), 255);
    }
    for t in [0.0, 0.5, 1.0] {
        let value = legend.low + (legend.high - legend.low) * t;
        let at = x + length * t;
        canvas.lines([[[at, y], [at, y + 0.4 * pen.capital]].as_slice()].into_iter(), 1.2, pen.ink);
        canvas.haloed_text(&short(value), [at, y + 1.5 * pen.capital], 0.85 * pen.capital, Anchor::Middle, pen.colours());
    }
    canvas.haloed_text(&legend.label, [x, y - thick - 0.7 * pen.capital], pen.capital, Anchor::Start, pen.colours());
}

/// A number with about three significant digits and no trailing zeros.
fn short(value: f32) -> String {
    let size = value.abs();
    let digits = if size >= 100.0 || size == 0.0 { 0 } else { (2 - (size.log10().floor() as i32).clamp(-4, 2)) as usize };
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        assert_eq!([short(0.05), short(12.34), short(-2.5), short(0.0), short(1234.0)], ["0.05", "12.3", "-2.5", "0", "1234"]);
    }
}
