//! Results as text tables.

use crate::growth::{Growth, Point, Sweep};
use crate::results::{Machine, Suite};
use crate::run::Run;
use crate::setting::centimetres;

/// Rows under a heading in aligned columns, numbers to the right.
pub(crate) fn aligned(heading: &[&str], rows: &[Vec<String>]) -> String {
    let all = || std::iter::once(heading.iter().map(|h| (*h).to_owned()).collect::<Vec<_>>()).chain(rows.iter().cloned());
    let width = |column: usize| all().filter_map(|row| row.get(column).map(|cell| cell.chars().count())).max().unwrap_or(0);
    let widths: Vec<usize> = (0..heading.len()).map(width).collect();
    let is_number = |column: usize| rows.iter().filter_map(|r| r.get(column)).any(|c| c.starts_with(|c: char| c.is_ascii_digit()));
    let line = |row: Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| match is_number(column) && column > 0 {
            true => format!("{cell:>width$}"),
            false => format!("{cell:<width$}"),
        });
        format!("{}\n", cells.collect::<Vec<_>>().join("  ").trim_end())
    };
    all().map(line).collect()
}

/// A number, or a dash.
pub(crate) fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.decimals$}"))
}

fn pair(a: Option<f64>, b: Option<f64>, decimals: usize) -> String {
    if a.is_none() && b.is_none() { "-".to_owned() } else { format!("{} / {}", number(a, decimals), number(b, decimals)) }
}

pub(crate) fn machine(machine: &Machine, total_s: f64) -> String {
    let load = pair(machine.load_before, machine.load_after, 1);
    format!("{}, {} cores; load before / after: {load}; {total_s:.0} s\n", machine.cpu, machine.cores)
}

/// The runs, the goals, and what was skipped.
pub fn suite(suite: &Suite) -> String {
    let heading = [
        "scans of",
        "setting",
        "field",
        "system",
        "threads",
        "scans",
        "CPU ms, median / p95",
        "wall ms",
        "Hz",
        "peak MB",
        "map MB",
        "submaps",
        "error mm, mean / p90",
        "complete",
    ];
    let rows: Vec<Vec<String>> = suite.runs.iter().map(row).collect();
    let mut text = machine(&suite.machine, suite.total_s);
    text.push_str("CPU and wall: a scan, without decoding. Hz: scans a second, with decoding. MB: 10^6 bytes.\n\n");
    text.push_str(&aligned(&heading, &rows));
    text.push('\n');
    text.push_str(&special(suite));
    text.push_str("Goals (campus, 60 m / 6.5 cm where nothing else is said)\n");
    let goals: Vec<Vec<String>> = suite.goals.iter().map(goal).collect();
    text.push_str(&aligned(&["", "goal", "least", "measured", "", "reached", "best peer before"], &goals));
    suite.skipped.iter().for_each(|s| text.push_str(&format!("{s}\n")));
    text
}

fn row(run: &Run) -> Vec<String> {
    let quality = run.quality.as_ref();
    let mm = |m: Option<f64>| m.map(|m| m * 1e3);
    let scans = if run.scans < run.scans_offered { format!("{} of {}", run.scans, run.scans_offered) } else { run.scans.to_string() };
    let error = quality.map_or_else(|| "-".to_owned(), |q| format!("{} ({} to {})", pair(mm(q.mean_m), mm(q.p90_m), 1), q.of, q.to));
    vec![
        run.data.clone(),
        format!("{} m / {}", run.max_range_m, centimetres(run.voxel_m)),
        run.field.clone(),
        if run.one_submap && run.system == crate::run::OURS { format!("{}, one submap", run.system) } else { run.system.clone() },
        run.threads.to_string(),
        scans,
        pair(run.cpu_ms.median, run.cpu_ms.p95, 1),
        number(run.wall_ms.median, 1),
        number(run.scans_per_s, 1),
        number(run.peak_rss_mb, 0),
        number(run.map_mb, 0),
        run.submaps.map_or_else(|| "-".to_owned(), |n| n.to_string()),
        error,
        quality.and_then(|q| q.complete).map_or_else(|| "-".to_owned(), |c| format!("{:.1} %", c * 100.0)),
    ]
}

fn special(suite: &Suite) -> String {
    let mut text = String::new();
    if let Some(mesh) = &suite.special.mesh {
        text.push_str(&format!("mesh: {} triangles in {:.2} s, one thread\n", mesh.triangles, mesh.extract_s));
    }
    for lap in suite.special.second_lap.iter().chain(&suite.special.second_lap_others) {
        text.push_str(&format!(
            "second lap of {} scans, {}: {:.0} MB, then {:.0} MB ({:+.0} MB, {:+.1} %); {} submaps, then {}; a scan takes {:.2} of the time\n",
            lap.scans,
            lap.system,
            lap.first_mb,
            lap.second_mb,
            lap.second_mb - lap.first_mb,
            lap.added * 100.0,
            lap.first_submaps,
            lap.second_submaps,
            lap.slower
        ));
    }
    if let Some(update) = &suite.special.pose_update {
        text.push_str(&format!("pose update of {} submaps: {} ms\n", update.submaps, pair(update.wall_ms.median, update.wall_ms.p95, 3)));
    }
    text + "\n"
}

