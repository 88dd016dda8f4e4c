//! Other mapping systems on the same scans.
//!
//! A peer is run by an *adapter*, a program in any language. It is called with one argument, the path of a request, and prints
//! one JSON object per line on stdout.
//!
//! The request is a JSON object:
//!
//! | key | meaning |
//! | --- | --- |
//! | `format` | 1 |
//! | `field` | `"tsdf"` (surfaces) or `"occupancy"`: the field to map |
//! | `voxel_m`, `max_range_m`, `min_range_m`, `threads` | settings; ranges from the sensor, metres |
//! | `time_limit_s` | no scan should be started after this many seconds; the adapter is stopped half a minute later |
//! | `scans` | in order: `points`, the path of a file of little-endian `f32` quadruples x, y, z, 0 in the lidar's frame (KITTI's `.bin`), returns only; `t_map_lidar`, the lidar's pose `[x, y, z, qx, qy, qz, qw]` in the map |
//! | `surface` | where the adapter may write the vertices of its mesh, or the centres of its occupied voxels, in the map's frame, again as x, y, z, 0 |
//!
//! The output is a line `{"system": "OctoMap 1.10, discretised"}`, then one line per scan when it is in the map:
//! `{"scan": 0, "cpu_ms": 1.5, "wall_ms": 1.6}`, with `map_mb` and `peak_rss_mb` (10^6 bytes) where the adapter knows them. The times
//! exclude reading the points and include everything until the map can be queried. A last line `{"surface": true}` says that the surface was written.
//! Other lines are ignored. Exit code 77 means that the peer is not installed, 78 that it does not map the field.
//!
//! The adapters `peers/octomap_adapter.py`, `peers/vdbfusion_adapter.py` and `peers/open3d_adapter.py` of this crate share the module `peers/adapter.py`;
//! [`python_peers`] runs them. What a user writes, too, is between marks there, and is counted.

pub(crate) mod environments;
mod exported;

use crate::error::Result;
use crate::process::{Outcome, run_lines};
use crate::run::{Case, Run, Series};
use crate::workspace::{Workspace, load};
use crate::{BenchError, Dataset, quality};
pub use environments::Interpreters;
use environments::{OCTOMAP, OPEN3D, Package, VDBFUSION};
pub(crate) use exported::ExportedScans;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;
use voxelastic_eval::SeriesStats;

/// A mapping system with its adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peer {
    /// Its name; the adapter may report a more precise one.
    pub name: String,
    /// Command line of the adapter; the path of the request is appended.
    pub command: Vec<String>,
    /// Lines of code that a user of the peer writes, too; none where the adapter does not mark them.
    pub user_lines: Option<usize>,
}

/// Peers with Python packages: name, file and text of the adapter, package.
const ADAPTERS: [(&str, &str, &str, Package); 3] = [
    ("OctoMap", "octomap_adapter.py", include_str!("../../peers/octomap_adapter.py"), OCTOMAP),
    ("VDBFusion", "vdbfusion_adapter.py", include_str!("../../peers/vdbfusion_adapter.py"), VDBFUSION),
    ("Open3D", "open3d_adapter.py", include_str!("../../peers/open3d_adapter.py"), OPEN3D),
];
/// The module shared by the adapters.
const SHARED: (&str, &str) = ("adapter.py", include_str!("../../peers/adapter.py"));
/// Time beyond the limit for an adapter to start and to finish a scan.
const GRACE: Duration = Duration::from_secs(30);

/// OctoMap, VDBFusion and Open3D through their Python packages, and why those are missing that cannot be installed.
///
/// # Errors
/// When an adapter cannot be written to the workspace.
pub fn python_peers(workspace: &Workspace, interpreters: &Interpreters) -> Result<(Vec<Peer>, Vec<String>)> {
    write_adapter(workspace, SHARED.0, SHARED.1)?;
    let (mut found, mut missing) = (Vec::new(), Vec::new());
    for (name, file, text, package) in &ADAPTERS {
        let script = write_adapter(workspace, file, text)?.display().to_string();
        match interpreters.of(package) {
            Ok(python) => found.push(Peer { name: (*name).to_owned(), command: vec![python, script], user_lines: user_lines(text) }),
            Err(why) => missing.push(format!("{name}: {why}")),
        }
    }
    Ok((found, missing))
}

