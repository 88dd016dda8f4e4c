//! Lines, areas and letters on a picture: what overlays and plots draw with, and the way into PNG files.

use crate::colour::Rgb;
use crate::render::{Picture, Size};
use crate::{EvalError, error::Result, glyphs};
use std::path::Path;
use tiny_skia::{Color, LineCap, LineJoin, Paint, PathBuilder, Pixmap, PremultipliedColorU8, Rect, Stroke, Transform};

/// Where a text stands relative to its anchor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    /// What to add to the anchor's x to get that of the first letter.
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
        let mut pixmap = Pixmap::new(size.width, size.height).ok_or_else(|| EvalError::Picture {
            width: size.width,
            height: size.height,
            reason: "a side is zero, or the picture is too large".into(),
        })?;
        pixmap.fill(Color::from_rgba8(background[0], background[1], background[2], 255));
        Ok(Self { pixmap })
    }

    /// A canvas that shows a picture.
    pub fn from_picture(picture: &Picture) -> Result<Self> {
        let mut canvas = Self::new(picture.size, [0; 3])?;
        for (to, c) in canvas.pixmap.pixels_mut().iter_mut().zip(&picture.pixels) {
            *to = PremultipliedColorU8::from_rgba(c[0], c[1], c[2], 255).unwrap_or(PremultipliedColorU8::TRANSPARENT);
        }
        Ok(canvas)
    }

    /// What was drawn.
    pub fn into_picture(self) -> Picture {
        let size = Size { width: self.pixmap.width(), height: self.pixmap.height() };
        Picture { size, pixels: self.pixmap.pixels().iter().map(|p| [p.red(), p.green(), p.blue()]).collect() }
    }

    /// Fills a box of the given corner and size.
    pub fn fill(&mut self, [x, y]: [f32; 2], [w, h]: [f32; 2], colour: Rgb, alpha: u8) {
        if let Some(rect) = Rect::from_xywh(x, y, w.max(0.0), h.max(0.0)) {
            self.pixmap.fill_rect(rect, &paint(colour, alpha), Transform::identity(), None);
        }
    }

    /// Draws lines through points.
    pub fn lines<'a>(&mut self, lines: impl Iterator<Item = &'a [[f32; 2]]>, width: f32, colour: Rgb) {
        let stroke = Stroke { width, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
        if let Some(path) = path(lines) {
            self.pixmap.stroke_path(&path, &paint(colour, 255), &stroke, Transform::identity(), None);
        }
    }

    /// Like an unturned [`Canvas::text`], on a soft edge of another colour that keeps it readable over a picture.
    pub fn haloed_text(&mut self, text: &str, [x, y]: [f32; 2], capital: f32, anchor: Anchor, [colour, halo]: [Rgb; 2]) {
        let (mut strokes, width) = glyphs::strokes(text, capital);
        let shift = anchor.shift(width);
        strokes.iter_mut().flatten().for_each(|p| *p = [x + p[0] + shift, y + p[1] - capital]);
        self.lines(strokes.iter().map(Vec::as_slice), capital * 0.5, halo);
        self.lines(strokes.iter().map(Vec::as_slice), (capital * 0.14).max(1.0), colour);
    }

    /// Writes a text with capitals `capital` pixels high whose base line stands at the given place, read from below when `turned`.
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
        let bytes = self.pixmap.encode_png().map_err(|e| EvalError::Picture {
            width: self.pixmap.width(),
            height: self.pixmap.height(),
            reason: e.to_string(),
        })?;
        std::fs::write(file, bytes).map_err(|source| EvalError::Write { path: file.to_owned(), source })
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
