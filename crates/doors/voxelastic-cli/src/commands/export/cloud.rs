//! Export of the surface as a cloud.

use super::args::ExportArgs;
use crate::meshing::{map_mesh, submap_meshes};
use crate::output;
use anyhow::Context;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic::atlas::SubmapId;
use voxelastic::geometry::Rigid;
use voxelastic::surface::Mesh;
use voxelastic::{Cloud, Pose};
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_io::survey::{SurveyCloud, copc, e57, las};
use voxelastic_io::{Origin, pcd};
use voxelastic_run::map_files::LoadedMap;
use voxelastic_run::surfaces::MapMesh;

/// File formats of clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Ply,
    Pcd,
    /// LAS, or LAZ by the extension.
    Las,
    /// LAZ with an octree.
    Copc,
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

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    file: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    points: usize,
    intensity: bool,
    colours: bool,
    seconds: f64,
}

/// Writes the file.
pub fn run(args: &ExportArgs, format: Format) -> anyhow::Result<()> {
    let pool = args.surface.pool()?;
    let clock = Instant::now();
    let map = pool.install(|| args.surface.load(&args.map, args.load))?;
    let mut parts = Vec::new();
    let all = if format == Format::E57 {
        parts = pool.install(|| submap_meshes(&map.atlas, &args.surface))?;
        let mut all = Mesh::default();
        parts.iter().for_each(|(_, part)| all.append(&part.mesh, &Rigid::from(&Pose::identity())));
        all
    } else {
        pool.install(|| map_mesh(&map.atlas, &args.surface, args.layers))?.mesh
    };
    match format {
        Format::Ply => write_cloud_ply(&args.output, &all, map.origin),
        Format::Pcd => pcd::write_with_normals(&args.output, &cloud(&all, 1.0), &all.normals, map.origin.coordinates()),
        Format::Las => las::write(&args.output, &SurveyCloud { offset: map.origin.coordinates(), cloud: cloud(&all, 257.0) }),
        Format::Copc => copc::write(&args.output, &SurveyCloud { offset: map.origin.coordinates(), cloud: cloud(&all, 257.0) }),
        Format::E57 => e57::write(&args.output, &stations(&map, &parts)),
    }
    .with_context(|| format!("cannot write the cloud {}", args.output.display()))?;
    let (points, intensity, colours) = (all.positions.len(), !all.intensities.is_empty(), !all.colours.is_empty());
    tracing::info!("{points} points in {}", args.output.display());
    if args.json {
        output::print_json(&Summary {
            file: &args.output,
            submaps_damaged: map.damaged,
            points,
            intensity,
            colours,
            seconds: clock.elapsed().as_secs_f64(),
        })?;
    }
    Ok(())
}

fn write_cloud_ply(path: &Path, mesh: &Mesh, origin: Origin) -> voxelastic_io::Result<()> {
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

/// A scan for each submap, in the submap's frame, with its pose in the map frame.
fn stations(map: &LoadedMap, parts: &[(SubmapId, MapMesh)]) -> Vec<e57::E57Scan> {
    let station = |(id, part): &(SubmapId, MapMesh)| {
        let t_local_scan = map.atlas.submap(*id).map_or_else(Pose::identity, |submap| submap.t_map_submap());
        let mut local = Mesh::default();
        local.append(&part.mesh, &Rigid::from(&t_local_scan.inverse()));
        let survey = SurveyCloud { cloud: cloud(&local, 1.0 / 255.0), ..SurveyCloud::default() };
        e57::E57Scan { name: Some(format!("submap {id}")), t_map_scan: map.origin.to_map(t_local_scan), survey }
    };
    parts.iter().map(station).collect()
}
