//! `voxelastic plan`: plans a path for a robot through a map.

mod args;
mod picture;
mod recheck;

pub use args::PlanArgs;

use crate::{failure, output};
use anyhow::Context;
use args::explain;
use serde::Serialize;
use std::io::Write;
use std::path::Path;
use voxelastic::query::AtlasQuery;
use voxelastic_plan::{plan, sharpest_turn};
use voxelastic_run::export::path;
use voxelastic_run::map_files;
use voxelastic_run::threads;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    output: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(serialize_with = "crate::output::optional_path")]
    picture: Option<&'a Path>,
    #[serde(flatten)]
    figures: &'a path::Figures,
    waypoints: usize,
    tree_nodes: usize,
}

/// Runs the command.
pub fn run(args: &PlanArgs) -> anyhow::Result<u8> {
    let map = map_files::load(&args.map, args.load.into())?;
    let query = AtlasQuery::new(&map.atlas);
    if let Some(file) = &args.recheck {
        return recheck::run(args, file, &map, &query);
    }
    let (Some(start), Some(goal), Some(output)) = (args.start, args.goal, &args.output) else { anyhow::bail!("start, goal and output are missing") };
    let request = args.request(start, goal, map.origin);
    let found = plan(&query, &request).map_err(|error| explain(args, error))?;
    let figures = path::Figures::new(&request, &found, map.origin);
    let path = path::PathFile::new(&args.map, &map, &found, figures);
    write(output, &path)?;
    if let Some(to) = &args.picture {
        threads::pool(args.threads)?.install(|| picture::draw(to, &query, &request, &found, map.origin))?;
    }
    let (figures, waypoints, tree_nodes) = (&path.figures, found.path.len(), found.tree.len());
    let turn = sharpest_turn(&found.path);
    tracing::info!(
        "{:.2} m, {:.2} m from the nearest obstacle, no turn sharper than {turn:.0} degrees; first path after {:.0} ms, {} samples in {:.2} s",
        found.length,
        found.least_clearance,
        1e3 * found.first.seconds,
        found.samples,
        found.seconds
    );
    tracing::info!("wrote {}", output.display());
    if args.json {
        output::print_json(&Summary { output, submaps_damaged: map.damaged, picture: args.picture.as_deref(), figures, waypoints, tree_nodes })?;
    }
    Ok(failure::DONE)
}

fn write(path: &Path, content: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string(content).context("cannot write the path as JSON")?;
    voxelastic_files::write(path, |out| writeln!(out, "{text}")).with_context(|| format!("cannot write {}", path.display()))
}
