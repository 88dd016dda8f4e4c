//! A mesh as its writers take it.

use crate::{Error, Result};
use std::path::Path;

/// A triangle mesh to be written, in a frame whose z axis points up, metres.
#[derive(Clone, Copy, Debug, Default)]
pub struct MeshRef<'a> {
    /// Vertex positions, counted from `origin`.
    pub positions: &'a [[f32; 3]],
    /// What is added to all positions, for coordinates that are too large for single precision.
    pub origin: [f64; 3],
    /// Normals per vertex; empty if there are none.
    pub normals: &'a [[f32; 3]],
    /// Red, green and blue per vertex (sRGB).
    pub colours: Option<&'a [[u8; 3]]>,
    /// Strength of return per vertex.
    pub intensity: Option<&'a [f32]>,
    /// Vertex indices of each triangle, counter-clockwise seen from free space; empty for a cloud.
    pub triangles: &'a [[u32; 3]],
}

impl MeshRef<'_> {
    pub(super) fn has_origin(&self) -> bool {
        self.origin != [0.0; 3]
    }

    pub(super) fn check(&self, path: &Path) -> Result<()> {
        let vertices = self.positions.len();
        let fail = |problem: String| Err(Error::unwritable(path, problem));
        let lengths = [
            ("normals", Some(self.normals.len()).filter(|n| *n > 0)),
            ("colours", self.colours.map(<[_]>::len)),
            ("intensities", self.intensity.map(<[_]>::len)),
        ];
        for (name, length) in lengths {
            if let Some(length) = length.filter(|l| *l != vertices) {
                return fail(format!("{length} {name} for {vertices} vertices"));
            }
        }
        if u32::try_from(vertices).is_err() {
            return fail(format!("{vertices} vertices are more than 32-bit indices can name: write parts"));
        }
        if let Some(k) = self.positions.iter().position(|p| p.iter().any(|c| !c.is_finite())) {
            return fail(format!("the position of vertex {k} is not finite"));
        }
        if let Some(k) = self.triangles.iter().position(|t| t.iter().any(|v| *v as usize >= vertices)) {
            return fail(format!("triangle {k} names a vertex beyond the {vertices} there are"));
        }
        Ok(())
    }
}
