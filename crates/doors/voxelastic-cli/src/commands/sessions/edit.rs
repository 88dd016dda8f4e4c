//! `voxelastic edit`: mends a map by hand.

use crate::commands::live::VIEWER;
use crate::failure::{self, Failure};
use crate::{interrupt, output};
use anyhow::Context;
use clap::{ArgGroup, Args};
use serde::Serialize;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use voxelastic_live::editor::EditPage;
use voxelastic_run::editing::{self, Done, Edit, Editor, ListedClosure};
use voxelastic_run::{map_files, threads};

/// Mend a map by hand: erase, pin, add and remove closures, merge, crop; all can be undone
///
/// Without a flag it serves a page on this machine, on which submaps are dragged, closures removed and added, and places erased; nothing is written before it is saved.
/// Edits are a list that is kept with the map (MAP.vox/edits.toml). Each is on the disk when it is done; a process that is killed loses at most the one in hand.
/// Undone, the map is what it was before, byte for byte. Commands that read maps see the edited one; those that write one refuse a map with edits,
/// so that none is lost: `--keep` makes the edits part of it.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("what"),
    after_help = "Examples:
  voxelastic edit hall.vox                      then open the address that it prints
  voxelastic edit hall.vox --apply edits.toml   does what a file says, one edit after the other
  voxelastic edit hall.vox --list               the edits, and the closures that could be removed
  voxelastic edit hall.vox --undo 2             takes the last two back
  voxelastic edit hall.vox --undo all           the map of before all edits
  voxelastic edit hall.vox --keep               makes them part of the map, for good"
)]
pub struct EditArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// Do the edits of this file: `[[edit]]` tables in TOML
    #[arg(long, value_name = "EDITS.toml", group = "what")]
    apply: Option<PathBuf>,
    /// List the edits of the map, and its closures, those that its poses contradict most first
    #[arg(long, group = "what")]
    list: bool,
    /// Take back the last N edits, or `all`
    #[arg(long, value_name = "N", value_parser = undo, group = "what")]
    undo: Option<Undo>,
    /// Make the edits part of the map: they cannot be undone then
    #[arg(long, group = "what")]
    keep: bool,
    /// Where to serve the page: an address of this machine and a port; port 0 is one that is free
    #[arg(long, value_name = "ADDRESS:PORT", default_value = VIEWER, conflicts_with = "what")]
    address: SocketAddr,
    /// Number of threads; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: map, edits, applied; with --list map, edits, closures
    #[arg(long, requires = "what")]
    json: bool,
}

/// How many edits are taken back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Undo {
    Last(usize),
    All,
}

fn undo(text: &str) -> Result<Undo, String> {
    match text {
        "all" => Ok(Undo::All),
        number => number.parse().map(Undo::Last).map_err(|_| "must be a number of edits, or `all`".to_owned()),
    }
}

/// The keys of `--json` of a change.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    map: &'a Path,
    /// Number of edits that the map has now.
    edits: usize,
    /// What was done, in order.
    applied: Vec<Done>,
}

/// The keys of `--list --json`.
#[derive(Debug, Serialize)]
struct Listing<'a> {
    #[serde(serialize_with = "crate::output::path")]
    map: &'a Path,
    edits: Vec<Row>,
    closures: Vec<ListedClosure>,
}

#[derive(Debug, Serialize)]
struct Row {
    number: usize,
    kind: &'static str,
    /// The edit as a list of edits has it.
    toml: String,
}

/// Runs the command.
pub fn run(args: &EditArgs) -> anyhow::Result<u8> {
    if args.list {
        return list(args);
    }
    let pool = threads::pool(args.threads)?;
    if args.apply.is_none() && args.undo.is_none() && !args.keep {
        let page = pool.install(|| EditPage::start(&args.map, args.address, 0))?;
        interrupt::install("closing the editor");
        match page.stay(&pool, interrupt::requested)? {
            0 => {}
            lost => tracing::warn!("{lost} edits were not saved"),
        }
        return Ok(failure::DONE);
    }
    let (edits, applied) = match (&args.apply, args.undo) {
        (Some(file), _) => pool.install(|| apply(&args.map, file))?,
        (None, Some(Undo::Last(count))) => {
            let editor = Editor::open(&args.map)?;
            (pool.install(|| editor.undo(count)).context("the map is as it was")?, Vec::new())
        }
        (None, Some(Undo::All)) => {
            editing::undo_all(&args.map)?;
            (0, Vec::new())
        }
        (None, None) => {
            editing::keep(&args.map)?;
            (0, Vec::new())
        }
    };
    let map = args.map.display();
    match (args.keep, edits) {
        (true, _) => tracing::info!("{map}: the edits are part of the map now"),
        (false, 0) => tracing::info!("{map} has no edits: it is what it was before them"),
        (false, count) => tracing::info!("{map} has {count} edits"),
    }
    if args.json {
        output::print_json(&Summary { map: &args.map, edits, applied })?;
    }
    Ok(failure::DONE)
}

/// Does the edits of a file. What was done before one that is refused stays.
fn apply(map: &Path, file: &Path) -> anyhow::Result<(usize, Vec<Done>)> {
    let is_in_map = file.canonicalize().ok().and_then(|file| file.parent().map(Path::to_owned)).zip(map.canonicalize().ok());
    if is_in_map.is_some_and(|(folder, map)| folder == map) {
        let message = format!("{}: the folder of the map is where its own list of edits is kept", file.display());
        return Err(Failure::usage(message, "copy the file elsewhere, and apply it from there").into());
    }
    let edits = editing::read(file)?;
    let mut editor = Editor::open(map)?;
    let mut applied = Vec::new();
    for (line, edit) in edits {
        let kind = edit.kind();
        let before = applied.len();
        let done = editor.apply(edit).with_context(|| {
            let done = if before == 0 {
                "nothing was changed".to_owned()
            } else {
                format!("the {before} before it are done; `--undo {before}` takes them back")
            };
            format!("{}, line {line}: edit {} ({kind}) is refused, {done}", file.display(), before + 1)
        })?;
        tracing::info!("{}: {}", editor.edits().len(), done.words());
        applied.push(done);
    }
    Ok((editor.edits().len(), applied))
}

/// Lists edits and closures. It takes no lock, so that it works while somebody edits the map.
fn list(args: &EditArgs) -> anyhow::Result<u8> {
    let store = map_files::open(&args.map)?;
    let edits = editing::edits(&store)?;
    let closures = editing::closures(&store)?;
    if args.json {
        let row = |(k, edit): (usize, &Edit)| Row { number: k + 1, kind: edit.kind(), toml: edit.to_text().trim().to_owned() };
        output::print_json(&Listing { map: &args.map, edits: edits.iter().enumerate().map(row).collect(), closures })?;
        return Ok(failure::DONE);
    }
    let mut text = format!("{} has {} edits and {} closures\n", args.map.display(), edits.len(), closures.len());
    for (k, edit) in edits.iter().enumerate() {
        text += &format!("\n# {}{}", k + 1, edit.to_text());
    }
    for closure in &closures {
        let [a, b] = closure.scans;
        text += &format!("\nclosure of scans {a} and {b}: {:.3} m off", closure.off_m);
    }
    output::print(&format!("{}\n", text.trim_end()))?;
    Ok(failure::DONE)
}
