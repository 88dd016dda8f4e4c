//! Meshes of tiles: rounding to the lattice, joining those of eight tiles, and simplification that leaves the border of a tile alone.

use super::{Cell, STEPS_PER_VOXEL};
use std::collections::HashMap;
use voxelastic::surface::{Mesh, simplify};

/// A vertex on the border of two tiles is this near to the face between them, finest voxels: a triangle, which belongs to the tile of its centre, is
/// not larger.
const REACH: f64 = 16.0;

/// Rounds vertices to the lattice.
pub(super) fn snap(mesh: &mut Mesh, voxel: f64) {
    let step = voxel / STEPS_PER_VOXEL;
    mesh.positions.iter_mut().flatten().for_each(|c| *c = ((f64::from(*c) / step).round() * step) as f32);
}

/// Appends `other`, which shares vertices on its border with `mesh`; these become one. `numbers` has the vertices of `mesh` by their places.
pub(super) fn weld(mesh: &mut Mesh, numbers: &mut HashMap<[u32; 3], u32>, other: &Mesh) {
    let has_normals = other.normals.len() == other.positions.len();
    let mut new = Vec::with_capacity(other.positions.len());
    for (i, p) in other.positions.iter().enumerate() {
        // Zeros of both signs are one place.
        let number = *numbers.entry(p.map(|c| (c + 0.0).to_bits())).or_insert_with(|| {
            mesh.positions.push(*p);
            mesh.normals.push(if has_normals { other.normals[i] } else { [0.0, 0.0, 1.0] });
            if let Some(colour) = other.colours.get(i) {
                mesh.colours.push(*colour);
            }
            mesh.positions.len() as u32 - 1
        });
        new.push(number);
    }
    mesh.triangles.extend(other.triangles.iter().map(|t| t.map(|v| new[v as usize])).filter(|[a, b, c]| a != b && b != c && c != a));
}

/// Makes the mesh of a tile of `cell`'s level of that of the tiles below it.
pub(super) fn coarser(mesh: &mut Mesh, cell: Cell, voxel: f64) {
    let stays = border(mesh, cell, voxel);
    simplify(mesh, (voxel * f64::from(1u32 << cell.level)) as f32, &stays);
    snap(mesh, voxel);
}

/// Of each vertex, whether it may be shared with another tile: it is on an edge with a single triangle, near a face of the cell.
fn border(mesh: &Mesh, cell: Cell, voxel: f64) -> Vec<bool> {
    let edge = |a: u32, b: u32| u64::from(a.min(b)) << 32 | u64::from(a.max(b));
    let mut edges: Vec<u64> = mesh.triangles.iter().flat_map(|[a, b, c]| [edge(*a, *b), edge(*b, *c), edge(*c, *a)]).collect();
    edges.sort_unstable();
    let (low, high) = cell.bounds(voxel);
    let reach = REACH * voxel;
    let is_near = |v: u32| {
        (0..3).any(|k| f64::from(mesh.positions[v as usize][k]) < low[k] + reach || f64::from(mesh.positions[v as usize][k]) > high[k] - reach)
    };
    let mut border = vec![false; mesh.positions.len()];
    for single in edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1) {
        for v in [(single[0] >> 32) as u32, single[0] as u32] {
            border[v as usize] |= is_near(v);
        }
    }
    border
}
