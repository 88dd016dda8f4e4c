//! `voxelastic merge`: adds one saved map to another.

use crate::args::AlignArgs;
use crate::failure::{self, Failure};
use crate::output;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic_io::store::MapWriter;
use voxelastic_run::joining::{self, Outcome, SessionSummary, Sessions};
use voxelastic_run::map_files::{self, Loading};
use voxelastic_run::{Warnings, threads, usage};

/// Add a saved map to another one
///
/// The sessions of MORE become sessions of MAP: where they lie is found from surfaces that both have, and their poses are corrected to those of MAP, which keeps its own.
/// Neither scans nor poses files are needed. MAP is replaced when all is written, so an interruption leaves it as it was; MORE is not changed.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic merge tuesday.vox --into site.vox
  voxelastic merge hall.vox --into site.vox --align 12,-3,0,90   about where it lies
  voxelastic info site.vox                                       lists the sessions
  voxelastic remove site.vox --session 2                         takes one out again")]
pub struct MergeArgs {
    /// The map to add
    #[arg(value_name = "MORE.vox")]
    more: PathBuf,
    /// The map that it is added to
    #[arg(long, value_name = "MAP.vox")]
    into: PathBuf,
    #[command(flatten)]
    align: AlignArgs,
    /// Number of threads; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: map, session, submaps, scans, file_mb
    #[arg(long)]
    json: bool,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    map: &'a Path,
    session: &'a SessionSummary,
    /// Submaps and scans in the map now.
    submaps: usize,
    scans: usize,
    /// Size of the map on disk, megabytes.
    file_mb: f64,
}

/// Runs the command.
pub fn run(args: &MergeArgs) -> anyhow::Result<u8> {
    let (into, more) = (&args.into, &args.more);
    if into.canonicalize().ok().zip(more.canonicalize().ok()).is_some_and(|(a, b)| a == b) {
        return Err(Failure::usage(format!("{}: a map cannot be added to itself", into.display()), "name two maps").into());
    }
    map_files::open(into)?;
    let pool = threads::pool(args.threads)?;
    let mut writer = MapWriter::open(into)?;
    let settings = map_files::settings_of(writer.store())?;
    let entries = joining::listed_sessions(&map_files::open(more)?);
    let added = pool.install(|| map_files::load(more, Loading::AS_STORED))?;
    joining::check_settings(into, &settings, &added.settings, "map one of them again with the settings of the other")?;
    let sessions = Sessions { atlas: &added.atlas, origin: added.origin, entries, has_frame: true };
    let mut warnings = Warnings::default();
    let outcome = pool.install(|| joining::place(writer.store(), sessions, args.align.align, &mut warnings))?;
    let (addition, session) = match outcome {
        Outcome::Joined(addition, session) => (addition, session),
        Outcome::Apart(why) => {
            let remedy = format!("neither map was changed; --align says where in {} it lies, if that is known", into.display());
            return Err(Failure::new(format!("{} is not added: {why}", more.display()), remedy).into());
        }
    };
    let saved = pool.install(|| addition.save(&mut writer, &added.atlas)).context("cannot save the map; it is as it was before")?;
    joining::log(into, &session, &mut warnings);
    let manifest = writer.store().manifest();
    let summary = Summary {
        map: into,
        session: &session,
        submaps: manifest.submaps.len(),
        scans: manifest.submaps.iter().map(|entry| entry.scans.len()).sum(),
        file_mb: usage::megabytes(saved.bytes),
    };
    tracing::info!("saved {} ({:.1} MB): {} scans in {} submaps", into.display(), summary.file_mb, summary.scans, summary.submaps);
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(failure::DONE)
}
