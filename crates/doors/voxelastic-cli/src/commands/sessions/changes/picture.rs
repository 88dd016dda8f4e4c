//! Changes seen from above.

use anyhow::Context;
use std::path::Path;
use voxelastic::changes::{ChangedPiece, Changes};
use voxelastic::surface::Mesh;
use voxelastic::{Pose, geometry::Aabb};
use voxelastic_eval::MeshView;
use voxelastic_eval::colour::Rgb;
use voxelastic_eval::render::{Camera, Colouring, Faces, MeshItem, Polyline, Scene, Size, Style, render_png};

const MAP: Rgb = [196, 198, 204];
const APPEARED: Rgb = [24, 150, 70];
const VANISHED: Rgb = [206, 44, 40];
const SIZE: Size = Size { width: 1600, height: 1200 };

/// Draws the newer map with what changed.
pub(super) fn draw(path: &Path, found: &Changes) -> anyhow::Result<()> {
    let (appeared, vanished) = (ChangedPiece::join(&found.appeared), ChangedPiece::join(&found.vanished));
    let mut scene = Scene::default();
    // Of surfaces at one place the first is seen: the map has what appeared, too.
    for (mesh, colour) in [(&appeared, APPEARED), (&vanished, VANISHED), (&found.surface, MAP)] {
        if !mesh.triangles.is_empty() {
            scene.meshes.push(item(mesh, colour)?);
        }
    }
    let outlined = [(&found.appeared, APPEARED), (&found.vanished, VANISHED)];
    scene.polylines = outlined.into_iter().flat_map(|(pieces, colour)| pieces.iter().map(move |piece| outline(piece, colour))).collect();
    let title = format!("green: {} appeared, red: {} vanished", found.appeared.len(), found.vanished.len());
    scene.style = Style { faces: Faces::Front, title, ..Style::default() };
    render_png(path, &scene, &Camera::top(&scene.bounds()), SIZE).with_context(|| format!("cannot draw {}", path.display()))
}

fn item(mesh: &Mesh, colour: Rgb) -> anyhow::Result<MeshItem<'_>> {
    let view = MeshView::new(&mesh.positions, &mesh.triangles)?.with_normals(&mesh.normals)?;
    Ok(MeshItem { mesh: view, t_map_mesh: Pose::identity(), colouring: Colouring::Flat(colour) })
}

/// The rectangle around a piece, so that small ones are found on a large map.
fn outline(piece: &ChangedPiece, colour: Rgb) -> Polyline {
    let Aabb { min, max } = piece.bounds;
    let corner = |x: f32, y: f32| [x, y, max[2]].map(f64::from);
    let points = vec![corner(min[0], min[1]), corner(max[0], min[1]), corner(max[0], max[1]), corner(min[0], max[1]), corner(min[0], min[1])];
    Polyline { points, colour, width: 2.0, on_top: true }
}
