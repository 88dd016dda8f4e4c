//! The layout of a cloud, as far as it determines the pixels of the points.

use super::beam_model::BeamModel;
use crate::Cloud;

/// How the pixel of each point follows from the order and the channels of a cloud.
#[derive(Clone, Debug, PartialEq)]
pub enum CloudLayout {
    /// The cloud is the sensor's grid.
    Grid(Grid),
    /// A ring channel gives the row; the column comes from the azimuth.
    Rings {
        /// Row of the range image of each ring number.
        row_of_ring: Vec<u16>,
    },
    /// No ring channel, but the points come ring by ring: a ring ends where the azimuth wraps (KITTI).
    RingOrder {
        /// Row of the range image of each ring, in the order of the cloud.
        row_of_ring: Vec<u16>,
    },
    /// Nothing is known: points are projected into the nearest pixel.
    Projected,
    /// No image fits, because beams never repeat or the cloud was thinned: every return is used, planes come from the nearest points in space, and an image
    /// of the directions in which there are returns serves free space only.
    Scattered,
}

/// The pixels of an organised cloud in the range image.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Whether the cloud's rows are the sensor's columns.
    pub transposed: bool,
    /// Row of the range image of each ring of the cloud.
    pub row_of_ring: Vec<u16>,
    /// Columns to add to each ring of the cloud, modulo the columns of the model, so that a column has one azimuth.
    pub shift_of_ring: Vec<i32>,
}

impl CloudLayout {
    /// Its name in figures: `grid`, `rings`, `ring order`, `projected` or `scattered`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Grid(_) => "grid",
            Self::Rings { .. } => "rings",
            Self::RingOrder { .. } => "ring order",
            Self::Projected => "projected",
            Self::Scattered => "scattered",
        }
    }

    /// An organised cloud in the order of the pixels of `model`.
    pub fn grid_of(model: &BeamModel) -> Self {
        let rows = model.rows();
        Self::Grid(Grid { transposed: false, row_of_ring: (0..rows as u16).collect(), shift_of_ring: vec![0; rows] })
    }
}

impl Grid {
    /// Rings and columns of `cloud` when it fits this grid and `model`.
    pub(crate) fn size_in(&self, cloud: &Cloud, model: &BeamModel) -> Option<(usize, usize)> {
        let (rings, columns) = if self.transposed { (cloud.width, cloud.height) } else { (cloud.height, cloud.width) };
        let fits = rings * columns == cloud.len() && rings == self.row_of_ring.len() && rings <= model.rows() && columns <= model.columns();
        fits.then_some((rings, columns))
    }

    /// Whether the pixel of a point is its index.
    pub(crate) fn is_identity(&self, model: &BeamModel, columns: usize) -> bool {
        let in_order = self.row_of_ring.iter().enumerate().all(|(i, &row)| i == usize::from(row));
        !self.transposed && columns == model.columns() && in_order && self.shift_of_ring.iter().all(|&s| s == 0)
    }
}

impl std::fmt::Display for CloudLayout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Grid(grid) if grid.transposed => write!(f, "organised, one column of the cloud a ring"),
            Self::Grid(grid) if grid.shift_of_ring.iter().any(|&s| s != 0) => write!(f, "organised in firing order, staggered rows set upright"),
            Self::Grid(_) => write!(f, "organised, kept as it is"),
            Self::Rings { .. } => write!(f, "rows from the ring channel, columns from the azimuth"),
            Self::RingOrder { .. } => write!(f, "rows from the order of the points (a ring ends where the azimuth wraps), columns from the azimuth"),
            Self::Projected => write!(f, "unorganised, projected into the nearest pixel"),
            Self::Scattered => write!(f, "no image fits the points: every return is used, planes are from the nearest points in space"),
        }
    }
}

/// Index after the last point of each ring of a cloud that comes ring by ring: where the azimuth crosses the x axis again.
///
/// A ring must have been behind the sensor before it can end: the points around the crossing jitter.
pub(crate) fn ring_ends(points: &[[f32; 3]]) -> Vec<u32> {
    let mut ends = Vec::new();
    let mut last: Option<(f32, f32)> = None;
    let (mut turning, mut was_behind) = (0i64, false);
    for (i, p) in points.iter().enumerate().filter(|(_, p)| Cloud::is_return(p)) {
        if let Some((x, y)) = last {
            turning += if x * p[1] - y * p[0] > 0.0 { 1 } else { -1 };
            let crosses = if turning > 0 { y < 0.0 && p[1] >= 0.0 } else { y > 0.0 && p[1] <= 0.0 };
            if crosses && was_behind && x + p[0] > 0.0 {
                ends.push(i as u32);
                was_behind = false;
            }
        }
        was_behind |= p[0] < 0.0;
        last = Some((p[0], p[1]));
    }
    ends.push(points.len() as u32);
    ends
}
