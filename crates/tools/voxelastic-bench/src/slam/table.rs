//! The results as a table.

use super::results::{SlamBench, SlamRun};
use crate::table::{aligned, machine, number};

/// Runs by recording, then what was left out.
pub fn table(bench: &SlamBench) -> String {
    let heading =
        ["data", "task", "system", "scans", "absolute m, rms", "mean", "over 10 m %", "over 50 m %", "CPU ms", "closures right", "wrong", "missed"];
    let mut text = machine(&bench.machine, bench.total_s);
    text.push_str("Absolute: after the best alignment. CPU: mean of a scan, one thread, without reading. Missed: revisiting scans without a right closure within 100 m.\n\n");
    text.push_str(&aligned(&heading, &bench.runs.iter().map(row).collect::<Vec<_>>()));
    bench.skipped.iter().for_each(|line| text.push_str(&format!("\n{line}")));
    text.push('\n');
    text
}

fn row(run: &SlamRun) -> Vec<String> {
    let count = |n: Option<usize>| n.map_or_else(|| "-".to_owned(), |n| n.to_string());
    let scans = if run.scans == run.scans_offered { run.scans.to_string() } else { format!("{} of {}", run.scans, run.scans_offered) };
    vec![
        run.data.clone(),
        run.task.to_owned(),
        run.system.clone(),
        scans,
        number(run.path.map(|p| p.rmse_m), 3),
        number(run.path.map(|p| p.mean_m), 3),
        number(run.path.and_then(|p| p.over_10_m), 2),
        number(run.path.and_then(|p| p.over_50_m), 2),
        number(run.cpu_ms, 1),
        count(run.closures.map(|c| c.right)),
        count(run.closures.map(|c| c.wrong)),
        run.closures.map_or_else(|| "-".to_owned(), |c| format!("{} of {}", c.missed, c.revisits)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slam::score::{ClosureScore, PathScore};

    #[test]
    fn what_is_not_known_is_a_dash() {
        let path = PathScore { rmse_m: 1.25, mean_m: 1.0, over_10_m: Some(0.5), over_50_m: None };
        let closures = ClosureScore { right: 3, wrong: 1, revisits: 9, missed: 2 };
        let run = SlamRun { system: "A".into(), path: Some(path), closures: Some(closures), scans: 5, scans_offered: 7, ..SlamRun::default() };
        let text = table(&SlamBench { runs: vec![run], skipped: vec!["B is left out".into()], ..SlamBench::default() });
        assert!(text.contains("5 of 7") && text.contains("1.250") && text.contains("2 of 9") && text.contains("B is left out"), "{text}");
        assert!(text.contains(" -  "), "{text}");
    }
}
