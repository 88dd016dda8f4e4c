//! What is aimed at, the least that will do, and what was reached: the project's own bar, on the campus at the hardest setting.

use crate::figures::last_over_first;
use crate::run::{OURS, Run};
use crate::setting::{HARD, SETTINGS};
use crate::suite::Suite;
use serde::Serialize;

/// One line of the bar.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Goal {
    /// What is measured.
    pub what: String,
    /// Its unit.
    pub unit: &'static str,
    /// What is aimed at.
    pub goal: f64,
    /// The least that will do.
    pub least: f64,
    /// Whether more is better.
    pub more_is_better: bool,
    /// What was measured; `null` where nothing was.
    pub measured: Option<f64>,
    /// `goal`, `least`, `missed` or `not measured`.
    pub reached: &'static str,
    /// The best peer, as measured before on a machine of this kind.
    pub best_peer: &'static str,
}

/// A bar before anything is held against it.
struct Bar(&'static str, &'static str, [f64; 2], &'static str);

impl Bar {
    fn at_most(self, measured: Option<f64>) -> Goal {
        self.against(measured, false)
    }

    fn at_least(self, measured: Option<f64>) -> Goal {
        self.against(measured, true)
    }

    fn against(self, measured: Option<f64>, more_is_better: bool) -> Goal {
        let Self(what, unit, [goal, least], best_peer) = self;
        let reaches = |bar: f64| measured.is_some_and(|m| if more_is_better { m >= bar } else { m <= bar });
        let reached = match measured {
            None => "not measured",
            Some(_) if reaches(goal) => "goal",
            Some(_) if reaches(least) => "least",
            Some(_) => "missed",
        };
        Goal { what: what.to_owned(), unit, goal, least, more_is_better, measured, reached, best_peer }
    }
}

/// Finds our runs.
struct Ours<'a>(&'a [Run]);