fn goal(goal: &crate::goal::Goal) -> Vec<String> {
    let sign = if goal.more_is_better { ">=" } else { "<=" };
    let plain = |v: f64| format!("{sign} {}", (v * 1000.0).round() / 1000.0);
    vec![
        goal.what.clone(),
        plain(goal.goal),
        plain(goal.least),
        number(goal.measured, if goal.measured.is_some_and(|m| m < 10.0) { 2 } else { 1 }),
        goal.unit.to_owned(),
        goal.reached.to_owned(),
        goal.best_peer.to_owned(),
    ]
}

/// The tables of growth, and the cost of a long drive.
pub fn growth(growth: &Growth) -> String {
    let mut text = machine(&growth.machine, growth.total_s);
    text.push_str("One thread; y grows as x to the power of the exponent.\n\n");
    growth.sweeps.iter().for_each(|s| text.push_str(&sweep(s)));
    let heading =
        ["new road", "setting", "field", "scans / km", "CPU s / km", "map MB / km", "disk MB / km", "100 km: core hours", "memory GB", "disk GB"];
    let rows = growth.roads.iter().map(|road| {
        let [hours, memory, disk] = road.drive(100.0).map(|v| format!("{v:.1}"));
        vec![
            format!("{}, {:.0} m", road.data, road.path_m),
            format!("{} m / {}", road.max_range_m, centimetres(road.voxel_m)),
            road.field.clone(),
            format!("{:.0}", road.scans_per_km),
            format!("{:.1}", road.cpu_s_per_km),
            format!("{:.0}", road.map_mb_per_km),
            format!("{:.0}", road.file_mb_per_km),
            hours,
            memory,
            disk,
        ]
    });
    text + &aligned(&heading, &rows.collect::<Vec<_>>())
}

fn sweep(sweep: &Sweep) -> String {
    type Column = (&'static str, usize, fn(&Point) -> Option<f64>, Option<f64>);
    let columns: [Column; 5] = [
        ("CPU ms", 2, |p| p.cpu_ms, sweep.cpu_exponent),
        ("map MB", 1, |p| p.map_mb, sweep.memory_exponent),
        ("peak MB", 0, |p| p.peak_rss_mb, None),
        ("elastic ms", 3, |p| p.elastic_ms, sweep.elastic_exponent),
        ("pose update ms", 4, |p| p.pose_update_ms, sweep.pose_update_exponent),
    ];
    let columns: Vec<Column> = columns.into_iter().filter(|c| sweep.points.iter().any(|p| c.2(p).is_some())).collect();
    let first = format!("{} {}", sweep.of, sweep.unit).trim_end().to_owned();
    let heading: Vec<&str> = std::iter::once(first.as_str()).chain(columns.iter().map(|c| c.0)).collect();
    let mut rows: Vec<Vec<String>> = sweep
        .points
        .iter()
        .map(|p| std::iter::once(p.x.to_string()).chain(columns.iter().map(|&(_, decimals, cost, _)| number(cost(p), decimals))).collect())
        .collect();
    rows.push(std::iter::once("exponent".to_owned()).chain(columns.iter().map(|c| number(c.3, 2))).collect());
    format!("{}, {} ({})\n{}\n", sweep.of, sweep.field, sweep.fixed, aligned(&heading, &rows))
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic_eval::SeriesStats;

    #[test]
    fn columns_are_aligned() {
        let rows = vec![vec!["a".to_owned(), "1.5".to_owned()], vec!["long".to_owned(), "12.5".to_owned()]];
        assert_eq!(aligned(&["name", "ms"], &rows), "name    ms\na      1.5\nlong  12.5\n");
    }

    #[test]
    fn suite_lists_runs_and_skipped_data() {
        let run = Run {
            system: "OctoMap".into(),
            data: "campus".into(),
            voxel_m: 0.065,
            scans: 2,
            scans_offered: 210,
            cpu_ms: SeriesStats::new(&[1.0]),
            ..Run::default()
        };
        let text = suite(&Suite { runs: vec![run], skipped: vec!["skipped: hall: no folder".into()], ..Suite::default() });
        assert!(text.contains("2 of 210") && text.contains("6.5 cm") && text.contains("skipped: hall"), "{text}");
    }
}
