//! The range image: the spherical image of one scan.

/// Marks a pixel without a point.
pub const NO_POINT: u32 = u32::MAX;

/// The spherical image of a scan, rows top to bottom, row-major.
///
/// A range is the distance from the beam's origin in metres. It is 0 where there is no usable return (none reported, no point in an unorganised cloud, or nearer
/// than the near limit): nothing is known along that beam. It is infinite where the return is beyond the maximum range: the beam is free up to there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RangeImage {
    /// Rows, top to bottom.
    pub rows: usize,
    /// Columns of the full turn.
    pub columns: usize,
    /// Range of each pixel.
    pub ranges: Vec<f32>,
    /// Index into the cloud of the point that a pixel shows (the nearest one that falls into it), or [`NO_POINT`].
    pub points: Vec<u32>,
}

impl RangeImage {
    /// Makes an empty image of the given size, keeping the memory.
    pub(crate) fn reset(&mut self, rows: usize, columns: usize) {
        (self.rows, self.columns) = (rows, columns);
        self.ranges.clear();
        self.ranges.resize(rows * columns, 0.0);
        self.points.clear();
        self.points.resize(rows * columns, NO_POINT);
    }

    /// Shows point `index` at `range` in `pixel` unless a nearer one is there; of equally near ones the first stays.
    #[inline(always)]
    pub(crate) fn show(&mut self, pixel: usize, range: f32, index: u32) {
        let shown = self.ranges[pixel];
        if shown == 0.0 || range < shown {
            self.ranges[pixel] = range;
            self.points[pixel] = index;
        }
    }

    /// Range at a row and column.
    pub fn range(&self, row: usize, column: usize) -> f32 {
        self.ranges[row * self.columns + column]
    }
}
