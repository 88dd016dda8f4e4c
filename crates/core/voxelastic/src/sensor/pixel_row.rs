//! The row of a pixel, kept from one pixel to the next: pixels of returns are in order, and a division each would cost more than what is done with most.

/// A row of an image, and the pixels in it.
pub(crate) struct PixelRow {
    columns: usize,
    row: usize,
    start: usize,
}

impl PixelRow {
    /// The first row of an image with so many columns.
    pub fn new(columns: usize) -> Self {
        Self { columns, row: 0, start: 0 }
    }

    /// Row and column of a pixel (row * columns + column). Fastest if the one before was in the same row.
    #[inline(always)]
    pub fn place(&mut self, pixel: usize) -> (usize, usize) {
        if pixel.wrapping_sub(self.start) >= self.columns {
            self.row = pixel / self.columns;
            self.start = self.row * self.columns;
        }
        (self.row, pixel - self.start)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn places_are_those_of_divisions_in_any_order(columns in 1usize..50, pixels in prop::collection::vec(0usize..500, 0..50)) {
            let mut row = PixelRow::new(columns);
            for pixel in pixels {
                prop_assert_eq!(row.place(pixel), (pixel / columns, pixel % columns));
            }
        }
    }
}
