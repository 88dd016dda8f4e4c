//! A canvas to draw lines, boxes and text on.

use crate::colour::Rgb;
use crate::picture::{self, Picture, Size};
use crate::{error::Result, glyphs};
use std::path::Path;
use tiny_skia::{Color, LineCap, LineJoin, Paint, PathBuilder, Pixmap, Rect, Stroke, Transform};

/// Which point of a text its position refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    /// Offset from the anchor to the left edge of a text of this width.
    pub fn shift(self, width: f32) -> f32 {
        match self {
            Self::Start => 0.0,
            Self::Middle => -width / 2.0,
            Self::End => -width,
        }
    }
}

/// A picture that can be drawn on. Positions in pixels from the top left.
pub(crate) struct Canvas {
    pixmap: Pixmap,
}

impl Canvas {
    /// A canvas of one colour.
    pub fn new(size: Size, background: Rgb) -> Result<Self> {
        let mut pixmap = picture::empty_pixmap(size)?;
        pixmap.fill(Color::from_rgba8(background[0], background[1], background[2], 255));
        Ok(Self { pixmap })
    }

    /// A canvas with a picture as background.
    pub fn from_picture(picture: &Picture) -> Result<Self> {
        Ok(Self { pixmap: picture.to_pixmap()? })
    }

    /// The canvas as a picture.
    pub fn into_picture(self) -> Picture {
        Picture::from_pixmap(&self.pixmap)
    }

    /// Fills a box with the given upper left corner and size.
    pub fn fill(&mut self, [x, y]: [f32; 2], [w, h]: [f32; 2], colour: Rgb, alpha: u8) {
        if let Some(rect) = Rect::from_xywh(x, y, w.max(0.0), h.max(0.0)) {
            self.pixmap.fill_rect(rect, &paint(colour, alpha), Transform::identity(), None);
        }
    }

    /// Draws polylines.
    pub fn lines<'a>(&mut self, lines: impl Iterator<Item = &'a [[f32; 2]]>, width: f32, colour: Rgb) {
        let stroke = Stroke { width, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
        if let Some(path) = path(lines) {
            self.pixmap.stroke_path(&path, &paint(colour, 255), &stroke, Transform::identity(), None);
        }
    }

    /// Draws horizontal text with an outline of another colour that keeps it readable over a picture; see [`Canvas::text`].
    pub fn haloed_text(&mut self, text: &str, [x, y]: [f32; 2], capital: f32, anchor: Anchor, [colour, halo]: [Rgb; 2]) {
        let (mut strokes, width) = glyphs::strokes(text, capital);
        let shift = anchor.shift(width);
        strokes.iter_mut().flatten().for_each(|p| *p = [x + p[0] + shift, y + p[1] - capital]);
        self.lines(strokes.iter().map(Vec::as_slice), capital * 0.5, halo);
        self.lines(strokes.iter().map(Vec::as_slice), (capital * 0.14).max(1.0), colour);
    }

    /// Draws text with capitals of `capital` pixels. The position is on its base line; with `turned` it reads upwards.
    pub fn text(&mut self, text: &str, [x, y]: [f32; 2], capital: f32, anchor: Anchor, colour: Rgb, turned: bool) {
        let (mut strokes, width) = glyphs::strokes(text, capital);
        let shift = anchor.shift(width);
        for p in strokes.iter_mut().flatten() {
            let (dx, dy) = (p[0] + shift, p[1] - capital);
            *p = if turned { [x + dy, y - dx] } else { [x + dx, y + dy] };
        }
        self.lines(strokes.iter().map(Vec::as_slice), (capital * 0.14).max(1.0), colour);
    }

    /// Encodes and writes a PNG file.
    pub fn write_png(&self, file: &Path) -> Result<()> {
        picture::write_png(&self.pixmap, file)
    }
}

fn paint(colour: Rgb, alpha: u8) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(colour[0], colour[1], colour[2], alpha);
    paint
}

fn path<'a>(lines: impl Iterator<Item = &'a [[f32; 2]]>) -> Option<tiny_skia::Path> {
    let mut builder = PathBuilder::new();
    for line in lines.filter(|l| l.len() > 1 && l.iter().flatten().all(|c| c.is_finite())) {
        builder.move_to(line[0][0], line[0][1]);
        line[1..].iter().for_each(|p| builder.line_to(p[0], p[1]));
    }
    builder.finish()
}
