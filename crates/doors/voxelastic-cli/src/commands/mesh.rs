//! `voxelastic mesh`: extracts the surface of a map as a triangle mesh.

use crate::args::LoadArgs;
use crate::args::images::ImageArgs;
use crate::failure::Failure;
use crate::meshing::{Colour, Fused, LayerArgs, LeftOut, SurfaceArgs, colours, default_colour, map_mesh, submap_meshes};
use crate::{failure, output};
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic_io::Origin;
use voxelastic_io::mesh_io::{self, Format, MeshRef, write_textured_glb};
use voxelastic_run::painting::{MeshTexture, PaintSummary};
use voxelastic_run::surfaces::MapMesh;

/// Extract the surface of a map as a triangle mesh
///
/// Overlapping submaps are fused into one surface. The mesh is in the map frame, in metres, without cracks between resolutions, with shared vertices, a normal per vertex and, if the scans
/// have it, intensity. Triangles face free space.
///
/// With --images, vertices get the colours that cameras saw. Poses of the images are those of the map, so after corrections colours are where they
/// belong. What a surface hides from a camera is not coloured by it, and exposures are evened out.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic mesh hall.vox -o hall.ply
  voxelastic mesh hall.vox -o hall.glb --colour intensity     for viewers in a browser
  voxelastic mesh hall.vox -o coarse.ply --lod 2              a sixteenth of the triangles
  voxelastic mesh hall.vox -o clean.ply --min-weight 3        only surface observed three times or more
  voxelastic mesh hall.vox -o all.ply --keep-all              with small components that few rays saw
  voxelastic mesh hall.vox -o parts.ply --separate            parts-000000.ply, parts-000001.ply, ..
  voxelastic mesh hall.vox -o unfused.ply --unfused --colour submap
  voxelastic mesh hall.vox -o hall.glb --images hall/images   coloured by a camera: hall/images/cameras.toml describes it
  voxelastic mesh hall.vox -o hall.glb --images hall.mcap     by the images in a recording
  voxelastic mesh hall.vox -o hall.glb --images hall/images --texture 0.01     as sharp as a texel a centimetre allows")]
pub struct MeshArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    #[command(flatten)]
    load: LoadArgs,
    /// The mesh to write; the extension selects the format: .ply (binary) or .glb
    #[arg(short, long, value_name = "FILE.ply|.glb")]
    output: PathBuf,
    /// Colouring of the vertices [default: the colours of the scans if they have any, else height]
    #[arg(long, value_enum)]
    colour: Option<Colour>,
    /// Write one file per submap instead of one for the map
    #[arg(long, conflicts_with = "unfused")]
    separate: bool,
    /// Print one JSON object on stdout: files, vertices, triangles, what was fused, seconds, ..
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    layers: LayerArgs,
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    images: ImageArgs,
}
/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    #[serde(serialize_with = "crate::output::paths")]
    files: Vec<PathBuf>,
    vertices: usize,
    triangles: usize,
    submaps: usize,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    /// Null unless submaps were fused.
    fused: Option<Fused>,
    /// Null with `--keep-all`, and for unfused surfaces, single submaps and surfaces of occupancy.
    left_out: Option<LeftOut>,
    /// Null without `--images`.
    images: Option<PaintSummary>,
    load_s: f64,
    extract_s: f64,
    write_s: f64,
}

/// Runs the command.
pub fn run(args: &MeshArgs) -> anyhow::Result<u8> {
    let format = Format::of(&args.output).map_err(|problem| Failure::usage(problem.to_string(), ""))?;
    let painting = args.images.painting();
    if painting.is_some() && (args.separate || args.colour.is_some()) {
        let remedy = "leave out --separate and --colour: one submap may hide another, and images give the colours";
        return Err(Failure::usage("--images colours the surface of the whole map", remedy).into());
    }
    if painting.as_ref().is_some_and(|painting| painting.texel.is_some()) && !matches!(format, Format::Glb) {
        return Err(Failure::usage("PLY files have no textures", "use the extension .glb, or leave out --texture").into());
    }
    let pool = args.surface.pool()?;
    let clock = Instant::now();
    let map = pool.install(|| args.surface.load(&args.map, args.load))?;
    let load_s = clock.elapsed().as_secs_f64();
    let clock = Instant::now();
    let (mut meshes, submaps) = pool.install(|| -> anyhow::Result<(Vec<(PathBuf, MapMesh)>, usize)> {
        if args.separate {
            let parts = submap_meshes(&map.atlas, &args.surface)?;
            let submaps = parts.len();
            Ok((parts.into_iter().map(|(id, mesh)| (numbered(&args.output, id), mesh)).collect(), submaps))
        } else {
            Ok((vec![(args.output.clone(), map_mesh(&map.atlas, &args.surface, args.layers)?)], map.atlas.submaps().len()))
        }
    })?;
    let fused = meshes.first().and_then(|(_, mesh)| Fused::of(mesh, map.settings.voxel_size));
    let left_out = meshes.first().and_then(|(_, mesh)| LeftOut::of(mesh));
    let extract_s = clock.elapsed().as_secs_f64();
    let (painted, texture) = match (painting, meshes.first_mut()) {
        (Some(painting), Some((_, mesh))) => {
            let (summary, texture) = pool.install(|| painting.paint(&map, &args.map, &mut mesh.mesh))?;
            (Some(summary), texture)
        }
        _ => (None, None),
    };
    let clock = Instant::now();
    for (path, mesh) in &meshes {
        write(path, mesh, map.origin, args.colour, texture.as_ref())?;
    }
    let summary = Summary {
        vertices: meshes.iter().map(|(_, m)| m.mesh.positions.len()).sum(),
        triangles: meshes.iter().map(|(_, m)| m.mesh.triangles.len()).sum(),
        files: meshes.into_iter().map(|(path, _)| path).collect(),
        submaps,
        submaps_damaged: map.damaged,
        fused,
        left_out,
        images: painted,
        load_s,
        extract_s,
        write_s: clock.elapsed().as_secs_f64(),
    };
    let Summary { vertices, triangles, .. } = summary;
    tracing::info!("{vertices} vertices, {triangles} triangles in {}", list(&summary.files));
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(failure::DONE)
}

fn list(files: &[PathBuf]) -> String {
    match files {
        [one] => one.display().to_string(),
        many => format!("{} files", many.len()),
    }
}

/// The file of a submap: `parts-000007.ply` for `parts.ply` and 7.
fn numbered(path: &Path, id: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{id:06}.{ending}"))
}

fn write(path: &Path, mesh: &MapMesh, origin: Origin, colour: Option<Colour>, texture: Option<&MeshTexture>) -> anyhow::Result<()> {
    let colours = colours(mesh, colour.unwrap_or_else(|| default_colour(mesh)))?;
    let intensity: Vec<f32> = mesh.mesh.intensities.iter().map(|&s| f32::from(s)).collect();
    let file = MeshRef {
        positions: &mesh.mesh.positions,
        origin: origin.coordinates(),
        normals: &mesh.mesh.normals,
        colours: colours.as_deref(),
        intensity: (!intensity.is_empty()).then_some(&intensity),
        triangles: &mesh.mesh.triangles,
    };
    match texture {
        None => mesh_io::write(path, &file),
        Some(texture) => write_textured_glb(path, &file, &texture.images),
    }
    .with_context(|| format!("cannot write the mesh {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_submaps_are_numbered() {
        assert_eq!(numbered(Path::new("out/parts.v2.ply"), 7), Path::new("out/parts.v2-000007.ply"));
    }
}
