//! Surfaces as clouds.

use rayon::prelude::*;
use std::path::Path;
use voxelastic::atlas::{Atlas, SubmapId};
use voxelastic::geometry::Rigid;
use voxelastic::surface::Mesh;
use voxelastic::{Cloud, Pose};
use voxelastic_earth::{EarthError, Georeference};
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_io::survey::{SurveyCloud, copc, e57, las};
use voxelastic_io::{Error, Origin, Result, pcd};

/// File formats of clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Binary, with normals.
    Ply,
    /// Binary, with normals.
    Pcd,
    /// LAS, or LAZ by the extension.
    Las,
    /// LAZ with an octree.
    Copc,
    /// One scan for each submap.
    E57,
}

impl Format {
    /// By the extension of a file.
    pub fn of(ending: &str) -> Option<Self> {
        match ending {
            "ply" => Some(Self::Ply),
            "pcd" => Some(Self::Pcd),
            "las" | "laz" => Some(Self::Las),
            "e57" => Some(Self::E57),
            _ => None,
        }
    }
}

/// Writes the vertices of a surface whose coordinates count from `origin`. As E57, they are one scan; see [`write_stations`].
///
/// LAS and COPC of a map with a place on Earth are in its coordinate system, of which they have the definition.
///
/// # Errors
/// When the file cannot be written, or the system does not reach the map.
pub fn write(path: &Path, format: Format, mesh: &Mesh, origin: Origin, place: Option<&Georeference>) -> Result<()> {
    let offset = origin.coordinates();
    match format {
        Format::Ply => write_cloud_ply(path, mesh, origin),
        Format::Pcd => pcd::write_with_normals(path, &cloud(mesh, 1.0), &mesh.normals, offset),
        Format::Las => las::write(path, &survey(path, mesh, origin, place)?),
        Format::Copc => copc::write(path, &survey(path, mesh, origin, place)?),
        Format::E57 => {
            let survey = SurveyCloud { cloud: cloud(mesh, 1.0 / 255.0), ..SurveyCloud::default() };
            e57::write(path, &[e57::E57Scan { name: None, t_map_scan: origin.to_map(Pose::identity()), survey }])
        }
    }
}

/// The vertices in the coordinate system of the map, if it has one.
fn survey(path: &Path, mesh: &Mesh, origin: Origin, place: Option<&Georeference>) -> Result<SurveyCloud> {
    let whole = SurveyCloud { offset: origin.coordinates(), cloud: cloud(mesh, 257.0), crs_wkt: None };
    let Some(place) = place else { return Ok(whole) };
    let fail = |e: EarthError| Error::Unwritable { path: path.to_owned(), problem: format!("{e}; {}", e.remedy()) };
    let projector = place.projector().map_err(fail)?;
    let moved = |p: &[f32; 3]| projector.point(origin.point_to_map(p.map(f64::from)));
    let points = mesh.positions.par_iter().map(moved).collect::<std::result::Result<Vec<[f64; 3]>, EarthError>>().map_err(fail)?;
    let offset = points.first().map_or([0.0; 3], |p| p.map(|c| (c / 100.0).round() * 100.0));
    let local = points.iter().map(|p| std::array::from_fn(|k| (p[k] - offset[k]) as f32)).collect();
    let crs_wkt = projector.crs().map(|crs| crs.wkt().to_owned());
    Ok(SurveyCloud { offset, cloud: Cloud { points: local, ..whole.cloud }, crs_wkt })
}

/// Writes the surfaces of submaps, in the map frame, as E57: a scan for each, in the submap's frame, with its pose.
///
/// # Errors
/// When the file cannot be written.
pub fn write_stations<'a>(path: &Path, atlas: &Atlas, origin: Origin, parts: impl Iterator<Item = (SubmapId, &'a Mesh)>) -> Result<()> {
    let station = |(id, part): (SubmapId, &Mesh)| {
        let t_local_scan = atlas.submap(id).map_or_else(Pose::identity, |submap| submap.t_map_submap());
        let mut local = Mesh::default();
        local.append(part, &Rigid::from(&t_local_scan.inverse()));
        let survey = SurveyCloud { cloud: cloud(&local, 1.0 / 255.0), ..SurveyCloud::default() };
        e57::E57Scan { name: Some(format!("submap {id}")), t_map_scan: origin.to_map(t_local_scan), survey }
    };
    e57::write(path, &parts.map(station).collect::<Vec<_>>())
}

fn write_cloud_ply(path: &Path, mesh: &Mesh, origin: Origin) -> Result<()> {
    let intensity: Option<Vec<f32>> = (!mesh.intensities.is_empty()).then(|| mesh.intensities.iter().map(|&s| f32::from(s)).collect());
    let colours = (!mesh.colours.is_empty()).then_some(&mesh.colours[..]);
    let (positions, normals, intensity) = (&mesh.positions, &mesh.normals, intensity.as_deref());
    write_ply(path, &MeshRef { positions, origin: origin.coordinates(), normals, colours, intensity, ..MeshRef::default() })
}

/// The vertices with their colours and intensities; intensities, 0 to 255, are multiplied by `scale`.
fn cloud(mesh: &Mesh, scale: f32) -> Cloud {
    let intensity = (!mesh.intensities.is_empty()).then(|| mesh.intensities.iter().map(|&s| f32::from(s) * scale).collect());
    let colours = (!mesh.colours.is_empty()).then(|| mesh.colours.clone());
    Cloud { intensity, colours, ..Cloud::from_points(mesh.positions.clone()) }
}
