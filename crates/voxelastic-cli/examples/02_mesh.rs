//! From a map on disk to a mesh and a picture of it, with the library.
//!
//! ```sh
//! cargo run --release --example 02_mesh                      # room.vox, as example 01 makes it, to room.ply and room.png
//! cargo run --release --example 02_mesh -- map.vox out.ply
//! ```

use std::path::PathBuf;
use voxelastic::Pose;
use voxelastic::geometry::Rigid;
use voxelastic::settings::Settings;
use voxelastic::surface::{Mesh, MeshOptions, extract};
use voxelastic_eval::MeshView;
use voxelastic_eval::colour::palette;
use voxelastic_eval::render::{Camera, Colouring, Faces, MeshItem, Scene, Size, Style, render_png};
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_io::store::MapStore;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let (map, file) = match arguments.as_slice() {
        [] => (PathBuf::from("room.vox"), PathBuf::from("room.ply")),
        [map, file] => (map.clone(), file.clone()),
        _ => return Err("give no argument, or MAP.vox and MESH.ply".into()),
    };
    let store = MapStore::open(map)?;
    let mut settings = Settings::default();
    for (key, value) in &store.manifest().details.settings {
        settings.set(key, value)?;
    }

    // Each submap's mesh is in the submap's own frame: a pose correction moves it without making it again.
    let mut mesh = Mesh::default();
    let mut colours = Vec::new();
    for submap in store.load_atlas()?.submaps() {
        let part = extract(&submap.tsdf, settings.voxel, &MeshOptions::default());
        colours.resize(colours.len() + part.positions.len(), palette(submap.id as usize));
        mesh.append(&part, &Rigid::from(&submap.t_map_submap));
    }
    let Mesh { positions, normals, triangles, .. } = &mesh;
    write_ply(&file, &MeshRef { positions, normals, triangles, colours: Some(&colours), intensity: None })?;
    println!("{} vertices, {} triangles in {}", positions.len(), triangles.len(), file.display());

    // From above only what faces up is drawn, so that ceilings do not hide the rooms.
    let view = MeshView::new(positions, triangles)?.with_normals(normals)?;
    let item = MeshItem { mesh: view, t_map_mesh: Pose::identity(), colouring: Colouring::Vertex(&colours) };
    let scene = Scene { meshes: vec![item], style: Style { faces: Faces::Front, ..Style::default() }, ..Scene::default() };
    let picture = file.with_extension("png");
    render_png(&picture, &scene, &Camera::orbit(&scene.bounds(), 30.0, 50.0), Size { width: 1200, height: 900 })?;
    println!("picture in {}", picture.display());
    Ok(())
}
