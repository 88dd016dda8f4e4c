//! `voxelastic export`: a map for other people's software.

use crate::failure::{self, Failure};
use crate::{map_files, meshing, output};
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic::query::{AtlasQuery, Resampling};
use voxelastic_io::octomap;

/// Write the map's occupancy as an OctoMap
///
/// All submaps become one: a voxel is occupied if any submap says so, free if some submap says so and none occupied, and absent otherwise.
/// Where submaps are turned against the OctoMap's grid, no occupied voxel is lost.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic export hall.vox -o hall.bt                free and occupied, smallest
  voxelastic export hall.vox -o hall.ot --voxel 0.2    with log-odds, coarser")]
pub struct ExportArgs {
    /// The map, with occupancy
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// The file to write; its ending says the format: .bt (states) or .ot (log-odds)
    #[arg(short, long, value_name = "FILE.bt|.ot")]
    output: PathBuf,
    /// Edge of the OctoMap's voxels, metres [default: the map's finest voxel]
    #[arg(long, value_name = "M", value_parser = voxel)]
    voxel: Option<f64>,
    /// Threads to use; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: file, voxel_m, leaves, seconds
    #[arg(long)]
    json: bool,
}

fn voxel(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.005..=10.0).contains(v)).ok_or_else(|| "must be 0.005 to 10 metres".to_owned())
}

/// What was written.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    file: &'a Path,
    voxel_m: f64,
    leaves: usize,
    occupied_leaves: usize,
    seconds: f64,
}

/// Writes the file.
pub fn run(args: &ExportArgs) -> anyhow::Result<u8> {
    let states_only = match args.output.extension().map(|e| e.to_string_lossy().to_lowercase()).as_deref() {
        Some("bt") => true,
        Some("ot") => false,
        _ => return Err(Failure::usage(format!("{}: no format of that name", args.output.display()), "end the name with .bt or .ot").into()),
    };
    let pool = meshing::pool(args.threads)?;
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
    Ok(failure::DONE)
}
