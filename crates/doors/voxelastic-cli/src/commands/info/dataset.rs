//! Description of a dataset folder.

use super::rows::{Bounds, row};
use crate::args::data::DataArgs;
use serde::Serialize;
use voxelastic::geometry::{Aabb, PoseExt};
use voxelastic_io::dataset;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct DatasetInfo {
    kind: &'static str,
    /// Scans with a pose.
    scans: usize,
    /// Clouds without a pose.
    without_pose: usize,
    loop_edges: usize,
    /// Time of the first and of the last scan, seconds.
    time_s: Option<[f64; 2]>,
    /// Length of the path from scan to scan, metres.
    path_m: f64,
    /// Box around the positions of the scans in the map frame.
    path_bounds_m: Option<Bounds>,
    /// The layout of the folder, in words.
    description: String,
}

/// Describes a folder without decoding its clouds.
pub fn describe(data: &DataArgs) -> anyhow::Result<DatasetInfo> {
    let dataset = dataset::open(data.path(), &data.options(false))?;
    let scans = dataset.scans();
    let mut bounds = Aabb::default();
    scans.iter().for_each(|s| bounds.add(s.t_map_lidar.translation.vector.map(|c| c as f32).into()));
    Ok(DatasetInfo {
        kind: "dataset",
        scans: scans.len(),
        without_pose: dataset.description().without_pose.len(),
        loop_edges: dataset.loop_edges().len(),
        time_s: scans.first().zip(scans.last()).map(|(first, last)| [first.time, last.time]),
        path_m: scans.windows(2).map(|pair| pair[0].t_map_lidar.translation_distance(&pair[1].t_map_lidar)).sum(),
        path_bounds_m: Bounds::of(&bounds),
        description: dataset.description().to_string(),
    })
}

/// The description as rows of a table.
pub fn table(info: &DatasetInfo) -> Vec<(String, String)> {
    let mut rows: Vec<(String, String)> =
        info.description.lines().map(|line| line.split_once(": ").map_or_else(|| row("", line), |(name, value)| row(name, value))).collect();
    rows.push(row("scans to map", info.scans));
    rows.extend(info.time_s.map(|[first, last]| row("time", format!("{first:.3} to {last:.3} s ({:.1} s)", last - first))));
    rows.push(row("path", format!("{:.1} m", info.path_m)));
    rows.extend(info.path_bounds_m.map(|b| row("path of the sensor", b)));
    rows
}
