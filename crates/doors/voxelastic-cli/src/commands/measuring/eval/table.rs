//! Results as text.

use super::summary::Summary;
use voxelastic_eval::DistanceStats;
use voxelastic_eval::metrics::Comparison;
use voxelastic_eval::occupancy::{OccupancyScores, Score};
use voxelastic_ground::FloorScores;

/// Tables of all results that are present.
pub fn table(summary: &Summary) -> String {
    let mut text = String::new();
    if let Some(surface) = &summary.surface {
        distances(&mut text, summary, surface);
    }
    if let Some(layers) = &summary.layers {
        let (single, reach) = (100.0 * layers.single, 100.0 * layers.reach_m);
        text.push_str(&format!(
            "\none layer within {reach:.0} cm at {single:.1} % of the places, {:.2} on average; {:.0} m2\n",
            layers.mean, layers.area_m2
        ));
    }
    if let Some(scores) = &summary.occupancy {
        space(&mut text, scores, summary.max_range_m);
    }
    if let Some(scores) = &summary.floor {
        floor(&mut text, scores);
    }
    if let Some(errors) = &summary.trajectory {
        section(&mut text, &format!("poses of {} scans", errors.ate.pairs), &["mean", "rmse", "max"]);
        let stats = [Some(("not aligned", &errors.ate_in_place)).and_then(|(n, a)| Some((n, a.as_ref()?))), Some(("aligned", &errors.ate))];
        for (name, ate) in stats.into_iter().flatten() {
            let t = &ate.translation_m;
            row(&mut text, name, &[metres(Some(t.mean)), metres(Some(t.rmse)), metres(Some(t.max))]);
        }
        if let Some(rpe) = &errors.rpe {
            let t = &rpe.translation_m;
            row(&mut text, "over 10 m", &[metres(Some(t.mean)), metres(Some(t.rmse)), metres(Some(t.max))]);
            let r = &rpe.rotation_deg;
            row(&mut text, "rotation over 10 m", &[r.mean, r.rmse, r.max].map(|a| format!("{a:.3} deg")));
        }
    }
    if text.is_empty() {
        text.push_str("nothing to compare: the truth has no surface, and no pose of a scan in the map\n");
    }
    text
}

fn distances(text: &mut String, summary: &Summary, c: &Comparison) {
    if let Some(a) = &c.alignment {
        let [x, y, z] = a.translation;
        let angle = 2.0 * a.quaternion[3].abs().min(1.0).acos().to_degrees();
        let fit = &a.quality;
        let overlap = 100.0 * fit.overlap;
        text.push_str(&format!("aligned: translation ({x:.3}, {y:.3}, {z:.3}) m, rotation {angle:.2} deg; {overlap:.0} % overlap\n"));
        if !fit.converged || fit.undetermined > 0 {
            text.push_str("  (uncertain: the alignment did not converge, or the geometry does not determine all directions)\n");
        }
        text.push('\n');
    }
    let what = summary.measured.unwrap_or("points");
    section(text, &format!("{} {what}, metres", c.map_points), &["mean", "median", "90 %", "< 5 cm", "< 10 cm", "< 50 cm"]);
    let mut line = |name: &str, d: &DistanceStats| {
        let fractions = [d.fraction_under_5cm, d.fraction_under_10cm, d.fraction_under_50cm].map(percent);
        row(text, name, &[[d.mean, d.median, d.p90].map(metres).to_vec(), fractions.to_vec()].concat());
    };
    if let Some(exact) = &c.accuracy_exact {
        line("to the truth", exact);
    }
    line("to its points", &c.accuracy);
    line("truth to map", &c.completeness);
    let within = summary.max_range_m.map_or_else(String::new, |m| format!(" within {m} m"));
    text.push_str(&format!("  ({} points of the truth, {}{within} count for truth to map)\n\n", c.truth_points, c.visible_points));
    section(text, "within", &["precision", "recall", "F-score"]);
    for f in &c.f_scores {
        row(text, &format!("{} m", f.threshold_m), &[f.precision, f.recall, f.f_score].map(|s| percent(Some(s))));
    }
    text.push('\n');
}

fn space(text: &mut String, scores: &OccupancyScores, within: Option<f32>) {
    let within = within.map_or_else(String::new, |m| format!(" within {m} m"));
    section(text, &format!("{} points{within}", scores.points), &["precision", "recall"]);
    for (name, s) in [("free", &scores.free), ("occupied", &scores.occupied)] {
        let Score { precision, recall, .. } = s;
        row(text, name, &[percent(*precision), percent(*recall)]);
    }
    let unknown = percent(Some(scores.unknown as f64 / scores.points.max(1) as f64));
    text.push_str(&format!("  ({unknown} unknown; {} free inside of solids)\n\n", scores.deep_false_free));
}

fn floor(text: &mut String, scores: &FloorScores) {
    let FloorScores { storeys, resolution_m, free, occupied, .. } = scores;
    section(text, &format!("2-D maps of {storeys} storeys"), &["cells", "wrong", "by a voxel"]);
    row(text, "free", &[free, &scores.free_but_blocked, &scores.free_but_deep].map(usize::to_string));
    row(text, "occupied", &[occupied, &scores.occupied_but_clear, &scores.occupied_but_far].map(usize::to_string));
    let (median, p95, within) = (metres(Some(scores.height_median_m)), metres(Some(scores.height_p95_m)), percent(Some(scores.within_two_sigma)));
    let holes = scores.free_but_no_floor;
    text.push_str(&format!("  (cells of {resolution_m} m; {holes} free without a floor; height of the floor off by {median} m, 95 % by less than {p95} m, {within} within 2 sigma)\n\n"));
}

fn section(text: &mut String, title: &str, columns: &[&str]) {
    row(text, title, &columns.iter().map(|c| (*c).to_owned()).collect::<Vec<_>>());
}

fn row(text: &mut String, name: &str, values: &[String]) {
    text.push_str(&format!("{name:<28}"));
    values.iter().for_each(|v| text.push_str(&format!("{v:>11}")));
    text.push('\n');
}

fn metres(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |m| format!("{m:.4}"))
}

fn percent(part: Option<f64>) -> String {
    part.map_or_else(|| "-".to_owned(), |p| format!("{:.1} %", p * 100.0))
}
