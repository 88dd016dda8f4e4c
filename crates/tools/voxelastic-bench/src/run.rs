//! A run: one configuration mapped once, in its own process.

use crate::data::Dataset;
use crate::error::{BenchError, Result};
use crate::quality::{self, Quality};
use crate::setting::Setting;
use crate::workspace::{Workspace, load, words};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use voxelastic::settings::FieldKind;
use voxelastic_eval::SeriesStats;
use voxelastic_report::RunLog;

/// Name of our own system in tables.
pub const OURS: &str = "voxelastic";

/// A configuration to run.
#[derive(Clone, Copy, Debug)]
pub struct Case<'a> {
    /// The scans.
    pub data: &'a Dataset,
    /// Range and resolution.
    pub setting: Setting,
    /// The field to map.
    pub field: FieldKind,
    /// Threads of the mapper.
    pub threads: usize,
    /// All scans in one submap, like systems without submaps.
    pub one_submap: bool,
}

/// Costs and results of a run. The keys of the JSON are stable.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Run {
    /// `voxelastic`, or the name of a peer.
    pub system: String,
    /// Name of the dataset.
    pub data: String,
    /// `tsdf` or `occupancy`.
    pub field: String,
    /// Largest range, metres.
    pub max_range_m: f32,
    /// Finest voxel, metres.
    pub voxel_m: f32,
    /// Threads.
    pub threads: usize,
    /// Whether all scans are in one submap.
    pub one_submap: bool,
    /// The command line.
    pub command: String,
    /// Scans integrated.
    pub scans: usize,
    /// Scans of the dataset; a peer may be stopped by the time limit before.
    pub scans_offered: usize,
    /// Processor time per scan with preparation, without decoding, milliseconds.
    pub cpu_ms: SeriesStats,
    /// Wall time likewise.
    pub wall_ms: SeriesStats,
    /// Median wall time by phase; empty for peers.
    pub phases_ms: BTreeMap<String, f64>,
    /// Scans per second with reading and decoding; `null` for peers.
    pub scans_per_s: Option<f64>,
    /// Peak memory of the process, megabytes (10^6 bytes).
    pub peak_rss_mb: Option<f64>,
    /// Memory of the map, megabytes.
    pub map_mb: Option<f64>,
    /// Size of the map on disk, megabytes; `null` for peers.
    pub file_mb: Option<f64>,
    /// Number of submaps; `null` for peers.
    pub submaps: Option<usize>,
    /// Accuracy of the map; `null` if it was not measured.
    pub quality: Option<Quality>,
    /// Load of the machine at the start.
    pub load: Option<f64>,
    /// Median processor times of all repetitions in order, this one included.
    pub repetitions_ms: Vec<f64>,
    /// Why the run is not complete; empty if it is.
    pub note: String,
    /// Lines of code that a user of a peer writes; `null` for ours, which is a command, and where it is not known.
    pub user_lines: Option<usize>,
    /// One value per scan.
    pub series: Series,
}

/// Values per scan, in the order of integration.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Series {
    /// Processor time, milliseconds.
    pub cpu_ms: Vec<f64>,
    /// Wall time, milliseconds.
    pub wall_ms: Vec<f64>,
    /// Memory of the map, megabytes.
    pub map_mb: Vec<f64>,
    /// Peak memory of a peer's process so far, megabytes; empty for our own runs.
    pub peak_mb: Vec<f64>,
    /// Number of submaps.
    pub submaps: Vec<u32>,
    /// Wall time of the elastic part, milliseconds.
    #[serde(skip)]
    pub elastic_ms: Vec<f64>,
}

