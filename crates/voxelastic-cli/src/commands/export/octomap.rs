//! Occupancy as OctoMap files.

use super::ExportArgs;
use crate::failure::Failure;
use crate::{map_files, output};
use anyhow::Context;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic::query::{AtlasQuery, Resampling};
use voxelastic_io::octomap;

/// What was written.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    file: &'a Path,
    voxel_m: f64,
    leaves: usize,
    occupied_leaves: usize,
    seconds: f64,
}

/// Writes the file: states only (.bt), or log-odds (.ot).
pub fn run(args: &ExportArgs, states_only: bool) -> anyhow::Result<()> {
    let pool = args.surface.pool()?;
    let clock = Instant::now();
    let map = pool.install(|| map_files::load(&args.map))?;
    let query = AtlasQuery::new(&map.atlas, map.settings.voxel);
    if query.is_empty() {
        let remedy = "map the data again with --field occupancy or --field both";
        return Err(Failure::new(format!("{}: the map has no occupancy", args.map.display()), remedy).into());
    }
    // The setting as it was written: 0.065 and not its nearest single-precision number.
    let finest: f64 = map.settings.voxel.to_string().parse().unwrap_or_else(|_| query.voxel());
    let voxel = args.voxel.unwrap_or(finest);
    if voxel < 0.99 * finest {
        let message = format!("the map knows nothing finer than {finest} m, but --voxel is {voxel}");
        return Err(Failure::usage(message, "choose a larger --voxel, or map the data again with a smaller one").into());
    }
    let cubes = pool.install(|| query.resample(&Resampling { voxel, states_only }));
    let written = if states_only { octomap::write_bt(&args.output, voxel, &cubes) } else { octomap::write_ot(&args.output, voxel, &cubes) };
    written.context("cannot export the map")?;
    let occupied = cubes.iter().filter(|c| c.value > 0).count();
    tracing::info!("{} leaves of {voxel} m and larger, {occupied} occupied, in {}", cubes.len(), args.output.display());
    if args.json {
        let seconds = clock.elapsed().as_secs_f64();
        output::print_json(&Summary { file: &args.output, voxel_m: voxel, leaves: cubes.len(), occupied_leaves: occupied, seconds })?;
    }
    Ok(())
}
