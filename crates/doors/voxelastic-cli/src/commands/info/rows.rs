//! Rows of the tables that `voxelastic info` prints.

use serde::Serialize;
use std::fmt;
use voxelastic::geometry::Aabb;
use voxelastic_io::Origin;

/// A row of a table.
pub fn row(name: &str, value: impl fmt::Display) -> (String, String) {
    (name.to_owned(), value.to_string())
}

/// An axis-aligned box, metres.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Bounds {
    min: [f64; 3],
    max: [f64; 3],
}

impl Bounds {
    /// The box, if anything is in it.
    pub fn of(aabb: &Aabb) -> Option<Self> {
        Self::around(aabb, Origin::default())
    }

    /// A box that counts from an origin, if anything is in it.
    pub fn around(aabb: &Aabb, origin: Origin) -> Option<Self> {
        // Decimals as single precision has them, not the nearest numbers of double precision.
        let precise = |c: f32| c.to_string().parse().unwrap_or_else(|_| f64::from(c));
        let corner = |p: [f32; 3]| origin.point_to_map(p.map(precise));
        (!aabb.is_empty()).then(|| Self { min: corner(aabb.min), max: corner(aabb.max) })
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axis = |name: &str, k: usize| format!("{name} {:.2} to {:.2}", self.min[k], self.max[k]);
        write!(f, "{}, {}, {} m", axis("x", 0), axis("y", 1), axis("z", 2))
    }
}
