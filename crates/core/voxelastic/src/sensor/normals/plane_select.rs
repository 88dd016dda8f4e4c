//! Selection of the plane that each return lies on.

use super::plane_search::{ON_PLANE, PlaneSearch};
use crate::sensor::pixel_row::PixelRow;
use crate::sensor::range_image::RangeImage;
use crate::sensor::returns::Returns;
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// Returns of one task.
const CHUNK: usize = 4096;

/// Gives every return the plane of its pixel, or, where that is rejected or does not contain the return, the best fitting plane of the pixels around: at an edge
/// or a crease the windows of the neighbours on one side contain one surface only.
pub(super) fn select_planes(search: &PlaneSearch<'_>, image: &RangeImage, returns: &mut Returns) {
    let count = returns.points.len();
    returns.normals.resize(count, [0.0; 3]);
    returns.roughness.resize(count, 0.0);
    let (points, pixels, source) = (&returns.points, &returns.pixel, &returns.source);
    let chunks = returns.normals.par_chunks_mut(CHUNK).zip(returns.roughness.par_chunks_mut(CHUNK));
    chunks.with_max_len(1).enumerate().for_each(|(chunk, (normals, roughness))| {
        let first = chunk * CHUNK;
        let part = first..first + normals.len();
        let (points, pixels, source) = (&points[part.clone()], &pixels[part.clone()], &source[part]);
        dispatch(Select { search, image, points, pixels, source, normals, roughness });
    });
}

/// Selects the planes of some returns.
struct Select<'s, 'a> {
    search: &'s PlaneSearch<'a>,
    image: &'s RangeImage,
    points: &'s [[f32; 3]],
    pixels: &'s [u32],
    source: &'s [u32],
    normals: &'s mut [[f32; 3]],
    roughness: &'s mut [f32],
}

impl Kernel for Select<'_, '_> {
    #[inline(always)]
    fn run(self) {
        let Self { search, image, points, pixels, source, normals, roughness } = self;
        let mut row = PixelRow::new(search.grid.columns);
        for i in 0..normals.len() {
            let pixel = pixels[i] as usize;
            let at = row.place(pixel);
            let own = search.planes.at(at.0, at.1);
            let is_shown = image.points[pixel] == source[i];
            let plane = if is_shown && own.is_accepted() && own.misfit <= ON_PLANE { Some(own) } else { search.find(points[i], at) };
            (normals[i], roughness[i]) = plane.map_or(([0.0; 3], 0.0), |plane| (plane.normal, plane.roughness));
        }
    }
}
