//! The surfaces by which places of maps are compared.

use crate::{Error, Result};
use voxelastic::atlas::Atlas;
use voxelastic::geometry::Rigid;
use voxelastic::surface::{Mesh, MeshOptions, OccupancySurface, extract_occupancy, extract_onto};

/// The surfaces of all submaps on top of each other, in the map frame: of their TSDFs, or of occupied space where there are none.
///
/// # Errors
/// When there is none.
pub fn of_submaps(atlas: &Atlas) -> Result<Mesh> {
    let (mut mesh, voxel) = (Mesh::default(), atlas.voxel_size());
    for submap in atlas.submaps() {
        let t = Rigid::from(&submap.t_map_submap());
        if submap.tsdf().is_empty() {
            mesh.append(&extract_occupancy(submap.occupancy(), voxel, OccupancySurface::Occupied, 0), &t);
        } else {
            extract_onto(&mut mesh, submap.tsdf(), voxel, &MeshOptions::default(), Some(&t));
        }
    }
    if mesh.triangles.is_empty() {
        return Err(Error::new("the map has no surface", "map more scans: `voxelastic info` shows what is in a map"));
    }
    Ok(mesh)
}