/// Writes an adapter to the workspace.
pub(crate) fn write_adapter(workspace: &Workspace, file: &str, text: &str) -> Result<PathBuf> {
    let script = workspace.folder().join(file);
    fs::write(&script, text).map_err(BenchError::file(&script)).map(|()| script)
}

/// Lines of code between the marks of an adapter: what a user of the peer writes, too, without reading, printing and what is particular to the bench.
pub(crate) fn user_lines(adapter: &str) -> Option<usize> {
    let marked = adapter.split("# user code: begin\n").skip(1).filter_map(|rest| rest.split_once("# user code: end"));
    let is_code = |line: &&str| !line.is_empty() && !line.starts_with('#');
    let lines: usize = marked.map(|(code, _)| code.lines().map(str::trim).filter(is_code).count()).sum();
    (lines > 0).then_some(lines)
}

impl Peer {
    /// Reads `NAME=COMMAND ARGUMENTS`; none when either is missing.
    pub fn parse(text: &str) -> Option<Self> {
        let (name, command) = text.split_once('=')?;
        let command: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
        (!name.trim().is_empty() && !command.is_empty()).then(|| Self { name: name.trim().to_owned(), command, user_lines: None })
    }

    /// Runs the peer on `case` with the `exported` scans within `limit`, and measures its surface.
    pub(crate) fn run(&self, workspace: &Workspace, case: &Case<'_>, exported: &ExportedScans, limit: Duration) -> Result<Run> {
        let (surface, load) = (workspace.scratch("peer.bin"), load());
        workspace.remove_scratch("peer.bin");
        let request = exported.request(case, limit, &surface)?;
        let (program, arguments) = self.command.split_first().map_or(("", &[][..]), |(p, a)| (p.as_str(), a));
        let mut all = arguments.to_vec();
        all.push(request.display().to_string());
        let mut answer = Answer { system: self.name.clone(), ..Answer::default() };
        let outcome = run_lines(program, &all, limit + GRACE, |line| answer.read_line(line))?;
        let offered = exported.len();
        let mut run = Run { load, scans_offered: offered, note: note(&outcome, answer.scans(), offered), ..answer.run(case) };
        run.command = crate::process::command_line(program, &all);
        run.user_lines = self.user_lines;
        if answer.wrote_surface && run.scans == offered {
            run.quality = quality::measure(workspace, &surface, case.data, None)?;
        }
        Ok(run)
    }
}

/// Exit code of an adapter whose peer is not installed.
const ABSENT: &str = "77";
/// Exit code of an adapter whose peer does not map the field.
const OTHER_FIELD: &str = "78";
/// Note of a run of such an adapter.
pub(crate) const NOT_THIS_FIELD: &str = "does not map this field";

/// Note on a run that is not complete; empty if it is.
fn note(outcome: &Outcome, done: usize, offered: usize) -> String {
    match outcome {
        Outcome::Failed(status) if status.ends_with(ABSENT) => "skipped: not installed".to_owned(),
        Outcome::Failed(status) if status.ends_with(OTHER_FIELD) => NOT_THIS_FIELD.to_owned(),
        Outcome::Failed(status) => format!("failed: {status}"),
        Outcome::TimedOut => format!("stopped after {done} of {offered} scans"),
        Outcome::Success if done < offered => format!("time was up after {done} of {offered} scans"),
        Outcome::Success => String::new(),
    }
}

/// The output of an adapter so far.
#[derive(Debug, Default)]
struct Answer {
    system: String,
    series: Series,
    wrote_surface: bool,
}

impl Answer {
    fn read_line(&mut self, line: &str) {
        let Ok(Value::Object(object)) = serde_json::from_str(line) else { return };
        if let Some(system) = object.get("system").and_then(Value::as_str) {
            self.system = system.to_owned();
        }
        let number = |key: &str| object.get(key).and_then(Value::as_f64).filter(|v| *v >= 0.0);
        if let (true, Some(cpu), Some(wall)) = (object.contains_key("scan"), number("cpu_ms"), number("wall_ms")) {
            self.series.cpu_ms.push(cpu);
            self.series.wall_ms.push(wall);
            self.series.map_mb.extend(number("map_mb"));
            self.series.peak_mb.extend(number("peak_rss_mb"));
        }
        self.wrote_surface |= object.get("surface").and_then(Value::as_bool).unwrap_or(false);
    }

