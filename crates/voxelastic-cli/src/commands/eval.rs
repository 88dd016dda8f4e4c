//! `voxelastic eval`: how far a map is from the truth, what it misses, and how good its poses were.

mod measured;
pub mod path;
mod space;
mod table;
pub mod truth;

use crate::failure::{self, Failure};
use crate::meshing::SurfaceArgs;
use crate::output;
use anyhow::Context;
use clap::{Args, ValueEnum};
use measured::Measured;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use truth::{Limits, TrueSurface, Truth};
use voxelastic::Pose;
use voxelastic_eval::align::{AlignSettings, align};
use voxelastic_eval::colour::error_colours;
use voxelastic_eval::metrics::{CompareSettings, Comparison, compare};
use voxelastic_eval::occupancy::OccupancyScores;
use voxelastic_io::mesh_io::{MeshRef, write_ply};

/// Measure a map, mesh or cloud against the truth
///
/// Against a survey (a cloud or mesh), as in the paper: all submaps are fused into one TSDF, the vertices of its mesh are aligned to the truth
/// (point-to-plane ICP), the truth is thinned to 5 cm, and distances go from point to nearest point. A truth mesh gives exact distances too.
///
/// Against a simulated folder, or its world.toml: distances to the world are exact, completeness counts what the sensor could see, free and
/// occupied space are judged, and the map's poses are compared with the true ones. Nothing is aligned: map and world have one frame.
///
/// Against any other folder of scans: the poses alone, scan by scan. The true ones are those in the file that calls itself ground truth, or in
/// the one that --poses names.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic eval quad.vox --truth survey.ply                 a map against a survey, aligned to it
  voxelastic eval quad.ply --truth survey.pcd --error-ply errors.ply
  voxelastic eval campus.vox --truth campus                   against the world that was simulated into campus
  voxelastic eval campus.vox --truth campus --field occupancy --max-range 20
  voxelastic eval kitti00.vox --truth kitti00                 the poses used, against the ground truth poses in kitti00
  voxelastic eval kitti00.vox --truth kitti00 --poses gps.tum the same, where the name does not say which are true
  voxelastic eval quad.vox --truth survey.ply --thresholds 0.05,0.2 --json")]
pub struct EvalArgs {
    /// The map; or a mesh or cloud (.ply, .pcd, .bin) of anyone's making
    #[arg(value_name = "MAP.vox|MESH|CLOUD")]
    map: PathBuf,
    /// What is true: a cloud, a mesh, a simulated folder or its world.toml, or a folder with ground truth poses
    #[arg(long, value_name = "CLOUD|MESH|DIR|world.toml")]
    truth: PathBuf,
    /// Which pose file of the folder after --truth is true: a path, a name, or a part of one [default: the one called ground truth]
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Compare as they lie, where the truth is a cloud or mesh in the frame of the map
    #[arg(long)]
    no_align: bool,
    /// Align to a simulated world, too: for poses whose first is not the true one
    #[arg(long, conflicts_with = "no_align")]
    align: bool,
    /// Distances at which precision, recall and F-score are given, metres
    #[arg(long, value_name = "M,..", value_delimiter = ',', default_value = "0.05,0.1,0.2,0.5", value_parser = length)]
    thresholds: Vec<f32>,
    /// Simulated truth farther from the sensor than this does not count for completeness and occupancy, metres
    #[arg(long, value_name = "M", default_value_t = Limits::default().max_range, value_parser = length)]
    max_range: f32,
    /// The truth is thinned to one point in each cube of this edge, metres
    #[arg(long, value_name = "M", default_value_t = Limits::default().truth_voxel, value_parser = length, hide_short_help = true)]
    truth_voxel: f32,
    /// Measure accuracy at this many points of the map at most, evenly taken from all
    #[arg(long, value_name = "N", default_value_t = usize::MAX, hide_default_value = true, hide_short_help = true, conflicts_with = "error_ply")]
    max_points: usize,
    /// What of a map is measured [default: tsdf where the map has it, else occupancy; and free and occupied space]
    #[arg(long, value_enum)]
    field: Option<Field>,
    /// Measure the meshes of the submaps as `voxelastic mesh` writes them, instead of fusing the submaps first
    #[arg(long)]
    no_fuse: bool,
    /// Write what was measured, coloured by its error: teal is none, dark red --error-max and more
    #[arg(long, value_name = "FILE.ply")]
    error_ply: Option<PathBuf>,
    /// Error at the end of the colours of --error-ply, metres
    #[arg(long, value_name = "M", default_value_t = 0.1, value_parser = length, requires = "error_ply")]
    error_max: f32,
    /// Print one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    surface: SurfaceArgs,
}

