//! The goals of the project compared with the results of a suite: on the campus at the hardest setting, if nothing else is said.

use crate::goal::Goal;
use crate::results::Suite;
use crate::run::{OURS, Run};
use crate::setting::{HARDEST, SETTINGS};
use voxelastic_eval::stats::last_over_first;

/// A goal without measurement: quantity, unit, goal and least acceptable value, best peer.
struct Target(&'static str, &'static str, [f64; 2], &'static str);

impl Target {
    fn at_most(self, measured: Option<f64>) -> Goal {
        self.compare(measured, false)
    }

    fn at_least(self, measured: Option<f64>) -> Goal {
        self.compare(measured, true)
    }

    fn compare(self, measured: Option<f64>, more_is_better: bool) -> Goal {
        let Self(what, unit, [goal, least], best_peer) = self;
        let reaches = |target: f64| measured.is_some_and(|m| if more_is_better { m >= target } else { m <= target });
        let reached = match measured {
            None => "not measured",
            Some(_) if reaches(goal) => "goal",
            Some(_) if reaches(least) => "least",
            Some(_) => "missed",
        };
        Goal { what: what.to_owned(), unit, goal, least, more_is_better, measured, reached, best_peer }
    }
}

/// Our runs by configuration.
struct OurRuns<'a>(&'a [Run]);

impl OurRuns<'_> {
    fn find(&self, data: &str, field: &str, threads: usize, one_submap: bool) -> Option<&Run> {
        let matches = |r: &&Run| {
            let hard = r.max_range_m == HARDEST.max_range && r.voxel_m == HARDEST.voxel;
            r.system == OURS && hard && (r.data.as_str(), r.field.as_str(), r.threads, r.one_submap) == (data, field, threads, one_submap)
        };
        self.0.iter().find(matches)
    }

    fn campus(&self, field: &str) -> Option<&Run> {
        self.find("campus", field, 1, false)
    }

    /// 95th percentile of the processor time over its median.
    fn p95_over_median(&self, field: &str) -> Option<f64> {
        let cpu = self.campus(field)?.cpu_ms;
        Some(cpu.p95? / cpu.median?)
    }

    /// Wall time of all scans on one thread over that on two.
    fn speedup(&self, field: &str) -> Option<f64> {
        Some(self.campus(field)?.wall_ms.median? / self.find("campus", field, 2, false)?.wall_ms.median?)
    }

    fn rate(&self, data: &str, field: &str) -> Option<f64> {
        self.find(data, field, 2, false)?.scans_per_s
    }
}

/// All goals with the values measured by `suite`.
pub(crate) fn all(suite: &Suite) -> Vec<Goal> {
    let ours = OurRuns(&suite.runs);
    // A quick suite maps too little of the campus for goals on the whole of it.
    let whole = if suite.quick { OurRuns(&[]) } else { OurRuns(&suite.runs) };
    let mut goals = speed(&ours);
    goals.extend(memory_and_error(&whole, suite));
    goals.extend(over_time(&whole, suite));
    goals.extend(other_settings(&whole));
    goals.extend(real(&whole));
    goals
}

fn speed(ours: &OurRuns<'_>) -> Vec<Goal> {
    let median = |field: &str| ours.campus(field)?.cpu_ms.median;
    vec![
        Target("TSDF integration, median, one thread", "ms CPU", [8.0, 15.0], "VDBFusion 44").at_most(median("tsdf")),
        Target("occupancy with explicit free space, median, one thread", "ms CPU", [30.0, 100.0], "UFOMap coarse 332").at_most(median("occupancy")),
        Target("p95 over median, TSDF", "", [1.5, 2.0], "").at_most(ours.p95_over_median("tsdf")),
        Target("p95 over median, occupancy", "", [1.5, 2.0], "").at_most(ours.p95_over_median("occupancy")),
        Target("2 threads over 1, wall, TSDF", "x", [1.8, 1.6], "supereight2 1.9").at_least(ours.speedup("tsdf")),
        Target("2 threads over 1, wall, occupancy", "x", [1.8, 1.6], "wavemap 2.2").at_least(ours.speedup("occupancy")),
    ]
}

fn memory_and_error(ours: &OurRuns<'_>, suite: &Suite) -> Vec<Goal> {
    let peak = |field: &str, one: bool| ours.find("campus", field, 1, one)?.peak_rss_mb;
    let error = |one: bool| Some(ours.find("campus", "tsdf", 1, one)?.quality.as_ref()?.mean_m? * 1e3);
    let complete = |one: bool| Some(ours.find("campus", "tsdf", 1, one)?.quality.as_ref()?.complete? * 100.0);
    let (error_target, completeness_target) = ([9.0, 12.0], [98.0, 96.0]);
    vec![
        Target("peak memory, TSDF", "MB", [200.0, 300.0], "VDBFusion 926").at_most(peak("tsdf", false)),
        Target("peak memory, TSDF, one submap", "MB", [200.0, 300.0], "VDBFusion 926").at_most(peak("tsdf", true)),
        Target("peak memory, occupancy", "MB", [250.0, 350.0], "UFOMap coarse 524 (102 scans)").at_most(peak("occupancy", false)),
        Target("peak memory, occupancy, one submap", "MB", [250.0, 350.0], "UFOMap coarse 524 (102 scans)").at_most(peak("occupancy", true)),
        Target("surface error, mean, TSDF", "mm", error_target, "VDBFusion 9").at_most(error(false)),
        Target("surface error, mean, TSDF, one submap", "mm", error_target, "VDBFusion 9").at_most(error(true)),
        Target("completeness within 5 cm, visible below 30 m", "%", completeness_target, "VDBFusion 97.8").at_least(complete(false)),
        Target("completeness, one submap", "%", completeness_target, "VDBFusion 97.8").at_least(complete(true)),
        Target("mesh of everything, one thread", "s", [1.0, 2.0], "supereight2 3.1").at_most(suite.special.mesh.as_ref().map(|m| m.extract_s)),
    ]
}

