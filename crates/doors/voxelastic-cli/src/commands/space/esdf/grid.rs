//! The points of a file of distances.

use voxelastic::geometry::Aabb;

/// Points on a lattice in the map frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// The first point, metres.
    pub origin: [f64; 3],
    /// Distance between neighbours, metres.
    pub spacing: f64,
    /// Points along each axis.
    pub shape: [usize; 3],
}

impl Grid {
    /// Most points of an array or a cloud: 4 GB of distances.
    pub const MOST_POINTS: usize = 1 << 30;
    /// Largest number of pixels along a side of a picture; larger pixels are used beyond.
    pub const MOST_PIXELS: f64 = 4000.0;

    /// The lattice in a box: points are the centres of cubes that fill it.
    pub fn new(bounds: Aabb, spacing: f64) -> Self {
        let shape = [0, 1, 2].map(|k| ((f64::from(bounds.size()[k]) / spacing).ceil() as usize).max(1));
        let is_flat = |k: usize| bounds.size()[k] == 0.0;
        let origin = std::array::from_fn(|k| f64::from(bounds.min[k]) + if is_flat(k) { 0.0 } else { 0.5 * spacing });
        Self { origin, spacing, shape }
    }

    /// Number of points.
    pub fn points(&self) -> usize {
        self.shape.iter().fold(1, |all, n| all.saturating_mul(*n))
    }

    /// The points of layer `z`, x fastest.
    pub fn layer(&self, z: usize) -> Vec<[f64; 3]> {
        let at = |k: usize, i: usize| self.origin[k] + i as f64 * self.spacing;
        (0..self.shape[1]).flat_map(|y| (0..self.shape[0]).map(move |x| [at(0, x), at(1, y), at(2, z)])).collect()
    }
}
