//! The surface on the page: what is given, and what the page gets.

use crate::error::{ReportError, Result};
use crate::pack::{self, Chunk};
use crate::thin::thin;
use rayon::prelude::*;
use serde::Serialize;

/// Vertices on a page, at most: what a phone can turn, in about ten megabytes.
pub const MOST_VERTICES: usize = 1_200_000;

/// The surface of one submap.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// The submap's number.
    pub submap: u32,
    /// Its colour, sRGB.
    pub colour: [u8; 3],
    /// Where it lies: position and quaternion `[x, y, z, qx, qy, qz, qw]` of its frame in the map frame. The default is the map frame.
    pub pose: RootPose,
    /// Where it lay before any correction, if that is known.
    pub first_pose: Option<RootPose>,
    /// Vertices, metres, submap frame. Only finite ones count.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals, one per vertex.
    pub normals: Vec<[f32; 3]>,
    /// Strength of return per vertex; empty when unknown.
    pub shades: Vec<u8>,
    /// The scans' own colour per vertex, sRGB; empty when they had none.
    pub colours: Vec<[u8; 3]>,
    /// Integration scale per vertex, 0 to 3; empty when unknown.
    pub scales: Vec<u8>,
    /// Distance of each vertex from the truth, metres; empty when unknown.
    pub errors: Vec<f32>,
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
    /// Whether every array fits.
    fn check(&self, surface: usize) -> Result<()> {
        let n = self.positions.len();
        let wrong = |what: String| Err(ReportError::Surface { surface, what });
        let may_be_empty =
            [("shades", self.shades.len()), ("colours", self.colours.len()), ("scales", self.scales.len()), ("errors", self.errors.len())];
        for (name, length) in may_be_empty.into_iter().filter(|(_, length)| *length > 0).chain([("normals", self.normals.len())]) {
            if length != n {
                return wrong(format!("{length} {name} for {n} vertices"));
            }
        }
        match self.triangles.iter().flatten().find(|&&v| v as usize >= n) {
            Some(v) => wrong(format!("a triangle names vertex {v}, but there are {n}")),
            None => Ok(()),
        }
    }
}

/// What the page is told about a submap's surface; the numbers themselves are in the blob.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PackedSurface {
    submap: u32,
    colour: [u8; 3],
    pose: RootPose,
    first_pose: Option<RootPose>,
    /// Coordinates are `origin + step * u16`, metres of the submap frame.
    origin: [f32; 3],
    step: f32,
    has_shades: bool,
    has_colours: bool,
    has_errors: bool,
    chunks: Vec<Chunk>,
}

/// All surfaces, packed: descriptions, and one blob of bytes for the chunks in their order.
pub(crate) fn packed(surfaces: &[Surface], error_max: f32) -> Result<(Vec<PackedSurface>, Vec<u8>)> {
    surfaces.iter().enumerate().try_for_each(|(i, s)| s.check(i))?;
    let total: usize = surfaces.iter().map(|s| s.positions.len()).sum();
    let keep = (MOST_VERTICES as f64 / total.max(1) as f64).min(1.0);
    let each: Vec<(PackedSurface, Vec<u8>)> = surfaces.par_iter().map(|s| pack_one(s, keep, error_max)).collect();
    let mut blob = Vec::new();
    let descriptions = each.into_iter().map(|(description, bytes)| {
        blob.extend_from_slice(&bytes);
        description
    });
    Ok((descriptions.collect(), blob))
}

/// One surface, thinned to about the share `keep` of its vertices.
fn pack_one(surface: &Surface, keep: f64, error_max: f32) -> (PackedSurface, Vec<u8>) {
    let surface = thin(surface, keep);
    let (low, high) = surface.positions.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(low, high), p| {
        (std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k])))
    });
    let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
    // No finer than a tenth of a millimetre: a small map must not spend its bytes on noise.
    let step = (extent / 65535.0).max(1e-4);
    let origin = if surface.positions.is_empty() { [0.0; 3] } else { low };
    let mut bytes = Vec::new();
    let chunks = pack::chunks(&surface, origin, step, error_max, &mut bytes);
    let described = PackedSurface {
        submap: surface.submap,
        colour: surface.colour,
        pose: surface.pose,
        first_pose: surface.first_pose,
        origin,
        step,
        has_shades: !surface.shades.is_empty(),
        has_colours: !surface.colours.is_empty(),
        has_errors: !surface.errors.is_empty(),
        chunks,
    };
    (described, bytes)
}
