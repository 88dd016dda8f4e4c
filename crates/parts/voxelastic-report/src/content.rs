//! The content of a report.

use crate::run_log::RunLog;
use crate::surface::Surface;
use serde::Serialize;
use voxelastic_eval::DistanceStats;

/// Everything that a page shows. Absent and empty parts are left out.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Heading.
    pub title: String,
    /// Subtitle: how the map was made.
    pub subtitle: String,
    /// Key figures under the heading.
    pub facts: Vec<Fact>,
    /// The run that made the map.
    pub run: Option<RunLog>,
    /// Period of the sensor, milliseconds: a line in the chart of times.
    pub sensor_period_ms: f64,
    /// Edge of the finest voxel, metres, if known: for the legend of the scales.
    pub voxel: Option<f64>,
    /// Final poses of the scans, sorted by node.
    pub nodes: Vec<Node>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Distances of the map to a reference.
    pub distances: Vec<Distances>,
    /// The surface of each submap; or submaps without a surface, and the one surface of the map, with its [`carriers`](Surface::carriers).
    pub surface: Vec<Surface>,
    /// Error at the end of the colour ramp, metres.
    pub error_max: f32,
    /// Points on things that moved, scan by scan.
    pub moving: Vec<MovingPoints>,
    /// How the map was explored.
    pub exploration: Option<Exploration>,
    /// A planned path.
    pub planned_path: Option<PlannedPath>,
    /// Settings and other details, as names and values.
    pub details: Vec<(String, String)>,
}

impl Report {
    /// A report with a title only.
    pub fn titled(title: impl Into<String>) -> Self {
        Self { title: title.into(), sensor_period_ms: 100.0, error_max: 0.1, ..Self::default() }
    }
}

/// A key figure.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Fact {
    /// What it is.
    pub label: String,
    /// The number.
    pub value: String,
    /// Its unit.
    pub unit: String,
    /// A short note.
    pub note: String,
}

/// A scan on the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Node {
    /// Its node.
    pub node: u64,
    /// Position of the lidar, map frame, metres.
    pub position: [f64; 3],
    /// Its submap.
    pub submap: u32,
}

/// Points of a scan that are on things that move.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MovingPoints {
    /// Its node.
    pub node: u64,
    /// Its submap.
    pub submap: u32,
    /// The points: frame of the submap, metres.
    pub points: Vec<[f32; 3]>,
}

/// How a robot explored: map frame, metres, where the scans are now.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Exploration {
    /// What was known when, in order.
    pub moments: Vec<KnownShare>,
    /// The decisions, in order.
    pub steps: Vec<ExplorationStep>,
}

/// How much is known at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct KnownShare {
    /// Seconds since the start.
    pub time_s: f64,
    /// Distance travelled, metres.
    pub distance_m: f64,
    /// Share of the space that can be known, 0 to 1.
    pub known_share: f64,
}

/// A decision where to go.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ExplorationStep {
    /// Seconds since the start.
    pub time_s: f64,
    /// Distance travelled, metres.
    pub distance_m: f64,
    /// Where the robot was.
    pub position: [f64; 3],
    /// Clusters of the frontier between free and unknown space: centre, and area in square metres.
    pub frontier: Vec<([f64; 3], f64)>,
    /// The path ahead.
    pub path: Vec<[f64; 3]>,
}

/// A table: the first column names the rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// A line under the heading.
    pub note: String,
    /// Headings of the columns, including that of the row names.
    pub columns: Vec<String>,
    /// Cells, row by row.
    pub rows: Vec<Vec<String>>,
}

/// Distances of a map to a reference (paper Fig. 5).
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Distances {
    /// What was measured.
    pub name: String,
    /// Statistics of the distances.
    pub stats: DistanceStats,
}

/// A planned path and its search tree; map frame, metres.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PlannedPath {
    /// The start.
    pub start: Option<[f64; 3]>,
    /// The goal.
    pub goal: Option<[f64; 3]>,
    /// The path, from start to goal; empty when none was found.
    pub path: Vec<[f64; 3]>,
    /// Edges of the search tree.
    pub tree: Vec<[[f64; 3]; 2]>,
}