fn over_time(ours: &OurRuns<'_>, suite: &Suite) -> Vec<Goal> {
    let added = suite.special.second_lap.as_ref().map(|lap| lap.added * 100.0);
    let later = |field: &str| last_over_first(&ours.campus(field)?.series.cpu_ms, 50);
    let update = suite.special.pose_update.as_ref().filter(|u| u.submaps == 1000).and_then(|u| u.wall_ms.median);
    vec![
        Target("second lap: added memory, TSDF", "%", [3.0, 5.0], "").at_most(added),
        Target("time of the last 50 scans over the first 50, TSDF", "x", [1.1, 1.25], "").at_most(later("tsdf")),
        Target("time of the last 50 scans over the first 50, occupancy", "x", [1.1, 1.25], "").at_most(later("occupancy")),
        Target("pose update of 1,000 submaps", "ms", [0.2, 1.0], "").at_most(update),
    ]
}

/// At the coarser settings: faster than every peer that maps as much.
fn other_settings(ours: &OurRuns<'_>) -> Vec<Goal> {
    let median = |setting: usize, field: &str| {
        let setting = SETTINGS[setting];
        let matches = |r: &&Run| r.system == OURS && r.data == "campus" && r.field == field && r.threads == 1 && !r.one_submap;
        let run = ours.0.iter().filter(matches).find(|r| r.max_range_m == setting.max_range && r.voxel_m == setting.voxel)?;
        run.cpu_ms.median
    };
    vec![
        Target("60 m / 26 cm, TSDF, median, one thread", "ms CPU", [22.0, 22.0], "VDBFusion 22").at_most(median(1, "tsdf")),
        Target("60 m / 26 cm, occupancy, median, one thread", "ms CPU", [14.0, 14.0], "UFOMap coarse 14, Bonxai 32").at_most(median(1, "occupancy")),
        Target("20 m / 26 cm, TSDF, median, one thread", "ms CPU", [15.0, 15.0], "VDBFusion 15").at_most(median(2, "tsdf")),
        Target("20 m / 26 cm, occupancy, median, one thread", "ms CPU", [8.0, 8.0], "UFOMap coarse 8, Bonxai 12").at_most(median(2, "occupancy")),
    ]
}

/// On real scans, including decoding, on two threads.
fn real(ours: &OurRuns<'_>) -> Vec<Goal> {
    let rate = |data: &str, field: &str| ours.rate(data, field);
    vec![
        Target("hall, TSDF, decoding included, 2 threads", "Hz", [30.0, 30.0], "").at_least(rate("hall", "tsdf")),
        Target("hall, occupancy, decoding included, 2 threads", "Hz", [10.0, 10.0], "").at_least(rate("hall", "occupancy")),
        Target("street, TSDF, decoding included, 2 threads", "Hz", [30.0, 30.0], "").at_least(rate("street", "tsdf")),
        Target("street, occupancy, decoding included, 2 threads", "Hz", [10.0, 10.0], "").at_least(rate("street", "occupancy")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Series;
    use voxelastic_eval::SeriesStats;

    fn run(field: &str, threads: usize, ms: f64) -> Run {
        let series = Series { cpu_ms: vec![ms; 100], ..Series::default() };
        let time = SeriesStats::new(&series.cpu_ms);
        let (max_range_m, voxel_m) = (HARDEST.max_range, HARDEST.voxel);
        Run {
            system: OURS.into(),
            data: "campus".into(),
            field: field.into(),
            threads,
            max_range_m,
            voxel_m,
            cpu_ms: time,
            wall_ms: time,
            series,
            ..Run::default()
        }
    }

    fn goal<'a>(goals: &'a [Goal], what: &str) -> &'a Goal {
        goals.iter().find(|g| g.what.starts_with(what)).unwrap()
    }

    #[test]
    fn goals_are_compared_with_measurements() {
        let runs = vec![run("tsdf", 1, 12.0), run("tsdf", 2, 6.0), run("occupancy", 1, 120.0)];
        let goals = all(&Suite { runs: runs.clone(), ..Suite::default() });
        assert_eq!((goal(&goals, "TSDF integration").measured, goal(&goals, "TSDF integration").reached), (Some(12.0), "least"));
        assert_eq!(goal(&goals, "2 threads over 1, wall, TSDF").reached, "goal");
        assert_eq!(goal(&goals, "2 threads over 1, wall, occupancy").reached, "not measured");
        assert_eq!(goal(&goals, "occupancy with explicit").reached, "missed");
        assert_eq!(goal(&goals, "time of the last 50 scans over the first 50, TSDF").reached, "goal");
        let quick = all(&Suite { runs, quick: true, ..Suite::default() });
        assert_eq!(goal(&quick, "time of the last 50").reached, "not measured");
        assert_eq!(goal(&quick, "TSDF integration").reached, "least");
    }
}
