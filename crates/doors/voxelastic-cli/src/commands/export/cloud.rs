//! Export of the surface as a cloud.

use super::args::ExportArgs;
use crate::meshing::{map_mesh, submap_meshes};
use crate::output;
use anyhow::Context;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::geometry::Rigid;
use voxelastic::surface::Mesh;
use voxelastic_run::export::cloud::{self, Format};

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    file: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    points: usize,
    intensity: bool,
    colours: bool,
    /// The coordinate system of the file; null for the map frame, or the plane of a map on Earth.
    crs: Option<String>,
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
    if format == Format::E57 {
        cloud::write_stations(&args.output, &map.atlas, map.origin, parts.iter().map(|(id, part)| (*id, &part.mesh)))
    } else {
        cloud::write(&args.output, format, &all, map.origin, map.place.as_ref())
    }
    .with_context(|| format!("cannot write the cloud {}", args.output.display()))?;
    let crs = map.place.filter(|_| matches!(format, Format::Las | Format::Copc)).and_then(|place| place.crs).map(|code| format!("EPSG:{code}"));
    let (points, intensity, colours) = (all.positions.len(), !all.intensities.is_empty(), !all.colours.is_empty());
    let system = crs.as_ref().map_or_else(String::new, |crs| format!(", in {crs}"));
    tracing::info!("{points} points in {}{system}", args.output.display());
    if args.json {
        output::print_json(&Summary {
            file: &args.output,
            submaps_damaged: map.damaged,
            points,
            intensity,
            colours,
            crs,
            seconds: clock.elapsed().as_secs_f64(),
        })?;
    }
    Ok(())
}
