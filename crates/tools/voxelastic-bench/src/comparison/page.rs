//! The page: one table for each question, then what is not on it, and how it was made.

use super::Comparison;
use crate::run::{OURS, Run};
use crate::setting::centimetres;
use crate::slam::SlamRun;
use crate::table::number;
use std::fmt::Write;

/// The comparison as a page of Markdown.
pub fn page(found: &Comparison) -> String {
    let mut text = String::from("# Beside other systems\n\n");
    text.push_str("Made by `voxelastic-bench --comparison docs/comparison.md");
    text.push_str(if found.quick { " --quick`" } else { "`" });
    text.push_str(", in one run and never edited: run it again to change it. ");
    text.push_str(if found.is_complete { "" } else { "**This run was stopped before its end.** " });
    text.push_str("It installs each peer by pip in an environment of its own, and runs it on the same scans as ours, in turn, on one thread.\n\n");
    let machine = &found.machine;
    let load = |load: Option<f64>| number(load, 1);
    let _ = writeln!(
        text,
        "{}: {}; {}, {} cores, load {} before and {} after, {:.0} s without installing.\n",
        found.date,
        found.program,
        machine.cpu,
        machine.cores,
        load(machine.load_before),
        load(machine.load_after),
        found.total_s
    );
    text.push_str("Times are of the processor, median (maps) or mean (trajectories) of a scan, without reading; *x* is a time over ours on the same scans in this run: under other load the times change, and *x* by less. ");
    text.push_str("MB are the peak of the process, 10^6 bytes, Python and its libraries included for peers. Lines of code are those that a user of the peer writes to be given scans and to ask for the result; ours are one command.\n");
    maps(
        &mut text,
        found,
        "tsdf",
        "Surfaces, poses given",
        "Error: of mesh vertices (Open3D: of points) to the world. Complete: the true surface that is visible from nearer than 30 m and has a surface within 5 cm.",
    );
    maps(
        &mut text,
        found,
        "occupancy",
        "Free and occupied space, poses given",
        "Error: of the centres of occupied voxels to the world, so that half a voxel is to be expected.",
    );
    trajectories(&mut text, found);
    closures(&mut text, found);
    moving(&mut text, found);
    if !found.skipped.is_empty() {
        text.push_str("\n## Not on this page\n\n");
        for why in &found.skipped {
            let _ = writeln!(text, "- {why}");
        }
    }
    text.push_str(CONDITIONS);
    text
}

const CONDITIONS: &str = "
## What this does not say

- Everything runs with its defaults, and nobody tuned a peer; KISS-ICP, KISS-SLAM and RETRO-SLAM have voxels of a hundredth of the range, as they choose them for themselves.
- The scans of `hall` are a second apart and those of `kitti00-loops` four metres: that is what was recorded, and not what odometry is made for.
- Pipelines of evalio get the scans in a grid of 64 rows by elevation, since some look for features along rings; their own data sets have the rings of the sensor.
- `campus` and `campus-walk` are simulated by this program; the others are real. A system whose time was up has the number of its scans instead of errors of its map.
";

fn table(text: &mut String, heading: &[&str], rows: impl IntoIterator<Item = Vec<String>>) {
    let mut line = |cells: &[String]| {
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    };
    line(&heading.iter().map(|cell| (*cell).to_owned()).collect::<Vec<_>>());
    line(&heading.iter().map(|_| "---".to_owned()).collect::<Vec<_>>());
    rows.into_iter().for_each(|row| line(&row));
}

fn lines(count: Option<usize>, is_ours: bool) -> String {
    if is_ours { "one command".to_owned() } else { count.map_or_else(String::new, |n| n.to_string()) }
}

/// A number, or nothing.
fn cell(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(String::new, |v| format!("{v:.decimals$}"))
}

fn over(value: Option<f64>, ours: Option<f64>) -> String {
    cell(value.zip(ours).filter(|(_, ours)| *ours > 0.0).map(|(value, ours)| value / ours), 2)
}

fn share(done: usize, offered: usize) -> String {
    if done < offered { format!("{done} of {offered}") } else { done.to_string() }
}

fn maps(text: &mut String, found: &Comparison, field: &str, title: &str, note: &str) {
    let runs: Vec<&Run> = found.maps.iter().filter(|run| run.field == field).collect();
    let Some(first) = runs.first() else { return };
    let _ = writeln!(text, "\n## {title}\n\nRange {} m, voxels of {}. {note}\n", first.max_range_m, centimetres(first.voxel_m));
    let ours = |run: &Run| runs.iter().find(|r| r.system == OURS && r.data == run.data).and_then(|r| r.cpu_ms.median);
    let row = |run: &&Run| {
        let quality = run.quality.as_ref();
        let is_ours = run.system == OURS;
        let error = quality.map_or_else(String::new, |q| format!("{} / {}", cell(q.mean_m.map(|m| m * 1e3), 1), cell(q.p90_m.map(|m| m * 1e3), 1)));
        vec![
            run.data.clone(),
            if is_ours { "**Voxelastic**".to_owned() } else { run.system.clone() },
            share(run.scans, run.scans_offered),
            cell(run.cpu_ms.median, 1),
            over(run.cpu_ms.median, ours(run)),
            cell(run.peak_rss_mb, 0),
            quality.filter(|q| q.to == "mesh").map_or_else(|| error.clone(), |_| format!("{error} (held-out points)")),
            cell(quality.and_then(|q| q.complete).map(|c| c * 100.0), 1),
            lines(run.user_lines, is_ours),
        ]
    };
    table(text, &["scans of", "system", "scans", "CPU ms", "x", "MB", "error mm, mean / 90 %", "complete %", "lines of code"], runs.iter().map(row));
}

