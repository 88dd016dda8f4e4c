//! Results of the demo: as JSON, as text, and as a table of the page.

use super::super::eval::Summary;
use serde::Serialize;
use std::path::PathBuf;
use voxelastic_eval::SeriesStats;
use voxelastic_report::content::Table;

/// The keys of `demo --json`.
#[derive(Debug, Serialize)]
pub struct Figures {
    /// Scans mapped.
    pub scans: usize,
    /// Number of loop closures.
    pub loop_closures: usize,
    /// Largest distance between true and odometry pose, metres.
    pub largest_drift_m: f64,
    /// Submaps of the elastic map that were fused into others.
    pub fusions: usize,
    /// Wall time of a scan of the elastic map, both fields, milliseconds.
    pub integrate_ms: SeriesStats,
    /// The measurements.
    pub rows: Vec<Row>,
    /// The folder.
    #[serde(serialize_with = "crate::output::path")]
    pub output: PathBuf,
    /// The page.
    #[serde(serialize_with = "crate::output::path")]
    pub report: PathBuf,
    /// The picture of the elastic map.
    #[serde(serialize_with = "crate::output::path")]
    pub picture: PathBuf,
    /// The picture of both maps from above, that with odometry alone on the left.
    #[serde(serialize_with = "crate::output::path")]
    pub closures: PathBuf,
    /// From start to written page, seconds.
    pub total_s: f64,
    /// Peak resident memory, megabytes (10^6 bytes).
    pub peak_rss_mb: Option<f64>,
}

/// Errors of one field of one map; lengths in metres, fractions from 0 to 1.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Field and poses.
    pub name: &'static str,
    /// Mean distance from the map to the true surface.
    pub accuracy_mean_m: Option<f64>,
    /// 90th percentile of this distance.
    pub accuracy_p90_m: Option<f64>,
    /// Fraction of the true surface visible within range that has map within 10 cm.
    pub complete_10cm: Option<f64>,
    /// Precision of free space.
    pub free_precision: Option<f64>,
    /// Recall of free space.
    pub free_recall: Option<f64>,
    /// Root mean square error of the poses.
    pub pose_rmse_m: Option<f64>,
}

impl Row {
    /// Of one measurement.
    pub fn of(name: &'static str, summary: &Summary) -> Self {
        let exact = summary.surface.as_ref().map(|s| s.accuracy_exact.as_ref().unwrap_or(&s.accuracy));
        let free = summary.occupancy.as_ref().map(|o| &o.free);
        Self {
            name,
            accuracy_mean_m: exact.and_then(|e| e.mean),
            accuracy_p90_m: exact.and_then(|e| e.p90),
            complete_10cm: summary.surface.as_ref().and_then(|s| s.completeness.fraction_under_10cm),
            free_precision: free.and_then(|f| f.precision),
            free_recall: free.and_then(|f| f.recall),
            pose_rmse_m: summary.trajectory.as_ref().and_then(|t| Some(t.ate_in_place.as_ref()?.translation_m.rmse)),
        }
    }

    fn cells(&self) -> Vec<String> {
        let cm = |m: Option<f64>| m.map_or_else(|| "-".to_owned(), |m| format!("{:.1} cm", m * 100.0));
        let share = |s: Option<f64>, digits: usize| s.map_or_else(|| "-".to_owned(), |s| format!("{:.digits$} %", s * 100.0));
        vec![
            self.name.to_owned(),
            cm(self.accuracy_mean_m),
            cm(self.accuracy_p90_m),
            share(self.complete_10cm, 1),
            share(self.free_precision, 2),
            share(self.free_recall, 1),
            cm(self.pose_rmse_m),
        ]
    }
}

/// Titles of the columns of [`Row::cells`].
const COLUMNS: [&str; 7] = ["field and poses", "error, mean", "error, 90 %", "complete", "free, precision", "free, recall", "poses, rmse"];

impl Figures {
    /// With the measurements; the caller fills in the rest.
    pub fn new(rows: Vec<Row>, output: PathBuf, report: PathBuf) -> Self {
        let integrate_ms = SeriesStats::default();
        let [picture, closures] = ["campus.png", "closures.png"].map(|name| output.join(name));
        Self {
            scans: 0,
            loop_closures: 0,
            largest_drift_m: 0.0,
            fusions: 0,
            integrate_ms,
            rows,
            output,
            report,
            picture,
            closures,
            total_s: 0.0,
            peak_rss_mb: None,
        }
    }

    fn note(&self) -> String {
        format!(
            "{} scans of a simulated campus, {} loop closures; the odometry is up to {:.1} m off. Complete: fraction of the surface visible within 30 m \
             that has map within 10 cm.",
            self.scans, self.loop_closures, self.largest_drift_m
        )
    }

    /// The table of the page.
    pub fn for_page(&self) -> Table {
        let columns = COLUMNS.map(str::to_owned).to_vec();
        Table { title: "Measured against the world".into(), note: self.note(), columns, rows: self.rows.iter().map(Row::cells).collect() }
    }

    /// The text for the terminal.
    pub fn table(&self) -> String {
        let mut text = format!("{}\n\n", self.note());
        let header = COLUMNS.map(str::to_owned).to_vec();
        for cells in std::iter::once(header).chain(self.rows.iter().map(Row::cells)) {
            text.push_str(&format!("{:<26}", cells[0]));
            cells[1..].iter().for_each(|c| text.push_str(&format!("{c:>17}")));
            text.push('\n');
        }
        if let (Some(median), Some(p95)) = (self.integrate_ms.median, self.integrate_ms.p95) {
            text.push_str(&format!("\na scan takes {median:.0} ms (median; 95 % within {p95:.0} ms) for both fields"));
        }
        let memory = self.peak_rss_mb.map_or_else(String::new, |mb| format!(", {mb:.0} MB"));
        let (page, folder) = (self.report.display(), self.output.display());
        text.push_str(&format!(
            "\n{:.0} s in all{memory}\n\nOpen   {page}   in a browser; {} and {} are pictures.\n",
            self.total_s,
            self.picture.display(),
            self.closures.display()
        ));
        text.push_str(&format!("The maps are {folder}/elastic.vox and {folder}/odometry.vox, for voxelastic mesh, render, info, eval.\n"));
        text
    }
}
