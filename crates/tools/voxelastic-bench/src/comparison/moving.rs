//! Moving things, on real sweeps with labels, beside DUFOMap.

use crate::data::missing_folder;
use crate::error::Result;
use crate::peers::environments::DUFOMAP;
use crate::peers::{Interpreters, user_lines, write_adapter};
use crate::process::{Outcome, run_lines};
use crate::workspace::{Workspace, words};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Duration;

/// The recording.
const RECORDING: &str = "semantickitti05";
/// The script that scores both, and the adapter that it takes the peer from.
const SCRIPT: (&str, &str) = ("moving.py", include_str!("../../peers/moving.py"));
const LIMIT: Duration = Duration::from_secs(180);

/// A system that tells what moves.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct MovingRun {
    /// Name and version; when a point is judged.
    pub system: String,
    /// Static points that are kept, percent.
    pub static_kept: f64,
    /// Points on what moves that are removed, percent.
    pub moving_removed: f64,
    /// Processor time of a scan, milliseconds, where it is known.
    pub cpu_ms: Option<f64>,
    /// Lines of code that a user of a peer writes; none for ours, which is a command.
    #[serde(default)]
    pub user_lines: Option<usize>,
}

/// Runs both, and adds what was left out to `skipped`.
pub(super) fn run(workspace: &Workspace, data: &Path, interpreters: &Interpreters, skipped: &mut Vec<String>) -> Result<Vec<MovingRun>> {
    let mut found = Vec::new();
    let folder = data.join(RECORDING);
    if !folder.is_dir() {
        skipped.push(missing_folder(RECORDING, &folder));
        return Ok(found);
    }
    let python = match interpreters.of(&DUFOMAP) {
        Ok(python) => python,
        Err(why) => {
            skipped.push(format!("DUFOMap: {why}"));
            return Ok(found);
        }
    };
    tracing::info!("{RECORDING}, what moves");
    let (map, removed) = (workspace.scratch("moving.vox").display().to_string(), workspace.scratch("moving.ply").display().to_string());
    let folder = folder.display().to_string();
    let dynamic = ["--dynamic", "remove", "--dynamic-points", &removed, "--threads", "1", "--json", "-o", &map];
    let answer = workspace.run_json(&[words(&["map", &folder]), words(&dynamic)].concat())?;
    let script = write_adapter(workspace, SCRIPT.0, SCRIPT.1)?.display().to_string();
    let peer_lines = user_lines(SCRIPT.1);
    let outcome = run_lines(&python, &[script, "--json".to_owned(), folder, removed], LIMIT, |line| {
        if let Ok(mut run) = serde_json::from_str::<MovingRun>(line) {
            if run.system.starts_with("Voxelastic") {
                // Mapping and all, while the peer only removes.
                run.cpu_ms = answer.pointer("/integrate_cpu_ms/mean").and_then(serde_json::Value::as_f64);
            } else {
                run.user_lines = peer_lines;
            }
            found.push(run);
        }
    })?;
    if outcome != Outcome::Success {
        skipped.push(format!("DUFOMap: {RECORDING}: {outcome:?}"));
    }
    workspace.remove_scratch("moving.vox");
    workspace.remove_scratch("moving.ply");
    Ok(found)
}
