//! A mesh in tiles of level 0.

use super::Cell;
use std::collections::{BTreeMap, HashMap};
use voxelastic::surface::Mesh;

/// The tiles of level 0 of a mesh in the map frame with finest voxels of `voxel` metres, in the order in which a writer takes them. A triangle belongs to
/// the tile that contains its centre. Triangles out of reach of the tiles' coordinates are left out.
pub fn split(mesh: &Mesh, voxel: f64) -> Vec<(Cell, Mesh)> {
    let mut members: BTreeMap<u64, (Cell, Vec<u32>)> = BTreeMap::new();
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let corners = triangle.map(|v| mesh.positions[v as usize]);
        let centre = std::array::from_fn(|k| corners.iter().map(|p| f64::from(p[k])).sum::<f64>() / 3.0);
        if let Some(cell) = Cell::containing(centre, voxel) {
            members.entry(cell.order()).or_insert_with(|| (cell, Vec::new())).1.push(i as u32);
        }
    }
    members.into_values().map(|(cell, triangles)| (cell, part(mesh, &triangles))).collect()
}

/// Some triangles of a mesh, with the vertices that they use.
fn part(mesh: &Mesh, triangles: &[u32]) -> Mesh {
    let mut part = Mesh::default();
    let mut numbers: HashMap<u32, u32> = HashMap::with_capacity(triangles.len());
    let mut vertices: Vec<usize> = Vec::with_capacity(triangles.len());
    for i in triangles {
        part.triangles.push(mesh.triangles[*i as usize].map(|v| {
            *numbers.entry(v).or_insert_with(|| {
                vertices.push(v as usize);
                vertices.len() as u32 - 1
            })
        }));
    }
    part.positions = vertices.iter().map(|v| mesh.positions[*v]).collect();
    part.normals = picked(&mesh.normals, &vertices);
    part.colours = picked(&mesh.colours, &vertices);
    part
}

/// The values of some vertices, if there are any.
fn picked<T: Copy>(values: &[T], vertices: &[usize]) -> Vec<T> {
    if values.is_empty() { Vec::new() } else { vertices.iter().map(|v| values[*v]).collect() }
}
