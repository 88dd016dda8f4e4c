//! Export of the floor as 2-D maps.

use super::args::ExportArgs;
use crate::output;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic_io::raster::map_server::Mode;
use voxelastic_run::export::grid::{self, GridOptions, Written};
use voxelastic_run::map_files;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    file: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    #[serde(flatten)]
    written: Written,
    seconds: f64,
}

/// Writes the files.
pub fn run(args: &ExportArgs) -> anyhow::Result<()> {
    let pool = args.surface.pool()?;
    let clock = Instant::now();
    let mode = Mode::ALL.iter().find(|(name, _)| Some(*name) == args.ground.mode.as_deref()).map_or(Mode::default(), |(_, mode)| *mode);
    let options = GridOptions { resolution: args.ground.resolution, body: args.ground.robot.body(), mode };
    let map = pool.install(|| map_files::load(&args.map, args.load.into()))?;
    let written = pool.install(|| grid::write(&args.output, &map.atlas, map.origin, &args.map, &options))?;
    for storey in &written.storeys {
        let known = storey.free + storey.occupied;
        tracing::info!(
            "{}: floor at {:.2} m, {} free and {} occupied of {known} known cells",
            storey.file,
            storey.height_m,
            storey.free,
            storey.occupied
        );
    }
    for place in &written.connections {
        let [x, y, z] = place.at;
        tracing::info!(
            "storeys {} and {} connect at ({x:.1}, {y:.1}, {z:.1}), by steps of up to {:.2} m",
            place.storeys[0],
            place.storeys[1],
            place.step_m
        );
    }
    if args.json {
        output::print_json(&Summary { file: &args.output, submaps_damaged: map.damaged, written, seconds: clock.elapsed().as_secs_f64() })?;
    }
    Ok(())
}
