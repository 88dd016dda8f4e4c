//! One configuration, mapped once, in a process of its own.

use crate::data::Dataset;
use crate::error::{BenchError, Result};
use crate::quality::{self, Quality};
use crate::setting::Setting;
use crate::workshop::{Workshop, load, words};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use voxelastic::settings::FieldKind;
use voxelastic_eval::Spread;
use voxelastic_report::RunLog;

/// The name of our own runs in tables, beside those of peers.
pub const OURS: &str = "voxelastic";

/// What is to be run.
#[derive(Clone, Copy, Debug)]
pub struct Case<'a> {
    /// The scans.
    pub data: &'a Dataset,
    /// Range and voxel.
    pub setting: Setting,
    /// What is mapped.
    pub field: FieldKind,
    /// Threads of the mapper.
    pub threads: usize,
    /// All scans into one submap, as systems without submaps have it.
    pub one_submap: bool,
}

/// What a run took. Keys of the JSON; they stay.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Run {
    /// `voxelastic`, or the name of a peer.
    pub system: String,
    /// The scans' name.
    pub data: String,
    /// `tsdf` or `occupancy`.
    pub field: String,
    /// Largest range, metres.
    pub max_range_m: f32,
    /// Finest voxel, metres.
    pub voxel_m: f32,
    /// Threads.
    pub threads: usize,
    /// Whether all scans went into one submap.
    pub one_submap: bool,
    /// The command that repeats it.
    pub command: String,
    /// Scans integrated.
    pub scans: usize,
    /// Scans there were: a peer that the time limit stopped did fewer.
    pub scans_offered: usize,
    /// Processor time of a scan, preparation included, decoding not; milliseconds.
    pub cpu_ms: Spread,
    /// Wall time of the same.
    pub wall_ms: Spread,
    /// Median wall time by phase; empty for peers.
    pub phases_ms: BTreeMap<String, f64>,
    /// Scans a second with reading and decoding, from the first to the last; `null` for peers.
    pub scans_per_s: Option<f64>,
    /// Most memory of the process, megabytes (10^6 bytes).
    pub peak_rss_mb: Option<f64>,
    /// Memory of the map, megabytes.
    pub map_mb: Option<f64>,
    /// Size of the map on disk, megabytes; `null` for peers.
    pub file_mb: Option<f64>,
    /// Submaps; `null` for peers.
    pub submaps: Option<usize>,
    /// What the map is worth; `null` where it was not measured.
    pub quality: Option<Quality>,
    /// Load of the machine when the run began.
    pub load: Option<f64>,
    /// Median processor time of all repetitions, this one included; in the order in which they ran.
    pub repetitions_ms: Vec<f64>,
    /// Why it is not complete; empty when it is.
    pub note: String,
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
    /// Most memory that a peer's process had taken so far, megabytes; empty for our own runs.
    pub peak_mb: Vec<f64>,
    /// Submaps.
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
        all.extend(words(&["--voxel", &self.setting.voxel.to_string(), "--max-range", &self.setting.max_range.to_string()]));
        all.extend(words(&["--threads", &self.threads.to_string(), "--json"]));
        if self.one_submap {
            all.extend(words(&["--lambda-odom", "100000", "--min-overlap", "1"]));
        }
        all
    }

    /// Maps, into `name` among the workshop's scratch, which is left there for the caller to use and discard.
    ///
    /// # Errors
    /// When the program fails.
    pub fn run(&self, shop: &Workshop, name: &str) -> Result<Run> {
        self.run_with(shop, name, &[])
    }

    /// The same with more arguments.
    pub(crate) fn run_with(&self, shop: &Workshop, name: &str, more: &[&str]) -> Result<Run> {
        let (map, load) = (shop.scratch(name), load());
        shop.discard(name);
        let mut arguments = self.arguments(&map);
        arguments.extend(words(more));
        let answer = shop.ask(&arguments)?;
        let log_path = map.join("run.json");
        let log = fs::read_to_string(&log_path).map_err(BenchError::file(&log_path))?;
        let log = RunLog::from_json(&log).map_err(|e| BenchError::Answer { command: Workshop::told(&arguments), what: e.to_string() })?;
        let told = Workshop::told(&arguments);
        let unusable = |what: &str| BenchError::Answer { command: told.clone(), what: format!("no `{what}`") };
        let number = |key: &str| answer[key].as_f64();
        let scans = answer["scans"].as_u64().ok_or_else(|| unusable("scans"))? as usize;
        Ok(Run {
            system: OURS.to_owned(),
            scans,
            scans_offered: scans + answer["scans_skipped"].as_u64().unwrap_or(0) as usize,
            cpu_ms: Spread::of(&log.scans.cpu_ms),
            wall_ms: Spread::of(&log.scans.wall_ms),
            phases_ms: phases(&answer["phases_ms"]),
            scans_per_s: number("mapping_s").filter(|s| *s > 0.0).map(|s| scans as f64 / s),
            peak_rss_mb: number("peak_rss_mb"),
            map_mb: number("map_mb"),
            file_mb: number("file_mb"),
            submaps: answer["submaps"].as_u64().map(|n| n as usize),
            load,
            repetitions_ms: Spread::of(&log.scans.cpu_ms).median.into_iter().collect(),
            series: Series {
                peak_mb: Vec::new(),
                elastic_ms: log.phases_ms.get("elastic").cloned().unwrap_or_default(),
                cpu_ms: log.scans.cpu_ms,
                wall_ms: log.scans.wall_ms,
                map_mb: log.scans.map_mb,
                submaps: log.scans.submaps,
            },
            command: told.clone(),
            ..self.named()
        })
    }

    /// A run of this case of which nothing is known yet.
    pub(crate) fn named(&self) -> Run {
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

    /// What the map that [`run`](Self::run) left is worth.
    ///
    /// # Errors
    /// When the program fails.
    pub fn judge(&self, shop: &Workshop, name: &str) -> Result<Option<Quality>> {
        quality::measure(shop, &shop.scratch(name), self.data, Some(self.field))
    }
}

fn phases(answer: &Value) -> BTreeMap<String, f64> {
    let all = answer.as_object().into_iter().flatten();
    all.filter_map(|(name, spread)| Some((name.clone(), spread["median"].as_f64()?))).collect()
}

/// Of several repetitions the one in the middle, which remembers the times of all.
pub(crate) fn middle(runs: Vec<Run>) -> Option<Run> {
    let times: Vec<f64> = runs.iter().filter_map(|r| r.cpu_ms.median).collect();
    let mut runs = runs;
    let key = |r: &Run| r.cpu_ms.median.unwrap_or(f64::INFINITY);
    runs.sort_by(|a, b| key(a).total_cmp(&key(b)));
    let place = runs.len().saturating_sub(1) / 2;
    (place < runs.len()).then(|| Run { repetitions_ms: times, ..runs.swap_remove(place) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_three_repetitions_the_middle_one_counts() {
        let run = |ms: f64| Run { cpu_ms: Spread::of(&[ms]), ..Run::default() };
        let chosen = middle(vec![run(3.0), run(1.0), run(2.0)]).unwrap();
        assert_eq!((chosen.cpu_ms.median, chosen.repetitions_ms), (Some(2.0), vec![3.0, 1.0, 2.0]));
        assert!(middle(Vec::new()).is_none());
    }
}