/// What of a map is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Field {
    /// Vertices of the mesh of the TSDF
    Tsdf,
    /// Centres of the occupied voxels
    Occupancy,
}

impl EvalArgs {
    /// What `eval MAP --truth TRUTH` measures.
    pub fn of(map: &Path, truth: &Path) -> Self {
        Self {
            map: map.to_owned(),
            truth: truth.to_owned(),
            poses: None,
            no_align: false,
            align: false,
            thresholds: CompareSettings::default().thresholds,
            max_range: Limits::default().max_range,
            truth_voxel: Limits::default().truth_voxel,
            max_points: usize::MAX,
            field: None,
            no_fuse: false,
            error_ply: None,
            error_max: 0.1,
            json: false,
            surface: SurfaceArgs::default(),
        }
    }

    /// The same for one field of the map.
    pub fn with_field(self, field: Field) -> Self {
        Self { field: Some(field), ..self }
    }

    /// The same with accuracy measured at `most` points of the map.
    pub fn with_max_points(self, most: usize) -> Self {
        Self { max_points: most, ..self }
    }

    /// What of the truth counts.
    pub fn limits(&self) -> Limits {
        Limits { truth_voxel: self.truth_voxel, max_range: self.max_range, ..Limits::default() }
    }
}

fn length(text: &str) -> Result<f32, String> {
    let wrong = || "must be a length in metres, from 0.001 to 1000".to_owned();
    text.trim().parse().ok().filter(|m| (0.001..=1000.0).contains(m)).ok_or_else(wrong)
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    map: PathBuf,
    truth: PathBuf,
    /// `cloud`, `mesh`, `world` or `poses`.
    truth_kind: &'static str,
    /// What was measured: `vertices` of a mesh, `points` of a cloud, `voxels` that are occupied; `null` when only poses were.
    pub measured: Option<&'static str>,
    /// Distances; `null` when the truth has no surface.
    pub surface: Option<Comparison>,
    /// How far from the sensor true surface counts for completeness and occupancy, metres; only for a world.
    max_range_m: Option<f32>,
    /// Free and occupied space; `null` without a world, or without occupancy in the map.
    pub occupancy: Option<OccupancyScores>,
    /// Errors of the poses; `null` where the truth has none, or none that belongs to the map.
    pub trajectory: Option<path::TrajectoryErrors>,
    error_ply: Option<PathBuf>,
    total_s: f64,
    /// Maps map to truth coordinates.
    #[serde(skip)]
    pub t_truth_map: Pose,
}

/// Measures.
pub fn run(args: &EvalArgs) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let pool = args.surface.pool()?;
    let mut summary = pool.install(|| measure(args))?;
    summary.total_s = clock.elapsed().as_secs_f64();
    if args.json {
        output::print_json(&summary)?;
    } else {
        output::print(&table::table(&summary))?;
    }
    Ok(failure::DONE)
}

fn measure(args: &EvalArgs) -> anyhow::Result<Summary> {
    let measured = Measured::open(args)?;
    let truth = Truth::open(&args.truth, args.poses.as_deref(), &args.limits())?;
    against_truth(args, measured, &truth)
}

