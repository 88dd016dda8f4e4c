//! What is on the page.

use crate::run_log::RunLog;
use crate::surface::Surface;
use serde::Serialize;
use voxelastic_eval::DistanceStats;

/// Everything that a page shows. What is absent or empty is left out of the page.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Heading.
    pub title: String,
    /// The line under it: how the map was made.
    pub subtitle: String,
    /// Large numbers under the heading.
    pub facts: Vec<Fact>,
    /// The run that made the map.
    pub run: Option<RunLog>,
    /// Time between two scans of the sensor, milliseconds: the line in the chart of times.
    pub sensor_period_ms: f64,
    /// Edge of the finest voxel, metres, if known: for the colours of the scales.
    pub voxel: Option<f64>,
    /// Final poses of the scans, in the order of their nodes.
    pub nodes: Vec<Node>,
    /// Tables of figures.
    pub tables: Vec<Table>,
    /// Distances of the map from a truth.
    pub distances: Vec<Distances>,
    /// The surface, submap by submap.
    pub surface: Vec<Surface>,
    /// Error at the end of the colours, metres.
    pub error_max: f32,
    /// A planned path.
    pub plan: Option<PlannedPath>,
    /// Settings and other details, as names and values.
    pub details: Vec<(String, String)>,
}

impl Report {
    /// A page with nothing but a heading.
    pub fn titled(title: impl Into<String>) -> Self {
        Self { title: title.into(), sensor_period_ms: 100.0, error_max: 0.1, ..Self::default() }
    }
}

/// A number that is to be seen first.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Fact {
    /// What it is.
    pub label: String,
    /// The number.
    pub value: String,
    /// Its unit.
    pub unit: String,
    /// A word about it.
    pub note: String,
}

/// A scan on the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Node {
    /// Its node.
    pub node: u64,
    /// Position of the lidar, map frame, metres.
    pub position: [f64; 3],
    /// The submap that it is in.
    pub submap: u32,
}

/// A table: the first column names the rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// A line under it.
    pub note: String,
    /// Names of the columns; that of the row names first.
    pub columns: Vec<String>,
    /// Cells, row by row.
    pub rows: Vec<Vec<String>>,
}

/// Distances of a map from a truth (paper Fig. 5).
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Distances {
    /// What was measured.
    pub name: String,
    /// The distances in numbers.
    pub stats: DistanceStats,
}

/// A planned path and the tree that it was found in; map frame, metres.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PlannedPath {
    /// Where it starts.
    pub start: Option<[f64; 3]>,
    /// Where it is to lead.
    pub goal: Option<[f64; 3]>,
    /// The path, from start to goal; empty when none was found.
    pub path: Vec<[f64; 3]>,
    /// Edges of the search tree.
    pub tree: Vec<[[f64; 3]; 2]>,
}