    fn scans(&self) -> usize {
        self.series.cpu_ms.len()
    }

    fn run(&self, case: &Case<'_>) -> Run {
        Run {
            system: self.system.clone(),
            scans: self.scans(),
            cpu_ms: SeriesStats::new(&self.series.cpu_ms),
            wall_ms: SeriesStats::new(&self.series.wall_ms),
            peak_rss_mb: self.series.peak_mb.last().copied(),
            map_mb: self.series.map_mb.last().copied(),
            repetitions_ms: SeriesStats::new(&self.series.cpu_ms).median.into_iter().collect(),
            series: self.series.clone(),
            one_submap: true,
            ..case.empty_run()
        }
    }
}

/// Exports the scans of `data` for adapters.
pub(crate) fn export_scans(data: &Dataset, folder: &Path) -> Result<ExportedScans> {
    ExportedScans::write(data, folder)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::{HARDEST, Truth};
    use voxelastic::settings::FieldKind;

    fn run_adapter(script: &str, limit: Duration) -> Run {
        let dir = tempfile::tempdir().unwrap();
        let workspace = Workspace::create("voxelastic".into(), dir.path().into()).unwrap();
        let adapter = dir.path().join("adapter.sh");
        fs::write(&adapter, script).unwrap();
        let data = Dataset { name: "two".into(), folder: "two".into(), poses: None, truth: Truth::None, max_scans: None };
        let case = Case { data: &data, setting: HARDEST, field: FieldKind::Occupancy, threads: 1, one_submap: true };
        let peer = Peer { name: "toy".into(), command: vec!["/bin/sh".into(), adapter.display().to_string()], user_lines: None };
        peer.run(&workspace, &case, &ExportedScans::of(dir.path(), 2), limit).unwrap()
    }

    #[test]
    fn adapter_gets_a_request_and_its_lines_are_read() {
        let script = r#"
            grep -q '"voxel_m":0.065' "$1" && grep -q '"time_limit_s":5.0' "$1" || exit 1
            echo '{"system": "Toy 2"}'; echo a library talks
            echo '{"scan": 0, "cpu_ms": 3, "wall_ms": 4, "map_mb": 1, "peak_rss_mb": 9}'
            echo '{"scan": 1, "cpu_ms": 5, "wall_ms": 6, "map_mb": 2, "peak_rss_mb": 10}'"#;
        let run = run_adapter(script, Duration::from_secs(5));
        assert_eq!((run.system.as_str(), run.scans, run.note.as_str()), ("Toy 2", 2, ""));
        assert_eq!((run.cpu_ms.mean, run.map_mb, run.peak_rss_mb), (Some(4.0), Some(2.0), Some(10.0)));
    }

    #[test]
    fn incomplete_runs_have_a_note() {
        let run = run_adapter("echo '{\"scan\": 0, \"cpu_ms\": 3, \"wall_ms\": 4}'", Duration::from_secs(5));
        assert_eq!((run.scans, run.note.as_str()), (1, "time was up after 1 of 2 scans"));
        assert_eq!(run_adapter("exit 77", Duration::from_secs(5)).note, "skipped: not installed");
        assert_eq!(run_adapter("exit 78", Duration::from_secs(5)).note, NOT_THIS_FIELD);
        assert!(run_adapter("exit 3", Duration::from_secs(5)).note.starts_with("failed: "));
    }

    #[test]
    fn adapters_mark_what_a_user_writes() {
        assert_eq!(user_lines("a\n# user code: begin\nb\n\n# c\n  d\n# user code: end\ne\n  # user code: begin\nf\n  # user code: end"), Some(3));
        assert!(ADAPTERS.iter().all(|(_, _, text, _)| user_lines(text).is_some_and(|lines| lines > 0)));
        assert_eq!(user_lines("no marks"), None);
    }

    #[test]
    fn peers_are_parsed_from_the_command_line() {
        let peer = Peer::parse("Bonxai = python3 bonxai.py").unwrap();
        assert_eq!((peer.name.as_str(), peer.command.len()), ("Bonxai", 2));
        assert!(Peer::parse("nothing").is_none() && Peer::parse("x=").is_none());
    }
}
