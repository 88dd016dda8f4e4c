//! `voxelastic remove`: takes a session out of a map.

use crate::failure::{self, Failure};
use crate::output;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic_io::store::{MapWriter, SessionEntry};
use voxelastic_run::map_files;

/// Take a session out of a map
///
/// Its submaps go, with all that they observed; the other sessions stay as they are, bit for bit, because no session changes those before it. A later one that was
/// joined to it keeps its poses, which is said.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic info site.vox                   lists the sessions
  voxelastic remove site.vox --session 2")]
pub struct RemoveArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// Number of the session
    #[arg(long, value_name = "N")]
    session: u32,
    /// Print one JSON object on stdout: map, session, submaps_removed, scans_removed, sessions, joined_to_it, file_mb
    #[arg(long)]
    json: bool,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    map: &'a Path,
    session: u32,
    submaps_removed: usize,
    scans_removed: usize,
    /// Numbers of the sessions that are left.
    sessions: Vec<u32>,
    /// Those of them whose poses were corrected by loop edges to the one that was taken out.
    joined_to_it: Vec<u32>,
    /// Size of the map on disk, megabytes.
    file_mb: f64,
}

/// Runs the command.
pub fn run(args: &RemoveArgs) -> anyhow::Result<u8> {
    let map = &args.map;
    map_files::open(map)?;
    let mut writer = MapWriter::open(map)?;
    let manifest = writer.store().manifest();
    let all = manifest.all_sessions();
    if all.len() == 1 && all[0].number == args.session {
        let remedy = "remove the directory to be rid of it";
        return Err(Failure::new(format!("{}: session {} is all of the map", map.display(), args.session), remedy).into());
    }
    let session = all.iter().find(|session| session.number == args.session);
    let (mut submaps_removed, mut scans_removed, mut nodes) = (0, 0, Vec::new());
    for entry in manifest.submaps.iter().filter(|entry| session.is_some_and(|session| session.has(entry.id))) {
        submaps_removed += 1;
        scans_removed += entry.scans.len();
        nodes.extend(entry.scans.iter().map(|scan| scan.node));
    }
    nodes.sort_unstable();
    let hangs_on_it =
        |other: &&SessionEntry| other.number != args.session && other.loop_edges.iter().any(|edge| nodes.binary_search(&edge.from).is_ok());
    let joined_to_it: Vec<u32> = all.iter().filter(hangs_on_it).map(|other| other.number).collect();
    let saved = writer.remove_session(args.session).context("the map is as it was before")?;
    let summary = Summary {
        map,
        session: args.session,
        submaps_removed,
        scans_removed,
        sessions: writer.store().manifest().all_sessions().iter().map(|session| session.number).collect(),
        joined_to_it,
        file_mb: voxelastic_run::usage::megabytes(saved.bytes),
    };
    let (number, path) = (args.session, map.display());
    tracing::info!("session {number} is out of {path}: {scans_removed} scans in {submaps_removed} submaps");
    for other in &summary.joined_to_it {
        tracing::warn!("session {other} was joined to it and keeps the poses that it had: without session {number} it might lie elsewhere");
    }
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(failure::DONE)
}
