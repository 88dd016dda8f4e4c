//! Parallel processing of points along a Morton curve, with results in input order.

use rayon::prelude::*;
use voxelastic::geometry::morton;

/// Points per task; fixed, so that results do not depend on the number of threads.
const RUN: usize = 4096;

/// Applies `run` to runs of indices of neighbouring points. `run` must return one value per index; the result has one value per point, in input
/// order.
pub(crate) fn map_in_morton_order<F>(points: &[[f32; 3]], run: F) -> Vec<f32>
where
    F: Fn(&[u32]) -> Vec<f32> + Sync,
{
    let bounds = crate::mesh::bounds(points);
    let extent = bounds.size().into_iter().fold(1e-3f32, f32::max);
    let scale = 65535.0 / extent;
    let mut keyed: Vec<(u64, u32)> = points
        .par_iter()
        .enumerate()
        .map(|(i, p)| (morton::encode(std::array::from_fn(|k| ((p[k] - bounds.min[k]) * scale) as u32)), i as u32))
        .collect();
    keyed.par_sort_unstable();
    let indices: Vec<u32> = keyed.into_iter().map(|(_, i)| i).collect();
    let values: Vec<Vec<f32>> = indices.par_chunks(RUN).map(&run).collect();
    let mut out = vec![f32::NAN; points.len()];
    for (i, v) in indices.iter().zip(values.iter().flatten()) {
        out[*i as usize] = *v;
    }
    out
}
