//! Results of `voxelastic eval`.

use super::path::TrajectoryErrors;
use serde::Serialize;
use std::path::PathBuf;
use voxelastic::Pose;
use voxelastic_eval::layers::Layers;
use voxelastic_eval::metrics::Comparison;
use voxelastic_eval::occupancy::OccupancyScores;
use voxelastic_ground::FloorScores;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// The measured map, mesh or cloud.
    #[serde(serialize_with = "crate::output::path")]
    pub map: PathBuf,
    /// Submaps that were left out because they are damaged.
    pub submaps_damaged: usize,
    /// The truth.
    #[serde(serialize_with = "crate::output::path")]
    pub truth: PathBuf,
    /// `cloud`, `mesh`, `world` or `poses`.
    pub truth_kind: &'static str,
    /// Measured points: `vertices` of a mesh, `points` of a cloud, occupied `voxels`; `null` if only poses were measured.
    pub measured: Option<&'static str>,
    /// Distances; `null` if the truth has no surface.
    pub surface: Option<Comparison>,
    /// Surfaces on top of each other; `null` unless a mesh was measured.
    pub layers: Option<Layers>,
    /// Maximum range for completeness and occupancy, metres; only for a world.
    pub max_range_m: Option<f32>,
    /// Free and occupied space; `null` without a world, or without occupancy in the map.
    pub occupancy: Option<OccupancyScores>,
    /// The floor and 2-D maps of it; `null` without a world, or without occupancy in the map.
    pub floor: Option<FloorScores>,
    /// Errors of the poses; `null` if the truth has no poses of scans in the map.
    pub trajectory: Option<TrajectoryErrors>,
    /// The file of `--error-ply`.
    #[serde(serialize_with = "crate::output::optional_path")]
    pub error_ply: Option<PathBuf>,
    /// Total time, seconds.
    pub total_s: f64,
    /// Maps map coordinates to truth coordinates.
    #[serde(skip)]
    pub t_truth_map: Pose,
}
