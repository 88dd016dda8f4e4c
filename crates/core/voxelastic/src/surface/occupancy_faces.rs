//! Surfaces of an occupancy field: of occupied space, of free space, of the frontier to unknown space.
//!
//! Faces of voxels at their stored size; neighbours in a plane of a block are merged to rectangles. All corners lie on the grid of finest
//! voxels, so that faces of different sizes meet along exactly the same lines.

use super::Mesh;
use super::simplify::coarsen;
use crate::field::occupancy::{Boundary, Face, OccupancyField, faces};
use hashbrown::HashMap;

/// A kind of surface of an occupancy field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OccupancySurface {
    /// Boundary of occupied voxels to all other space.
    Occupied,
    /// Closed boundary of free space, facing inwards.
    FreeHull,
    /// The part of that boundary that adjoins unknown space.
    Frontier,
}

/// The surface in metres of the submap frame, for finest voxels of `voxel` metres. Triangles and normals face away from
/// occupied or unknown space; vertices are shared within faces of one direction, so that edges stay sharp. With a level of detail `lod` of 1 to 3,
/// all vertices in a cell of two to eight finest voxels are joined, as in
/// [`MeshOptions::lod`](crate::surface::MeshOptions::lod): edges are rounded, and gaps of less than a cell may open between faces of different sizes.
pub fn extract_occupancy(field: &OccupancyField, voxel: f32, surface: OccupancySurface, lod: usize) -> Mesh {
    let boundary = match surface {
        OccupancySurface::Occupied => Boundary::Occupied,
        OccupancySurface::FreeHull => Boundary::Free,
        OccupancySurface::Frontier => Boundary::Frontier,
    };
    let mut builder = Builder { voxel, mesh: Mesh::default(), vertices: HashMap::new() };
    faces(field, boundary, true).iter().for_each(|face| builder.add(face));
    coarsen(&mut builder.mesh, [0, 0], voxel, lod);
    builder.mesh
}

struct Builder {
    voxel: f32,
    mesh: Mesh,
    /// Vertices by corner (finest voxels), direction and scale.
    vertices: HashMap<([i32; 3], u8, u8), u32>,
}

impl Builder {
    fn add(&mut self, face: &Face) {
        let corner = |along: i32, across: i32| {
            let mut c = face.low;
            c[(face.axis + 1) % 3] += along;
            c[(face.axis + 2) % 3] += across;
            c
        };
        let [wide, tall] = face.span;
        let [a, b, c, d] = [corner(0, 0), corner(wide, 0), corner(wide, tall), corner(0, tall)].map(|c| self.vertex(c, face));
        // Counter-clockwise around the axis.
        let triangles = if face.positive { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
        self.mesh.triangles.extend(triangles);
    }

    fn vertex(&mut self, corner: [i32; 3], face: &Face) -> u32 {
        let Self { voxel, mesh, vertices } = self;
        let direction = 2 * face.axis as u8 + u8::from(face.positive);
        *vertices.entry((corner, direction, face.scale)).or_insert_with(|| {
            let mut normal = [0.0; 3];
            normal[face.axis] = if face.positive { 1.0 } else { -1.0 };
            mesh.positions.push(corner.map(|c| c as f32 * *voxel));
            mesh.normals.push(normal);
            mesh.scales.push(face.scale);
            mesh.positions.len() as u32 - 1
        })
    }
}
