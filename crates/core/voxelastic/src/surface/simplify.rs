//! Levels of detail: vertices in the same cell of a grid are joined.
//!
//! The band of a TSDF is only wide enough for full detail, so marching cubes over larger voxels would leave holes. Joining vertices leaves none:
//! an edge shared by two triangles remains shared, or vanishes.

use super::marching_cubes::vertices::GREY;
use super::mesh::Mesh;
use crate::octree::SCALES;
use rayon::prelude::*;

/// Bits of a cell's coordinate along an axis: coordinates repeat after 2^21 cells.
const AXIS_BITS: u32 = 21;

/// The key of a vertex that stays alone is its number with this bit, which no key of a cell has.
const ALONE: u64 = 1 << 63;

/// Joins the vertices of `mesh` that share a cube of a grid with edges of `cell` metres, except those whose place in `stays` is true: they keep their
/// places, so that the border between two meshes that are simplified one by one has no cracks. Attributes of joined vertices are averaged; the grey of
/// unknown ones is ignored. Triangles whose corners are joined vanish.
pub fn simplify(mesh: &mut Mesh, cell: f32, stays: &[bool]) {
    join_cells(mesh, [0, 0], cell, |vertex| stays.get(vertex).copied().unwrap_or(false));
}

/// Joins the vertices of `mesh`, from vertex and triangle `first` on, that share a cell of 2^`lod` voxels of `voxel` metres; with level 0 none.
pub(crate) fn coarsen(mesh: &mut Mesh, first: [usize; 2], voxel: f32, lod: usize) {
    if lod > 0 {
        join_cells(mesh, first, voxel * (1u32 << lod.min(SCALES - 1)) as f32, |_| false);
    }
}

/// Joins the vertices from `first` on that share a cell of `cell` metres; those that `stays` names, counted from `first`, keep their places.
fn join_cells(mesh: &mut Mesh, first: [usize; 2], cell: f32, stays: impl Fn(usize) -> bool + Sync) {
    let cell_key = |p: &[f32; 3]| p.iter().fold(0u64, |key, c| key << AXIS_BITS | (c / cell).floor() as i64 as u64 & ((1 << AXIS_BITS) - 1));
    let key = |i: usize, p: &[f32; 3]| if stays(i) { ALONE | i as u64 } else { cell_key(p) };
    let mut members: Vec<(u64, u32)> = mesh.positions[first[0]..].par_iter().enumerate().map(|(i, p)| (key(i, p), i as u32)).collect();
    members.par_sort_unstable();
    let cells: Vec<&[(u64, u32)]> = members.chunk_by(|a, b| a.0 == b.0).collect();

    let mut joined = vec![0u32; members.len()];
    for (i, cell) in cells.iter().enumerate() {
        cell.iter().for_each(|&(_, vertex)| joined[vertex as usize] = (first[0] + i) as u32);
    }
    join(&mut mesh.positions, first[0], &cells, |all| mean(all));
    join(&mut mesh.normals, first[0], &cells, |all| mean(all));
    join(&mut mesh.intensities, first[0], &cells, |all| known_mean(all.map(|s| [s]))[0]);
    join(&mut mesh.colours, first[0], &cells, |all| known_mean(all));
    join(&mut mesh.scales, first[0], &cells, |all| all.min().unwrap_or(0));
    mesh.normalise_from(first[0]);

    let mut kept = first[1];
    for i in first[1]..mesh.triangles.len() {
        let [a, b, c] = mesh.triangles[i].map(|v| joined[v as usize - first[0]]);
        mesh.triangles[kept] = [a, b, c];
        kept += usize::from(a != b && b != c && c != a);
    }
    mesh.triangles.truncate(kept);
}

fn mean<const N: usize>(all: impl Iterator<Item = [f32; N]>) -> [f32; N] {
    let (sum, count) = all.fold(([0.0f64; N], 0u32), |(sum, count), v| (std::array::from_fn(|k| sum[k] + f64::from(v[k])), count + 1));
    sum.map(|s| (s / f64::from(count.max(1))) as f32)
}

/// The mean of the known values, grey if none is known.
fn known_mean<const N: usize>(all: impl Iterator<Item = [u8; N]>) -> [u8; N] {
    let mut known = all.filter(|value| *value != [GREY; N]).map(|value| value.map(f32::from)).peekable();
    if known.peek().is_none() { [GREY; N] } else { mean(known).map(|c| c.round() as u8) }
}

/// Replaces the values of each cell's vertices by one value, if there are values.
fn join<T: Copy + Send + Sync>(values: &mut Vec<T>, first: usize, cells: &[&[(u64, u32)]], of: impl Fn(&mut dyn Iterator<Item = T>) -> T + Sync) {
    if values.is_empty() {
        return;
    }
    let own = &values[first..];
    let joined: Vec<T> = cells.par_iter().with_min_len(1024).map(|cell| of(&mut cell.iter().map(|&(_, vertex)| own[vertex as usize]))).collect();
    values.truncate(first);
    values.extend(joined);
}
