//! Surfaces reduced and packed for a page.

use crate::decimate::decimate;
use crate::error::Result;
use crate::pack::{self, Chunk};
use crate::split::split;
use crate::surface::{RootPose, Surface};
use rayon::prelude::*;
use serde::Serialize;

/// Most vertices of a page: about ten megabytes, which a phone can rotate.
pub const MAX_VERTICES: usize = 1_200_000;

/// Description of a submap's surface for the page; the vertices and triangles are in the blob.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PackedSurface {
    submap: u32,
    colour: [u8; 3],
    pose: RootPose,
    first_pose: Option<RootPose>,
    /// Coordinates are `origin + step * u16`, metres of the submap frame.
    origin: [f32; 3],
    step: f32,
    has_intensities: bool,
    has_colours: bool,
    has_errors: bool,
    chunks: Vec<Chunk>,
}

/// Packs all surfaces: descriptions, and one blob with the chunks in order.
pub(crate) fn packed(surfaces: &[Surface], error_max: f32) -> Result<(Vec<PackedSurface>, Vec<u8>)> {
    surfaces.iter().enumerate().try_for_each(|(i, s)| s.check(i))?;
    let total: usize = surfaces.iter().map(|s| s.positions.len()).sum();
    let keep = (MAX_VERTICES as f64 / total.max(1) as f64).min(1.0);
    let mut reduced: Vec<Surface> = surfaces.par_iter().map(|s| decimate(s, keep)).collect();
    // That of the whole map is reduced before it is split, so that its parts fit together.
    if let Some(whole) = reduced.iter().position(|s| !s.carriers.is_empty()) {
        let whole = reduced.remove(whole);
        reduced = split(&whole, &reduced);
    }
    let each: Vec<(PackedSurface, Vec<u8>)> = reduced.par_iter().map(|s| pack_one(s, error_max)).collect();
    let mut blob = Vec::new();
    let descriptions = each.into_iter().map(|(description, bytes)| {
        blob.extend_from_slice(&bytes);
        description
    });
    Ok((descriptions.collect(), blob))
}

/// A surface as bytes; the layout is that of the private module `pack`, which [`scripts::UNPACK`](crate::scripts::UNPACK) reads.
#[derive(Clone, Debug)]
pub struct PackedBytes {
    /// Coordinates are `origin + step * u16`, metres of the surface's frame.
    pub origin: [f32; 3],
    /// Edge of the grid of coordinates, metres.
    pub step: f32,
    /// Sizes of the chunks.
    pub chunks: Vec<Chunk>,
    /// The chunks.
    pub bytes: Vec<u8>,
}

/// Packs a surface whose vertices and arrays are as they are: nothing is checked or reduced. Its coordinates are on a grid that reaches from the lowest
/// to the highest, in steps of at least a tenth of a millimetre.
pub fn pack_surface(surface: &Surface) -> PackedBytes {
    let (origin, step) = grid_of(surface);
    let mut bytes = Vec::new();
    let chunks = pack::chunks(surface, origin, step, 1.0, &mut bytes);
    PackedBytes { origin, step, chunks, bytes }
}

/// Origin and step of the grid of a surface's coordinates.
fn grid_of(surface: &Surface) -> ([f32; 3], f32) {
    let (low, high) = surface.positions.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(low, high), p| {
        (std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k])))
    });
    let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
    // At least a tenth of a millimetre: a finer step would store noise.
    (if surface.positions.is_empty() { [0.0; 3] } else { low }, (extent / 65535.0).max(1e-4))
}

fn pack_one(surface: &Surface, error_max: f32) -> (PackedSurface, Vec<u8>) {
    let (origin, step) = grid_of(surface);
    let mut bytes = Vec::new();
    let chunks = pack::chunks(surface, origin, step, error_max, &mut bytes);
    let described = PackedSurface {
        submap: surface.submap,
        colour: surface.colour,
        pose: surface.pose,
        first_pose: surface.first_pose,
        origin,
        step,
        has_intensities: !surface.intensities.is_empty(),
        has_colours: !surface.colours.is_empty(),
        has_errors: !surface.errors.is_empty(),
        chunks,
    };
    (described, bytes)
}
