//! Colours of vertices: from the voxels on both sides of the surface, or from neighbouring vertices if these have none.

use crate::field::tsdf::{ColourVoxel, TsdfField};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, block_key};
use crate::surface::mesh::Mesh;
use rayon::prelude::*;

/// Number of edges over which colours spread into regions without coloured points, such as the gaps between two rows of a lidar.
const REACH: usize = 4;
/// Offsets along a vertex' normal at which voxels are sampled, in voxels of its scale.
const STEPS: [f32; 3] = [0.0, -0.6, 0.6];

/// A colour for each vertex of the field's mesh, for finest voxels of `voxel` metres; empty if the field has no colours. The field's mesh is the
/// end of `mesh`, from the `first` vertex and triangle on.
pub(crate) fn of_vertices(field: &TsdfField, voxel: f32, mesh: &Mesh, first: [usize; 2]) -> Vec<[u8; 3]> {
    if field.colours().is_empty() {
        return Vec::new();
    }
    let colour = |cursor: &mut Cursor, v: usize| {
        let scale = usize::from(mesh.scales[v]);
        let edge = (1 << scale) as f32;
        ColourVoxel::mean(STEPS.map(|step| {
            let at: [i32; 3] = std::array::from_fn(|k| (mesh.positions[v][k] / voxel + step * edge * mesh.normals[v][k]).floor() as i32);
            let id = cursor.block(field.tree(), block_key(at.map(|c| c >> BLOCK_SHIFT)));
            id.map_or(ColourVoxel::default(), |id| field.colours().voxel(id, at.map(|c| (c & (BLOCK_EDGE as i32 - 1)) as usize >> scale), scale))
        }))
    };
    let vertices = (first[0]..mesh.positions.len()).into_par_iter().with_min_len(1024);
    spread(vertices.map_init(|| Cursor::new(field.tree()), colour).collect(), &mesh.triangles[first[1]..], first[0] as u32)
}

/// A colour for each vertex: unknown colours become the mean of those in the same triangles, over up to [`REACH`] edges, otherwise mid grey.
/// Empty if no colour is known. Triangles number the vertices from `first` on.
fn spread(mut colours: Vec<ColourVoxel>, triangles: &[[u32; 3]], first: u32) -> Vec<[u8; 3]> {
    if !colours.iter().any(|t| t.is_known()) {
        return Vec::new();
    }
    for _ in 0..REACH {
        let mut found: Vec<(u32, ColourVoxel)> = Vec::new();
        for t in triangles.iter().map(|t| t.map(|v| v - first)) {
            for k in 0..3 {
                let neighbours = colours[t[(k + 1) % 3] as usize].with(colours[t[(k + 2) % 3] as usize]);
                if !colours[t[k] as usize].is_known() && neighbours.is_known() {
                    found.push((t[k], neighbours));
                }
            }
        }
        if found.is_empty() {
            break;
        }
        found.sort_by_key(|f| f.0);
        for neighbours in found.chunk_by(|a, b| a.0 == b.0) {
            // An estimate: weighs as one observation.
            colours[neighbours[0].0 as usize] = ColourVoxel { observations: 1, ..ColourVoxel::mean(neighbours.iter().map(|f| f.1)) };
        }
    }
    colours.into_iter().map(|t| if t.is_known() { t.rgb } else { [128; 3] }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_spread_into_gaps_and_no_farther() {
        // A strip of triangles: vertex i shares triangles with i - 2 to i + 2.
        let triangles: Vec<[u32; 3]> = (7..47).map(|i| [i, i + 1, i + 2]).collect();
        let mut known = vec![ColourVoxel::default(); 42];
        known[0] = ColourVoxel { rgb: [200, 0, 0], observations: 9 };
        known[12] = ColourVoxel::once([0, 0, 100]);
        let colours = spread(known.clone(), &triangles, 7);
        assert_eq!([colours[0], colours[5], colours[12], colours[13], colours[41]], [[200, 0, 0], [200, 0, 0], [0, 0, 100], [0, 0, 100], [128; 3]]);
        known.fill(ColourVoxel::default());
        assert!(spread(known, &triangles, 7).is_empty());
    }
}
