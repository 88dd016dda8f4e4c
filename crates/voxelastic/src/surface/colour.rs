//! Colours of vertices: those of the voxels on either side of the surface, or of the vertices around where these have none.

use super::mesh::Mesh;
use crate::field::tsdf::{Tint, TsdfField};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, block_key};
use rayon::prelude::*;

/// How many vertices far colours reach into places that no coloured point fell into, such as the gaps between two rows of a lidar.
const REACH: usize = 4;
/// Where the voxels around a vertex are looked for along its normal, in voxels of its scale.
const STEPS: [f32; 3] = [0.0, -0.6, 0.6];

/// A colour for each vertex of the field's mesh, whose voxels are `voxel` metres; empty where the field has none. That mesh is the end of
/// `mesh`, from the `first` vertex and triangle on.
pub(super) fn of_vertices(field: &TsdfField, voxel: f32, mesh: &Mesh, first: [usize; 2]) -> Vec<[u8; 3]> {
    if field.colours().is_empty() {
        return Vec::new();
    }
    let tint = |cursor: &mut Cursor, v: usize| {
        let scale = usize::from(mesh.scales[v]);
        let edge = (1 << scale) as f32;
        Tint::mean(STEPS.map(|step| {
            let at: [i32; 3] = std::array::from_fn(|k| (mesh.positions[v][k] / voxel + step * edge * mesh.normals[v][k]).floor() as i32);
            let id = cursor.block(field.tree(), block_key(at.map(|c| c >> BLOCK_SHIFT)));
            id.map_or(Tint::default(), |id| field.colours().tint(id, at.map(|c| (c & (BLOCK_EDGE as i32 - 1)) as usize >> scale), scale))
        }))
    };
    let vertices = (first[0]..mesh.positions.len()).into_par_iter().with_min_len(1024);
    spread(vertices.map_init(|| Cursor::new(field.tree()), tint).collect(), &mesh.triangles[first[1]..], first[0] as u32)
}

/// A colour for each vertex: unknown ones take the mean of those that share a triangle with them, up to [`REACH`] vertices far, and beyond
/// that are mid grey. Empty where nothing is known at all. Triangles number the vertices from `first` on.
fn spread(mut tints: Vec<Tint>, triangles: &[[u32; 3]], first: u32) -> Vec<[u8; 3]> {
    if !tints.iter().any(|t| t.is_known()) {
        return Vec::new();
    }
    for _ in 0..REACH {
        let mut found: Vec<(u32, Tint)> = Vec::new();
        for t in triangles.iter().map(|t| t.map(|v| v - first)) {
            for k in 0..3 {
                let around = tints[t[(k + 1) % 3] as usize].with(tints[t[(k + 2) % 3] as usize]);
                if !tints[t[k] as usize].is_known() && around.is_known() {
                    found.push((t[k], around));
                }
            }
        }
        if found.is_empty() {
            break;
        }
        found.sort_by_key(|f| f.0);
        for around in found.chunk_by(|a, b| a.0 == b.0) {
            // However often its neighbours were seen, this is a guess.
            tints[around[0].0 as usize] = Tint { seen: 1, ..Tint::mean(around.iter().map(|f| f.1)) };
        }
    }
    tints.into_iter().map(|t| if t.is_known() { t.rgb } else { [128; 3] }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_spread_into_gaps_and_no_farther() {
        // A strip of triangles: vertex i shares triangles with i - 2 to i + 2.
        let triangles: Vec<[u32; 3]> = (7..47).map(|i| [i, i + 1, i + 2]).collect();
        let mut tints = vec![Tint::default(); 42];
        tints[0] = Tint { rgb: [200, 0, 0], seen: 9 };
        tints[12] = Tint::once([0, 0, 100]);
        let colours = spread(tints.clone(), &triangles, 7);
        assert_eq!([colours[0], colours[5], colours[12], colours[13], colours[41]], [[200, 0, 0], [200, 0, 0], [0, 0, 100], [0, 0, 100], [128; 3]]);
        tints.fill(Tint::default());
        assert!(spread(tints, &triangles, 7).is_empty());
    }
}
