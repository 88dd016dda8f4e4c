//! Export of occupancy as an OctoMap.

use super::args::ExportArgs;
use crate::output;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic_run::export::octomap::{self, Occupancy, REACH, Written};
use voxelastic_run::map_files;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    file: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    voxel_m: f64,
    leaves: usize,
    occupied_leaves: usize,
    seconds: f64,
}

/// Writes the file: states only (.bt), or log-odds (.ot).
pub fn run(args: &ExportArgs, states_only: bool) -> anyhow::Result<()> {
    let pool = args.surface.pool()?;
    let clock = Instant::now();
    let map = pool.install(|| map_files::load(&args.map, args.load.into()))?;
    let written = pool.install(|| octomap::write(&args.output, &Occupancy::of(&map, &args.map, args.voxel_size, states_only)));
    let Written { voxel, leaves, occupied_leaves } = written?;
    if !map.origin.is_zero() {
        let why = format!("an OctoMap reaches {REACH} voxels from zero");
        tracing::warn!("{why}, so {} counts from the map's origin: add {} m to its coordinates", args.output.display(), map.origin);
    }
    tracing::info!("{leaves} leaves of {voxel} m and larger, {occupied_leaves} occupied, in {}", args.output.display());
    if args.json {
        let seconds = clock.elapsed().as_secs_f64();
        output::print_json(&Summary { file: &args.output, submaps_damaged: map.damaged, voxel_m: voxel, leaves, occupied_leaves, seconds })?;
    }
    Ok(())
}