impl Ours<'_> {
    fn find(&self, data: &str, field: &str, threads: usize, one_submap: bool) -> Option<&Run> {
        let is_it = |r: &&Run| {
            let hard = r.max_range_m == HARD.max_range && r.voxel_m == HARD.voxel;
            r.system == OURS && hard && (r.data.as_str(), r.field.as_str(), r.threads, r.one_submap) == (data, field, threads, one_submap)
        };
        self.0.iter().find(is_it)
    }

    fn campus(&self, field: &str) -> Option<&Run> {
        self.find("campus", field, 1, false)
    }

    /// 95th percentile of the processor time over its median.
    fn spread(&self, field: &str) -> Option<f64> {
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

/// All goals, with what `suite` measured.
pub(crate) fn all(suite: &Suite) -> Vec<Goal> {
    let ours = Ours(&suite.runs);
    // A first look sees too little of the campus to be held against a bar on the whole.
    let whole = if suite.quick { Ours(&[]) } else { Ours(&suite.runs) };
    let mut goals = speed(&ours);
    goals.extend(memory_and_error(&whole, suite));
    goals.extend(over_time(&whole, suite));
    goals.extend(other_settings(&whole));
    goals.extend(real(&whole));
    goals
}

fn speed(ours: &Ours<'_>) -> Vec<Goal> {
    let median = |field: &str| ours.campus(field)?.cpu_ms.median;
    vec![
        Bar("TSDF integration, median, one thread", "ms CPU", [8.0, 15.0], "VDBFusion 44").at_most(median("tsdf")),
        Bar("occupancy with explicit free space, median, one thread", "ms CPU", [30.0, 100.0], "UFOMap coarse 332").at_most(median("occupancy")),
        Bar("p95 over median, TSDF", "", [1.5, 2.0], "").at_most(ours.spread("tsdf")),
        Bar("p95 over median, occupancy", "", [1.5, 2.0], "").at_most(ours.spread("occupancy")),
        Bar("2 threads over 1, wall, TSDF", "x", [1.8, 1.6], "supereight2 1.9").at_least(ours.speedup("tsdf")),
        Bar("2 threads over 1, wall, occupancy", "x", [1.8, 1.6], "wavemap 2.2").at_least(ours.speedup("occupancy")),
    ]
}

fn memory_and_error(ours: &Ours<'_>, suite: &Suite) -> Vec<Goal> {
    let peak = |field: &str, one: bool| ours.find("campus", field, 1, one)?.peak_rss_mb;
    let error = |one: bool| Some(ours.find("campus", "tsdf", 1, one)?.quality.as_ref()?.mean_m? * 1e3);
    let complete = |one: bool| Some(ours.find("campus", "tsdf", 1, one)?.quality.as_ref()?.complete? * 100.0);
    let (error_bar, complete_bar) = ([9.0, 12.0], [98.0, 96.0]);
    vec![
        Bar("peak memory, TSDF", "MB", [200.0, 300.0], "VDBFusion 926").at_most(peak("tsdf", false)),
        Bar("peak memory, TSDF, one submap", "MB", [200.0, 300.0], "VDBFusion 926").at_most(peak("tsdf", true)),
        Bar("peak memory, occupancy", "MB", [250.0, 350.0], "UFOMap coarse 524 (102 scans)").at_most(peak("occupancy", false)),
        Bar("peak memory, occupancy, one submap", "MB", [250.0, 350.0], "UFOMap coarse 524 (102 scans)").at_most(peak("occupancy", true)),
        Bar("surface error, mean, TSDF", "mm", error_bar, "VDBFusion 9").at_most(error(false)),
        Bar("surface error, mean, TSDF, one submap", "mm", error_bar, "VDBFusion 9").at_most(error(true)),
        Bar("completeness within 5 cm, visible below 30 m", "%", complete_bar, "VDBFusion 97.8").at_least(complete(false)),
        Bar("completeness, one submap", "%", complete_bar, "VDBFusion 97.8").at_least(complete(true)),
        Bar("mesh of everything, one thread", "s", [1.0, 2.0], "supereight2 3.1").at_most(suite.elastic.mesh.as_ref().map(|m| m.extract_s)),
    ]
}

fn over_time(ours: &Ours<'_>, suite: &Suite) -> Vec<Goal> {
    let added = suite.elastic.second_lap.as_ref().map(|lap| lap.added * 100.0);
    let later = |field: &str| last_over_first(&ours.campus(field)?.series.cpu_ms, 50);
    let update = suite.elastic.pose_update.as_ref().filter(|u| u.submaps == 1000).and_then(|u| u.wall_ms.median);
    vec![
        Bar("second lap: added memory, TSDF", "%", [3.0, 5.0], "").at_most(added),
        Bar("time of the last 50 scans over the first 50, TSDF", "x", [1.1, 1.25], "").at_most(later("tsdf")),
        Bar("time of the last 50 scans over the first 50, occupancy", "x", [1.1, 1.25], "").at_most(later("occupancy")),
        Bar("pose update of 1,000 submaps", "ms", [0.2, 1.0], "").at_most(update),
    ]
}

/// At the coarser settings: to be faster than every peer that maps as much.
fn other_settings(ours: &Ours<'_>) -> Vec<Goal> {
    let median = |setting: usize, field: &str| {
        let setting = SETTINGS[setting];
        let is_it = |r: &&Run| r.system == OURS && r.data == "campus" && r.field == field && r.threads == 1 && !r.one_submap;
        let run = ours.0.iter().filter(is_it).find(|r| r.max_range_m == setting.max_range && r.voxel_m == setting.voxel)?;
        run.cpu_ms.median
    };
    vec![
        Bar("60 m / 26 cm, TSDF, median, one thread", "ms CPU", [22.0, 22.0], "VDBFusion 22").at_most(median(1, "tsdf")),
        Bar("60 m / 26 cm, occupancy, median, one thread", "ms CPU", [14.0, 14.0], "UFOMap coarse 14, Bonxai 32").at_most(median(1, "occupancy")),
        Bar("20 m / 26 cm, TSDF, median, one thread", "ms CPU", [15.0, 15.0], "VDBFusion 15").at_most(median(2, "tsdf")),
        Bar("20 m / 26 cm, occupancy, median, one thread", "ms CPU", [8.0, 8.0], "UFOMap coarse 8, Bonxai 12").at_most(median(2, "occupancy")),
    ]
}

/// On real scans, decoding included, on two threads.
fn real(ours: &Ours<'_>) -> Vec<Goal> {
    let rate = |data: &str, field: &str| ours.rate(data, field);
    vec![
        Bar("hall, TSDF, decoding included, 2 threads", "Hz", [30.0, 30.0], "").at_least(rate("hall", "tsdf")),
        Bar("hall, occupancy, decoding included, 2 threads", "Hz", [10.0, 10.0], "").at_least(rate("hall", "occupancy")),
        Bar("street, TSDF, decoding included, 2 threads", "Hz", [30.0, 30.0], "").at_least(rate("street", "tsdf")),
        Bar("street, occupancy, decoding included, 2 threads", "Hz", [10.0, 10.0], "").at_least(rate("street", "occupancy")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Series;
    use voxelastic_eval::Spread;

    fn run(field: &str, threads: usize, ms: f64) -> Run {
        let series = Series { cpu_ms: vec![ms; 100], ..Series::default() };
        let time = Spread::of(&series.cpu_ms);
        let (max_range_m, voxel_m) = (HARD.max_range, HARD.voxel);
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
    fn goals_are_met_or_not() {
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
