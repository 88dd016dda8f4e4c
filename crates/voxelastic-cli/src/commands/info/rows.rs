//! Rows of the tables that `voxelastic info` prints.

use serde::Serialize;
use std::fmt;
use voxelastic::geometry::Aabb;

/// A row of a table.
pub fn row(name: &str, value: impl fmt::Display) -> (String, String) {
    (name.to_owned(), value.to_string())
}

/// An axis-aligned box, metres.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

impl Bounds {
    /// The box, if anything is in it.
    pub fn of(aabb: &Aabb) -> Option<Self> {
        (!aabb.is_empty()).then_some(Self { min: aabb.min, max: aabb.max })
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axis = |name: &str, k: usize| format!("{name} {:.2} to {:.2}", self.min[k], self.max[k]);
        write!(f, "{}, {}, {} m", axis("x", 0), axis("y", 1), axis("z", 2))
    }
}