fn trajectories(text: &mut String, found: &Comparison) {
    let runs: Vec<&SlamRun> = found.slam.runs.iter().filter(|run| run.task.starts_with("odometry")).collect();
    if runs.is_empty() {
        return;
    }
    text.push_str("\n## Trajectories from the scans alone\n\nAbsolute error after the best rigid alignment; drift over 10 m of path. `campus-walk` has an inertial unit and sweeps whose points have times; what needs such a unit runs there only.\n\n");
    let ours = |run: &SlamRun| runs.iter().find(|r| is_ours(r) && r.data == run.data && r.task == "odometry").and_then(|r| r.cpu_ms);
    let row = |run: &&SlamRun| {
        let name = if is_ours(run) { "**Voxelastic**".to_owned() } else { run.system.clone() };
        let task = run.task.strip_prefix("odometry").unwrap_or_default().trim_start_matches(", ").trim_start();
        vec![
            run.data.clone(),
            if task.is_empty() { name } else { format!("{name} {task}") },
            share(run.scans, run.scans_offered),
            cell(run.cpu_ms, 1),
            over(run.cpu_ms, ours(run)),
            cell(run.peak_rss_mb, 0),
            cell(run.path.map(|p| p.rmse_m), 3),
            cell(run.path.and_then(|p| p.over_10_m), 2),
            lines(run.user_lines, is_ours(run)),
        ]
    };
    table(text, &["scans of", "system", "scans", "CPU ms", "x", "MB", "error m, rms", "drift %", "lines of code"], runs.iter().map(row));
}

fn closures(text: &mut String, found: &Comparison) {
    let runs: Vec<&SlamRun> = found.slam.runs.iter().filter(|run| run.closures.is_some_and(|c| c.revisits > 0)).collect();
    if runs.is_empty() {
        return;
    }
    text.push_str("\n## Loop closures\n\nRight: within 5 m and 0.2 radians of the truth. Missed: scans that come back to a place, with no right closure within 100 m of path.\n\n");
    let row = |run: &&SlamRun| {
        let closures = run.closures.unwrap_or_default();
        vec![
            run.data.clone(),
            if is_ours(run) { "**Voxelastic**".to_owned() } else { run.system.clone() },
            run.task.to_owned(),
            share(run.scans, run.scans_offered),
            closures.right.to_string(),
            closures.wrong.to_string(),
            format!("{} of {}", closures.missed, closures.revisits),
            cell(run.path.map(|p| p.rmse_m), 2),
        ]
    };
    table(text, &["scans of", "system", "from", "scans", "right", "wrong", "missed", "error m, rms"], runs.iter().map(row));
}

fn moving(text: &mut String, found: &Comparison) {
    if found.moving.is_empty() {
        return;
    }
    text.push_str("\n## What moves\n\nTen labelled sweeps of SemanticKITTI 05, poses given. Online: a point is judged when it comes; offline: after all sweeps. Both: the root of the product.\n\n");
    let rows = found.moving.iter().map(|run| {
        let is_ours = run.system.starts_with("Voxelastic");
        let both = (run.static_kept * run.moving_removed).sqrt();
        vec![
            run.system.clone(),
            cell(Some(run.static_kept), 1),
            cell(Some(run.moving_removed), 1),
            cell(Some(both), 1),
            cell(run.cpu_ms, 0),
            lines(run.user_lines, is_ours),
        ]
    });
    table(text, &["system", "static kept %", "moving removed %", "both %", "CPU ms (ours: mapping, too)", "lines of code"], rows.collect::<Vec<_>>());
}

fn is_ours(run: &SlamRun) -> bool {
    run.system.starts_with("Voxelastic")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comparison::MovingRun;
    use crate::slam::{ClosureScore, PathScore, SlamBench};
    use voxelastic_eval::SeriesStats;

    fn map(system: &str, ms: f64) -> Run {
        let cpu_ms = SeriesStats::new(&[ms]);
        Run {
            system: system.into(),
            data: "campus".into(),
            field: "tsdf".into(),
            voxel_m: 0.065,
            scans: 3,
            scans_offered: 3,
            cpu_ms,
            ..Run::default()
        }
    }

    #[test]
    fn a_page_has_ratios_and_what_is_not_on_it() {
        let path = Some(PathScore { rmse_m: 0.25, ..PathScore::default() });
        let odometry =
            |system: &str, ms| SlamRun { system: system.into(), data: "hall".into(), task: "odometry", cpu_ms: Some(ms), path, ..SlamRun::default() };
        let closures = Some(ClosureScore { right: 4, wrong: 0, revisits: 9, missed: 2 });
        let runs = vec![odometry("Voxelastic 0.1.0", 10.0), SlamRun { closures, ..odometry("KISS 1", 45.0) }];
        let found = Comparison {
            maps: vec![map(OURS, 20.0), Run { user_lines: Some(7), ..map("VDBFusion 0.1.6", 50.0) }],
            slam: SlamBench { runs, ..SlamBench::default() },
            moving: vec![MovingRun { system: "DUFOMap, online".into(), static_kept: 81.0, moving_removed: 100.0, ..MovingRun::default() }],
            skipped: vec!["UFOMap: has no package".into()],
            ..Comparison::default()
        };
        let text = page(&found);
        for expected in [
            "| VDBFusion 0.1.6 | 3 | 50.0 | 2.50 |",
            "| KISS 1 | 0 | 45.0 | 4.50 |",
            "| 7 |",
            "| 4 | 0 | 2 of 9 |",
            "| 90.0 |",
            "- UFOMap: has no package",
            "one command",
        ] {
            assert!(text.contains(expected), "{expected} is not in\n{text}");
        }
    }
}
