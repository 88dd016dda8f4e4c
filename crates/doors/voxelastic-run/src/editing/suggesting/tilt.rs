//! What is plumb in a map: walls say where up is, if there are enough of them, in two directions.

use super::suggestion::Suggestion;
use crate::editing::list::{Edit, Pin, Target, Up};
use nalgebra::{Matrix3, Vector3};
use voxelastic::Pose;
use voxelastic::atlas::SubmapId;
use voxelastic::surface::Mesh;
use voxelastic_io::Origin;

/// Surfaces that are steeper than this may be walls: the sine of the angle between their normals and the horizontal.
const STEEP: f64 = 0.26;
/// A wall that leans by this counts half, radians.
const LEANS: f64 = 0.02;
const ROUNDS: usize = 20;
/// Vertices of walls that are needed, and the share of them that has to be plumb within twice [`LEANS`].
const LEAST_VERTICES: usize = 2000;
const LEAST_PLUMB: f64 = 0.6;
/// Share of the walls across the others.
const LEAST_ACROSS: f64 = 0.08;
/// Tilts of a map, and of a submap in it, that are worth a word, radians.
const LEAST_OF_MAP: f64 = 0.0087;
const LEAST_OF_SUBMAP: f64 = 0.0175;

/// Which way is up by the walls of some surfaces.
fn up<'a>(surfaces: impl Iterator<Item = &'a Mesh> + Clone) -> Option<Vector3<f64>> {
    let normals = surfaces.flat_map(|mesh| &mesh.normals).map(|n| Vector3::from(n.map(f64::from))).filter(|n| n.z.abs() < STEEP);
    let mut up = Vector3::z();
    let mut across = 0.0;
    for _ in 0..ROUNDS {
        let (mut sum, mut weights) = (Matrix3::zeros(), 0.0);
        for n in normals.clone() {
            let weight = 1.0 / (1.0 + (n.dot(&up) / LEANS).powi(2));
            sum += weight * n * n.transpose();
            weights += weight;
        }
        let eigen = sum.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let found: Vector3<f64> = eigen.eigenvectors.column(order[0]).into();
        up = if found.z < 0.0 { -found } else { found };
        across = eigen.eigenvalues[order[1]] / f64::max(weights, 1.0);
    }
    let (count, plumb) = normals.fold((0, 0), |(count, plumb), n| (count + 1, plumb + usize::from(n.dot(&up).abs() < 2.0 * LEANS)));
    let is_known = count >= LEAST_VERTICES && plumb as f64 >= LEAST_PLUMB * count as f64 && across >= LEAST_ACROSS;
    is_known.then_some(up)
}

/// The map, or else submaps of it, that are tilted as far as their walls say, with the angles, radians.
pub fn tilted(surfaces: &[(SubmapId, Mesh)], poses: &[(SubmapId, Pose)], origin: Origin) -> Vec<(f64, Suggestion)> {
    let pose_of = |id: SubmapId| poses.iter().find(|(other, _)| *other == id).map(|(_, pose)| *pose);
    let suggestion = |id: SubmapId, up: Vector3<f64>, what: String, submaps: Vec<SubmapId>| {
        let angle = up.angle(&Vector3::z());
        // A millionth of a radian is more than anybody knows.
        let direction = <[f64; 3]>::from(up).map(|c| (c * 1e6).round() / 1e6);
        let edit = Edit::Pin { target: Target::Submap(id), pin: Pin { up: Some(Up::Direction(direction)), ..Pin::default() } };
        let at = pose_of(id).map_or([0.0; 3], |pose| pose.translation.vector.into());
        let text = format!("{what} {:.1} degrees from plumb, by the walls", angle.to_degrees());
        let (at, edit) = (origin.point_to_map(at), edit.to_text().trim().to_owned());
        (angle, Suggestion { code: "tilt", text, at, submaps, scans: Vec::new(), places_agree: None, edit })
    };
    let of_map = up(surfaces.iter().map(|(_, mesh)| mesh));
    if let (Some(up), Some((first, _))) = (of_map.filter(|up| up.angle(&Vector3::z()) >= LEAST_OF_MAP), poses.first()) {
        return vec![suggestion(*first, up, "the map leans".to_owned(), poses.iter().map(|(id, _)| *id).collect())];
    }
    let of_submap = |(id, mesh): &(SubmapId, Mesh)| {
        let up = up(std::iter::once(mesh)).filter(|up| up.angle(&Vector3::z()) >= LEAST_OF_SUBMAP)?;
        Some(suggestion(*id, up, format!("submap {id} leans"), vec![*id]))
    };
    let mut found: Vec<(f64, Suggestion)> = surfaces.iter().filter_map(of_submap).collect();
    found.sort_by(|(a, x), (b, y)| b.total_cmp(a).then(x.submaps.cmp(&y.submaps)));
    found
}
