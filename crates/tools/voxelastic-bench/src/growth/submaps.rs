//! Costs of a map with up to a thousand submaps.

use super::sweep::{Point, Sweep};
use crate::data::{Dataset, simulated};
use crate::error::Result;
use crate::run::{Case, Run};
use crate::setting::Setting;
use crate::special;
use crate::workspace::Workspace;
use voxelastic::settings::FieldKind;
use voxelastic_eval::SeriesStats;

/// Numbers of submaps.
const SUBMAPS: [usize; 4] = [30, 100, 300, 1000];
/// Scans count for a number of submaps if theirs differs by at most this.
const TOLERANCE: usize = 10;
/// A coarse map of a small sensor, on which the measured costs do not depend.
const SETTING: Setting = Setting { max_range: 30.0, voxel: 0.26 };

/// A car drives laps around the street, with a new submap every other scan, also in mapped areas.
pub(super) fn sweep(workspace: &Workspace) -> Result<Sweep> {
    let scans = (2 * (SUBMAPS[SUBMAPS.len() - 1] + TOLERANCE) + 4).to_string();
    let how = ["street", "--sensor", "vlp-16", "--columns", "256", "--scans", &scans, "--loop-radius", "0", "--drift", "0"];
    let data = Dataset::simulated("submaps", simulated(workspace, "submaps", &how)?);
    tracing::info!("a map of {} submaps", SUBMAPS[SUBMAPS.len() - 1]);
    let case = Case { data: &data, setting: SETTING, field: FieldKind::Tsdf, threads: 1, one_submap: false };
    let run = case.run_with(workspace, "submaps.vox", &["--lambda-odom", "3", "--min-overlap", "1"])?;
    workspace.remove_scratch("submaps.vox");
    let corrections = special::pose_updates(&SUBMAPS)?;
    let points = corrections.iter().map(|update| Point { pose_update_ms: update.wall_ms.median, ..at(&run, update.submaps) });
    let fixed = format!("{SETTING}, 16 x 256 beams, 2 scans a submap");
    Ok(Sweep { points: points.collect(), ..Sweep::new("submaps", "", "tsdf", fixed) }.fitted())
}

/// Costs while the map had about this many submaps.
fn at(run: &Run, submaps: usize) -> Point {
    let series = &run.series;
    let is_near = |n: &u32| (*n as usize).abs_diff(submaps) <= TOLERANCE;
    let near = |values: &[f64]| -> Vec<f64> { values.iter().zip(&series.submaps).filter(|(_, n)| is_near(n)).map(|(v, _)| *v).collect() };
    let last = series.submaps.iter().rposition(|n| *n as usize <= submaps);
    Point {
        x: submaps as f64,
        cpu_ms: SeriesStats::new(&near(&series.cpu_ms)).median,
        map_mb: last.and_then(|i| series.map_mb.get(i).copied()),
        peak_rss_mb: None,
        elastic_ms: SeriesStats::new(&near(&series.elastic_ms)).mean,
        pose_update_ms: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Series;

    #[test]
    fn costs_are_those_of_scans_near_that_number() {
        let submaps: Vec<u32> = (0..200).map(|i| i / 2 + 1).collect();
        let costs: Vec<f64> = submaps.iter().map(|n| f64::from(*n)).collect();
        let series = Series { cpu_ms: costs.clone(), elastic_ms: costs.clone(), map_mb: costs, submaps, ..Series::default() };
        let point = at(&Run { series, ..Run::default() }, 50);
        assert_eq!((point.cpu_ms, point.elastic_ms, point.map_mb), (Some(50.0), Some(50.0), Some(50.0)));
    }
}
