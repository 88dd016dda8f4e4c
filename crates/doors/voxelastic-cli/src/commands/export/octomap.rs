//! Export of occupancy as an OctoMap.

use super::args::ExportArgs;
use crate::failure::Failure;
use crate::output;
use anyhow::Context;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic::atlas::{Atlas, Submap, SubmapScan};
use voxelastic::query::Resampling;
use voxelastic_io::octomap;
use voxelastic_run::map_files;

/// How far an OctoMap reaches from its centre, voxels.
const REACH: u32 = 1 << 15;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
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
    let query = map.atlas.query();
    if query.is_empty() {
        let remedy = "map the data again with --field occupancy or --field both";
        return Err(Failure::new(format!("{}: the map has no occupancy", args.map.display()), remedy).into());
    }
    // The setting as a decimal number: 0.065 and not its nearest single-precision number.
    let finest: f64 = map.settings.voxel_size.to_string().parse().unwrap_or_else(|_| query.voxel_size());
    let voxel = args.voxel_size.unwrap_or(finest);
    if voxel < 0.99 * finest {
        let message = format!("the finest voxel of the map is {finest} m, but --voxel-size is {voxel}");
        return Err(Failure::usage(message, "choose a larger --voxel-size, or map the data again with a smaller one").into());
    }
    refuse_if_far(&map.atlas, &args.map, voxel)?;
    let cubes = pool.install(|| query.resample(&Resampling { voxel, states_only }));
    if cubes.is_empty() {
        let what =
            format!("{}: nothing of the map is near enough to its origin for an OctoMap, which reaches {REACH} voxels from it", args.map.display());
        return Err(Failure::new(what, "map the data again, which gives the map an origin near its first pose, or use a larger --voxel-size").into());
    }
    if !map.origin.is_zero() {
        let why = format!("an OctoMap reaches {REACH} voxels from zero");
        tracing::warn!("{why}, so {} counts from the map's origin: add {} m to its coordinates", args.output.display(), map.origin);
    }
    let write = if states_only { octomap::write_bt } else { octomap::write_ot };
    let written = pool.install(|| write(&args.output, voxel, &cubes));
    written.context("cannot export the map")?;
    let occupied = cubes.iter().filter(|c| c.value > 0).count();
    tracing::info!("{} leaves of {voxel} m and larger, {occupied} occupied, in {}", cubes.len(), args.output.display());
    if args.json {
        let seconds = clock.elapsed().as_secs_f64();
        output::print_json(&Summary {
            file: &args.output,
            submaps_damaged: map.damaged,
            voxel_m: voxel,
            leaves: cubes.len(),
            occupied_leaves: occupied,
            seconds,
        })?;
    }
    Ok(())
}

/// Where scans were taken, something was observed: a map that reaches too far is refused before much is computed.
fn refuse_if_far(atlas: &Atlas, map: &Path, voxel: f64) -> anyhow::Result<()> {
    let distance = |submap: &Submap, scan: &SubmapScan| (submap.t_map_submap() * scan.t_submap_lidar).translation.vector.amax();
    let farthest = atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(move |scan| distance(submap, scan))).fold(0.0, f64::max);
    let least = farthest / f64::from(REACH);
    if least <= voxel {
        return Ok(());
    }
    let what = format!(
        "{}: scans were taken {farthest:.0} m from the origin along an axis, and an OctoMap of {voxel} m reaches {REACH} voxels",
        map.display()
    );
    Err(Failure::new(what, format!("use --voxel-size {:.2} or larger", (least * 100.0).ceil() / 100.0)).into())
}
