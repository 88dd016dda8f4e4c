//! The mesh of a stored map as a PLY file.
//!
//! ```sh
//! cargo run --release -p voxelastic --example 04_mesh                 # room.vox, written by example 01, to room.ply
//! cargo run --release -p voxelastic --example 04_mesh -- map.vox out.ply
//! ```

use std::path::PathBuf;
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_io::store::MapStore;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let (map, file) = match arguments.as_slice() {
        [] => (PathBuf::from("room.vox"), PathBuf::from("room.ply")),
        [map, file] => (map.clone(), file.clone()),
        _ => return Err("usage: no arguments, or MAP.vox and MESH.ply".into()),
    };
    // One surface of all submaps, in the map frame. `submap.mesh` has that of a submap in its own frame, which a pose correction does not change.
    let mesh = MapStore::open(map)?.load_atlas()?.mesh(&MeshOptions::default());
    let Mesh { positions, normals, triangles, intensities, .. } = &mesh;
    let intensities: Vec<f32> = intensities.iter().map(|&i| i.into()).collect();
    let intensity = (!intensities.is_empty()).then_some(intensities.as_slice());
    write_ply(&file, &MeshRef { positions, normals, triangles, intensity, ..MeshRef::default() })?;
    println!("{} vertices, {} triangles in {}", positions.len(), triangles.len(), file.display());
    Ok(())
}
