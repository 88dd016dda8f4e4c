//! Export of the surface as 3D Tiles, with a page that streams them.

use super::args::ExportArgs;
use crate::meshing::{map_mesh, surface_tiles};
use crate::output;
use crate::progress::Progress;
use anyhow::Context;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic::atlas::Atlas;
use voxelastic::meshing::SurfaceTiles;
use voxelastic_io::tiles::TilesetWriter;
use voxelastic_run::export::tiles;
use voxelastic_run::map_files;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    folder: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    tiles: usize,
    levels: usize,
    triangles: usize,
    bytes: u64,
    files_kept: usize,
    seconds: f64,
}

/// Writes the folder.
pub fn run(args: &ExportArgs, quiet: bool) -> anyhow::Result<()> {
    let pool = args.surface.pool()?;
    let clock = Instant::now();
    let folder = &args.output;
    // Before anything is computed: a folder that has something else is refused.
    let writer = TilesetWriter::create(folder, f64::from(voxel_of(args)?)).context("cannot write tiles there")?;
    let mut map = pool.install(|| args.surface.load(&args.map, args.load))?;
    let voxel = map.settings.voxel_size;
    let mut writer = writer.with_origin(map.origin);
    if args.surface.options(args.layers).has_tiles(&map.atlas) {
        let atlas = std::mem::replace(&mut map.atlas, Atlas::new(voxel));
        pool.install(|| stream(surface_tiles(atlas, &args.surface)?, voxel, &mut writer, quiet))?;
    } else {
        pool.install(|| write_whole(args, &map.atlas, voxel, &mut writer, quiet))?;
    }
    let title = args.map.file_stem().map_or_else(|| "map".into(), |name| name.to_string_lossy());
    let report = tiles::finish(writer, folder, &title, map.place.as_ref()).context("cannot write the tiles")?;
    tracing::info!(
        "{} tiles in {} levels, {} triangles at full detail, {:.1} MB, in {}",
        report.tiles,
        report.levels,
        report.triangles,
        voxelastic_run::usage::megabytes(report.bytes),
        folder.display()
    );
    tracing::info!("to look at it: python3 -m http.server -d {} 8000, then open http://localhost:8000", folder.display());
    if args.json {
        output::print_json(&Summary {
            folder,
            submaps_damaged: map.damaged,
            tiles: report.tiles,
            levels: report.levels,
            triangles: report.triangles,
            bytes: report.bytes,
            files_kept: report.kept,
            seconds: clock.elapsed().as_secs_f64(),
        })?;
    }
    Ok(())
}

/// Writes a surface tile by tile.
fn stream(surface: SurfaceTiles<Atlas>, voxel: f32, writer: &mut TilesetWriter, quiet: bool) -> anyhow::Result<()> {
    let mut progress = Progress::new("tiles", None, quiet);
    let mut step = |done: u64, all: u64| progress.step(|| format!("{} % of the surface", 100 * done / all));
    tiles::stream(&surface, voxel, writer, &mut step).context("cannot write the tiles")
}

/// Writes a surface that is made as a whole.
fn write_whole(args: &ExportArgs, atlas: &Atlas, voxel: f32, writer: &mut TilesetWriter, quiet: bool) -> anyhow::Result<()> {
    let whole = map_mesh(atlas, &args.surface, args.layers)?;
    let mut progress = Progress::new("tiles", None, quiet);
    let mut step = |done: u64, all: u64| progress.step(|| format!("{done} of {all}"));
    tiles::write_whole(whole.mesh, voxel, writer, &mut step).context("cannot write the tiles")
}

fn voxel_of(args: &ExportArgs) -> anyhow::Result<f32> {
    let store = map_files::open(&args.map)?;
    Ok(map_files::settings_of(&store)?.voxel_size)
}