impl Case<'_> {
    /// The arguments of `voxelastic`.
    fn arguments(&self, map: &Path) -> Vec<String> {
        let mut all = words(&["map"]);
        all.extend(self.data.arguments());
        all.extend(words(&["-o", &map.display().to_string(), "--field", self.field.name()]));
        all.extend(words(&["--voxel-size", &self.setting.voxel.to_string(), "--max-range", &self.setting.max_range.to_string()]));
        all.extend(words(&["--threads", &self.threads.to_string(), "--json"]));
        if self.one_submap {
            all.extend(words(&["--lambda-odom", "100000", "--min-overlap", "1"]));
        }
        all
    }

    /// Runs the configuration; the map remains as `name` in the workspace's scratch until the caller removes it.
    ///
    /// # Errors
    /// When the program fails.
    pub fn run(&self, workspace: &Workspace, name: &str) -> Result<Run> {
        self.run_with(workspace, name, &[])
    }

    /// Likewise with additional arguments.
    pub(crate) fn run_with(&self, workspace: &Workspace, name: &str, more: &[&str]) -> Result<Run> {
        let (map, load) = (workspace.scratch(name), load());
        workspace.remove_scratch(name);
        let mut arguments = self.arguments(&map);
        arguments.extend(words(more));
        let answer = workspace.run_json(&arguments)?;
        let log_path = map.join("run.json");
        let log = fs::read_to_string(&log_path).map_err(BenchError::file(&log_path))?;
        let log = RunLog::from_json(&log).map_err(|e| BenchError::Answer { command: Workspace::command_line(&arguments), problem: e.to_string() })?;
        let command = Workspace::command_line(&arguments);
        let unusable = |what: &str| BenchError::Answer { command: command.clone(), problem: format!("no `{what}`") };
        let number = |key: &str| answer[key].as_f64();
        let scans = answer["scans"].as_u64().ok_or_else(|| unusable("scans"))? as usize;
        Ok(Run {
            system: OURS.to_owned(),
            scans,
            scans_offered: scans + answer["scans_skipped"].as_u64().unwrap_or(0) as usize,
            cpu_ms: SeriesStats::new(&log.scans.cpu_ms),
            wall_ms: SeriesStats::new(&log.scans.wall_ms),
            phases_ms: phases(&answer["phases_ms"]),
            scans_per_s: number("mapping_s").filter(|s| *s > 0.0).map(|s| scans as f64 / s),
            peak_rss_mb: number("peak_rss_mb"),
            map_mb: number("map_mb"),
            file_mb: number("file_mb"),
            submaps: answer["submaps"].as_u64().map(|n| n as usize),
            load,
            repetitions_ms: SeriesStats::new(&log.scans.cpu_ms).median.into_iter().collect(),
            series: Series {
                peak_mb: Vec::new(),
                elastic_ms: log.phases_ms.get("elastic").cloned().unwrap_or_default(),
                cpu_ms: log.scans.cpu_ms,
                wall_ms: log.scans.wall_ms,
                map_mb: log.scans.map_mb,
                submaps: log.scans.submaps,
            },
            command: command.clone(),
            ..self.empty_run()
        })
    }

    /// A run of this configuration without results.
    pub(crate) fn empty_run(&self) -> Run {
        Run {
            data: self.data.name.clone(),
            field: self.field.name().to_owned(),
            max_range_m: self.setting.max_range,
            voxel_m: self.setting.voxel,
            threads: self.threads,
            one_submap: self.one_submap,
            ..Run::default()
        }
    }

    /// Accuracy of the map that [`run`](Self::run) made.
    ///
    /// # Errors
    /// When the program fails.
    pub fn evaluate(&self, workspace: &Workspace, name: &str) -> Result<Option<Quality>> {
        quality::measure(workspace, &workspace.scratch(name), self.data, Some(self.field))
    }
}

fn phases(answer: &Value) -> BTreeMap<String, f64> {
    let all = answer.as_object().into_iter().flatten();
    all.filter_map(|(name, stats)| Some((name.clone(), stats["median"].as_f64()?))).collect()
}

/// The repetition with the median processor time, with the times of all.
pub(crate) fn median_run(runs: Vec<Run>) -> Option<Run> {
    let times: Vec<f64> = runs.iter().filter_map(|r| r.cpu_ms.median).collect();
    let mut runs = runs;
    let key = |r: &Run| r.cpu_ms.median.unwrap_or(f64::INFINITY);
    runs.sort_by(|a, b| key(a).total_cmp(&key(b)));
    let middle = runs.len().saturating_sub(1) / 2;
    (middle < runs.len()).then(|| Run { repetitions_ms: times, ..runs.swap_remove(middle) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_of_three_repetitions() {
        let run = |ms: f64| Run { cpu_ms: SeriesStats::new(&[ms]), ..Run::default() };
        let chosen = median_run(vec![run(3.0), run(1.0), run(2.0)]).unwrap();
        assert_eq!((chosen.cpu_ms.median, chosen.repetitions_ms), (Some(2.0), vec![3.0, 1.0, 2.0]));
        assert!(median_run(Vec::new()).is_none());
    }
}
