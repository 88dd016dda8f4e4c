//! Rasters of the ground plane: 2-D maps as robots load them.

pub mod map_server;

/// Where a raster lies: square pixels, the first at the corner with the smallest coordinates, rows along x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raster {
    /// Pixels along x and y.
    pub size: [usize; 2],
    /// Edge of a pixel, metres.
    pub pixel: f64,
    /// The corner with the smallest coordinates, metres.
    pub origin: [f64; 2],
}

impl Raster {
    /// Rows from the one with the largest y, as images have them.
    pub(crate) fn rows_down<'a, T>(&self, values: &'a [T]) -> impl Iterator<Item = &'a [T]> + use<'a, T> {
        values.chunks_exact(self.size[0].max(1)).rev()
    }
}
