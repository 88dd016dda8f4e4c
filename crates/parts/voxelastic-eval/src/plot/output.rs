//! Plots as SVG and PNG.

use super::layout::layout;
use super::marks;
use super::model::Plot;
use crate::canvas::Canvas;
use crate::picture::Size;
use crate::{EvalError, error::Result};
use std::io::Write;
use std::path::Path;

impl Plot {
    /// The plot as an SVG element, for a file or inside HTML.
    pub fn to_svg(&self) -> String {
        let page = layout(self);
        marks::svg(&page.marks, page.size)
    }

    /// Writes an SVG file.
    ///
    /// # Errors
    /// [`EvalError::Write`].
    pub fn write_svg(&self, path: &Path) -> Result<()> {
        voxelastic_files::write(path, |out| out.write_all(self.to_svg().as_bytes()))
            .map_err(|source| EvalError::Write { path: path.to_owned(), source })
    }

    /// Writes a PNG file with two pixels per user unit, so that it is sharp in print.
    ///
    /// # Errors
    /// [`EvalError::Write`], and [`EvalError::Picture`] for a size of zero or beyond memory.
    pub fn write_png(&self, path: &Path) -> Result<()> {
        let page = layout(self);
        let size = Size { width: page.size.width.saturating_mul(2), height: page.size.height.saturating_mul(2) };
        let mut canvas = Canvas::new(size, [255; 3])?;
        marks::draw(&mut canvas, &page.marks, 2.0);
        canvas.write_png(path)
    }
}
