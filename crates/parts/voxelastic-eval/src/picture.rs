//! A picture in memory, and PNG files.

use crate::colour::Rgb;
use crate::{EvalError, error::Result};
use std::io::Write;
use std::path::Path;
use tiny_skia::{Pixmap, PremultipliedColorU8};

/// Size of a picture in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Pixels across, 1 to 16384.
    pub width: u32,
    /// Pixels down, 1 to 16384.
    pub height: u32,
}

/// A picture, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Its size.
    pub size: Size,
    /// Colours, `width * height` of them.
    pub pixels: Vec<Rgb>,
}

impl Picture {
    /// Writes the picture as PNG.
    ///
    /// # Errors
    /// [`EvalError::Picture`] for a size of zero or beyond memory; [`EvalError::Write`] when the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<()> {
        write_png(&self.to_pixmap()?, path)
    }

    /// The picture as an opaque pixmap to draw on.
    pub(crate) fn to_pixmap(&self) -> Result<Pixmap> {
        let mut pixmap = empty_pixmap(self.size)?;
        for (to, c) in pixmap.pixels_mut().iter_mut().zip(&self.pixels) {
            *to = PremultipliedColorU8::from_rgba(c[0], c[1], c[2], 255).unwrap_or(PremultipliedColorU8::TRANSPARENT);
        }
        Ok(pixmap)
    }

    /// The colours of an opaque pixmap.
    pub(crate) fn from_pixmap(pixmap: &Pixmap) -> Self {
        let size = Size { width: pixmap.width(), height: pixmap.height() };
        Self { size, pixels: pixmap.pixels().iter().map(|p| [p.red(), p.green(), p.blue()]).collect() }
    }
}

/// A transparent pixmap.
///
/// # Errors
/// [`EvalError::Picture`] for a size of zero or beyond memory.
pub(crate) fn empty_pixmap(size: Size) -> Result<Pixmap> {
    let Size { width, height } = size;
    let reason = || "a side is zero, or the picture is too large".to_owned();
    Pixmap::new(width, height).ok_or_else(|| EvalError::Picture { width, height, reason: reason() })
}

/// Encodes a pixmap and writes it to a file.
pub(crate) fn write_png(pixmap: &Pixmap, path: &Path) -> Result<()> {
    let failed = |reason| EvalError::Picture { width: pixmap.width(), height: pixmap.height(), reason };
    let bytes = pixmap.encode_png().map_err(|e| failed(e.to_string()))?;
    voxelastic_files::write(path, |out| out.write_all(&bytes)).map_err(|source| EvalError::Write { path: path.to_owned(), source })
}
