//! `voxelastic repair`: makes a damaged map open again.

use crate::failure::{self, one_line};
use crate::output;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic_io::store::{ManifestState, repair};

/// Repair a damaged map: rebuild its manifest, take damaged submaps out
///
/// A manifest that is missing or damaged is made again from the submap files: each holds its scans, its settings and the pose that it had when it was
/// written. Submaps whose files are damaged or missing leave the map; damaged files are renamed to NAME.damaged. A map without damage is not changed.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic info hall.vox --check            is anything damaged?
  voxelastic repair hall.vox                  repair it
  voxelastic mesh hall.vox -o hall.ply --skip-damaged   use what is whole, without changing the map")]
pub struct RepairArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// Print one JSON object on stdout: map, manifest, submaps, scans, submaps_damaged, set_aside
    #[arg(long)]
    json: bool,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    map: &'a Path,
    /// `whole`, or `rebuilt` from the submap files.
    manifest: &'static str,
    /// Submaps and scans in the map now.
    submaps: usize,
    scans: usize,
    /// Submap files that are damaged or missing.
    submaps_damaged: usize,
    /// Damaged files that were renamed: their present paths.
    #[serde(serialize_with = "crate::output::paths")]
    set_aside: Vec<PathBuf>,
}

/// Runs the command.
pub fn run(args: &RepairArgs) -> anyhow::Result<u8> {
    let done = repair(&args.map)?;
    let (map, submaps, scans) = (args.map.display(), done.submaps, done.scans);
    let submaps_damaged = done.damage.len();
    done.damage.into_iter().for_each(|error| tracing::warn!("left the map: {}", one_line(&error.into())));
    done.set_aside.iter().for_each(|path| tracing::warn!("set aside: {}", path.display()));
    let manifest = match done.manifest {
        ManifestState::Whole => "whole",
        ManifestState::Rebuilt => "rebuilt",
    };
    if done.manifest == ManifestState::Rebuilt {
        tracing::warn!("{map}: the manifest was made again; corrections of poses since each submap file was written are not in it");
    }
    match (done.manifest, submaps_damaged) {
        (ManifestState::Whole, 0) => tracing::info!("{map} is not damaged: {submaps} submaps, {scans} scans"),
        _ => tracing::info!("{map} has {submaps} submaps with {scans} scans"),
    }
    if args.json {
        output::print_json(&Summary { map: &args.map, manifest, submaps, scans, submaps_damaged, set_aside: done.set_aside })?;
    }
    Ok(failure::DONE)
}
