//! Plots of the runs over the scans: time, memory, submaps.

use crate::error::Result;
use crate::results::Suite;
use crate::run::{OURS, Run, Series as PerScan};
use crate::setting::Setting;
use std::path::{Path, PathBuf};
use voxelastic_eval::plot::{Plot, Series};

/// A plot: name in files, title, unit, and values.
type Kind = (&'static str, &'static str, &'static str, fn(&PerScan) -> Vec<f64>);

const KINDS: [Kind; 3] = [
    ("time", "Processor time of a scan", "ms", |s| moving_average(&s.cpu_ms)),
    ("memory", "Memory of the map", "MB", |s| s.map_mb.clone()),
    ("submaps", "Submaps", "", |s| s.submaps.iter().map(|n| f64::from(*n)).collect()),
];

/// Width of the moving average of times, scans: raw times would hide each other.
const WINDOW: usize = 5;

/// Writes `time-DATA.png`, `memory-DATA.png` and `submaps-DATA.png` into `folder` for each dataset. Returns the files.
///
/// # Errors
/// When a file cannot be written.
pub fn write(suite: &Suite, folder: &Path) -> Result<Vec<PathBuf>> {
    let mut names: Vec<&str> = suite.runs.iter().map(|r| r.data.as_str()).collect();
    names.dedup();
    let mut files = Vec::new();
    for data in names {
        for (name, title, unit, values) in KINDS {
            let mut plot = Plot::new(&format!("{title}, {data}, one thread"), "scan", unit);
            plot.series = suite.runs.iter().filter(|r| r.data == data && is_shown(r)).filter_map(|run| line(run, values)).collect();
            if !plot.series.is_empty() {
                let path = folder.join(format!("{name}-{data}.png"));
                plot.write_png(&path)?;
                files.push(path);
            }
        }
    }
    Ok(files)
}

/// Whether a run is shown: our runs on one thread with default submaps. Peers are left out, because a much higher line would flatten the others.
fn is_shown(run: &Run) -> bool {
    run.system == OURS && run.threads == 1 && !run.one_submap
}

fn line(run: &Run, values: fn(&PerScan) -> Vec<f64>) -> Option<Series> {
    let values = values(&run.series);
    let setting = Setting { max_range: run.max_range_m, voxel: run.voxel_m };
    let points: Vec<[f64; 2]> = values.iter().enumerate().map(|(i, v)| [i as f64, *v]).collect();
    (!points.is_empty()).then(|| Series::line(&format!("{}, {setting}", run.field), points))
}

/// Moving average over [`WINDOW`] scans.
fn moving_average(values: &[f64]) -> Vec<f64> {
    (0..values.len())
        .map(|i| {
            let near = &values[i.saturating_sub(WINDOW / 2)..(i + WINDOW / 2 + 1).min(values.len())];
            near.iter().sum::<f64>() / near.len() as f64
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_dataset_has_its_plots() {
        let series = PerScan { cpu_ms: vec![1.0, 2.0, 6.0], map_mb: vec![1.0, 2.0, 3.0], submaps: vec![1, 1, 2], ..PerScan::default() };
        let run = |data: &str| Run { system: OURS.into(), data: data.into(), threads: 1, series: series.clone(), ..Run::default() };
        let dir = tempfile::tempdir().unwrap();
        let files = write(&Suite { runs: vec![run("campus"), run("hall")], ..Suite::default() }, dir.path()).unwrap();
        assert_eq!(files.len(), 6);
        assert!(files.iter().all(|f| f.is_file()) && files[0].ends_with("time-campus.png"));
        assert_eq!(moving_average(&[1.0, 2.0, 6.0]), [3.0, 3.0, 3.0]);
    }
}
