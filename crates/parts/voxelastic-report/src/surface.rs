//! Surfaces to show on a page.

use crate::error::{ReportError, Result};
use serde::Serialize;

/// The surface of one submap, or that of the whole map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// The submap's number.
    pub submap: u32,
    /// Its colour, sRGB.
    pub colour: [u8; 3],
    /// Its pose: position and quaternion `[x, y, z, qx, qy, qz, qw]` of its frame in the map frame. The default is the map frame.
    pub pose: RootPose,
    /// Its pose before any correction, if known.
    pub first_pose: Option<RootPose>,
    /// Vertices, metres, submap frame. Those that are not finite are left out.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals, one per vertex.
    pub normals: Vec<[f32; 3]>,
    /// Intensity per vertex; empty when unknown.
    pub intensities: Vec<u8>,
    /// Colour of the scans per vertex, sRGB; empty when they have none.
    pub colours: Vec<[u8; 3]>,
    /// Integration scale per vertex, 0 to 3; empty when unknown.
    pub scales: Vec<u8>,
    /// Distance of each vertex from the truth, metres; empty when unknown.
    pub errors: Vec<f32>,
    /// By vertex, the submap that it moves with, which must be one of the report's; empty for the surface of one submap. The surface of the whole map is in the map
    /// frame, and its own `submap`, `colour` and poses are not used.
    pub carriers: Vec<u32>,
    /// Corners of the triangles.
    pub triangles: Vec<[u32; 3]>,
}

/// Position and quaternion of a submap's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct RootPose(pub [f64; 7]);

impl Default for RootPose {
    fn default() -> Self {
        Self([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    }
}

impl Surface {
    /// Checks the lengths of all arrays and the indices of the triangles.
    pub(crate) fn check(&self, surface: usize) -> Result<()> {
        let n = self.positions.len();
        let invalid = |what: String| Err(ReportError::Surface { surface, what });
        let may_be_empty = [
            ("intensities", self.intensities.len()),
            ("colours", self.colours.len()),
            ("scales", self.scales.len()),
            ("errors", self.errors.len()),
            ("carriers", self.carriers.len()),
        ];
        for (name, length) in may_be_empty.into_iter().filter(|(_, length)| *length > 0).chain([("normals", self.normals.len())]) {
            if length != n {
                return invalid(format!("{length} {name} for {n} vertices"));
            }
        }
        match self.triangles.iter().flatten().find(|&&v| v as usize >= n) {
            Some(v) => invalid(format!("a triangle refers to vertex {v}, but there are {n}")),
            None => Ok(()),
        }
    }
}