/// Measures the map that `args` names against a truth that was opened before, for one truth and several maps.
pub fn measure_against(args: &EvalArgs, truth: &Truth) -> anyhow::Result<Summary> {
    against_truth(args, Measured::open(args)?, truth)
}

fn against_truth(args: &EvalArgs, mut measured: Measured, truth: &Truth) -> anyhow::Result<Summary> {
    let mut summary = Summary {
        map: args.map.clone(),
        truth: args.truth.clone(),
        truth_kind: truth.kind,
        measured: None,
        surface: None,
        max_range_m: truth.simulation.as_ref().map(|_| args.max_range),
        occupancy: None,
        trajectory: None,
        error_ply: None,
        total_s: 0.0,
        t_truth_map: Pose::identity(),
    };
    if let Some(map) = measured.map() {
        summary.trajectory = path::compare(&map.atlas, truth)?;
    }
    if let Some(surface) = &truth.surface {
        let points = measured.surface(args)?;
        let found = against(&points, surface, truth.simulation.is_some(), args)?;
        summary.t_truth_map = found.t_truth_map;
        summary.measured = Some(points.what);
        if let Some(path) = &args.error_ply {
            write_errors(path, &points, &found.errors, args.error_max)?;
            summary.error_ply = Some(path.clone());
        }
        summary.surface = Some(found);
    } else if args.error_ply.is_some() {
        let what = format!("{}: no surface to measure errors from, only poses", args.truth.display());
        return Err(Failure::usage(what, "leave out --error-ply, or give a cloud, a mesh or a simulated folder as --truth").into());
    }
    let wants_space = args.field != Some(Field::Tsdf);
    if let (Some(simulation), Some(map)) =
        (truth.simulation.as_ref().filter(|_| wants_space), measured.map().filter(|m| measured::has_occupancy(&m.atlas)))
    {
        summary.occupancy = Some(space::score(&space::Task { simulation, map, t_truth_map: summary.t_truth_map, max_range: args.max_range }));
    }
    Ok(summary)
}

/// The comparison of surfaces.
fn against(points: &measured::Surface, truth: &TrueSurface, is_world: bool, args: &EvalArgs) -> anyhow::Result<Comparison> {
    let aligned = if is_world { args.align } else { !args.no_align };
    let who = || format!("cannot compare {} (the source, or map) with {} (the target, or truth)", args.map.display(), args.truth.display());
    if !aligned {
        // One step that is thrown away: for what it says of units and of clouds that lie apart.
        let look = AlignSettings { voxels: vec![1.0], max_iterations: 1, ..AlignSettings::default() };
        align(&points.positions, &truth.points, &look).with_context(who)?;
    }
    let settings = CompareSettings {
        align: aligned.then(AlignSettings::default),
        truth_voxel: args.truth_voxel,
        most_points: args.max_points,
        thresholds: args.thresholds.clone(),
        ..CompareSettings::default()
    };
    tracing::info!("measuring {} {} against {} points of the truth", points.positions.len(), points.what, truth.points.len());
    compare(points.as_map()?, &truth.as_truth(), &settings).with_context(who)
}

fn write_errors(path: &Path, points: &measured::Surface, errors: &[f32], worst: f32) -> anyhow::Result<()> {
    let colours = error_colours(errors, worst);
    let file = MeshRef { positions: &points.positions, colours: Some(&colours), triangles: &points.triangles, ..MeshRef::default() };
    write_ply(path, &file).with_context(|| format!("cannot write the coloured errors to {}", path.display()))?;
    tracing::info!("errors in colour, up to {worst} m: {}", path.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_metres_within_reason() {
        assert_eq!(length("0.05"), Ok(0.05));
        assert!(["0", "-1", "nan", "inf", "five", ""].iter().all(|t| length(t).unwrap_err().contains("metres")));
    }
}
