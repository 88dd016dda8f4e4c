//! `voxelastic report`: a map and its run as one HTML page.

use super::measuring::eval::truth::{Limits, Truth};
use crate::args::LoadArgs;
use crate::failure;
use crate::meshing::{Fused, LeftOut, SurfaceArgs};
use crate::output;
use crate::reporting::{self, FusedFigures, Subject};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic_report::Report;
use voxelastic_run::export::path::StoredPath;
use voxelastic_run::map_files;

/// Write a report on a map and its run, one HTML page
///
/// The page shows the surface in 3D, the map from above with trajectory and loop closures, and charts of the run: time of each scan, memory,
/// submaps. With --truth it shows the errors of the map. It is one file and needs no network.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic report hall.vox                                writes hall.html
  voxelastic report campus.vox --truth campus -o out.html   with errors against the world that was simulated into campus
  voxelastic report hall.vox --truth survey.ply --error-max 0.2
  voxelastic report hall.vox --plan path.json               with a planned path")]
pub struct ReportArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    #[command(flatten)]
    load: LoadArgs,
    /// The page to write [default: the name of the map with .html, in the current directory]
    #[arg(short, long, value_name = "FILE.html")]
    output: Option<PathBuf>,
    /// Heading of the page [default: the name of the map]
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,
    /// Measure the map against this, as `voxelastic eval` does, and colour it by its error
    #[arg(long, value_name = "CLOUD|MESH|DIR|world.toml")]
    truth: Option<PathBuf>,
    /// Error at the end of the colour scale, metres
    #[arg(long, value_name = "M", default_value_t = 0.1, requires = "truth", value_parser = positive)]
    error_max: f64,
    /// Draw the path that `voxelastic plan` wrote
    #[arg(long, value_name = "FILE.json")]
    plan: Option<PathBuf>,
    /// Time between two scans of the sensor, milliseconds: a line in the chart of times
    #[arg(long, value_name = "MS", default_value_t = SENSOR_PERIOD_MS, value_parser = positive)]
    sensor_period: f64,
    /// Print one JSON object on stdout: file, bytes, vertices, ..
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    surface: SurfaceArgs,
}

/// Most spinning sensors scan ten times a second.
pub const SENSOR_PERIOD_MS: f64 = 100.0;

fn positive(text: &str) -> Result<f64, String> {
    text.trim().parse().ok().filter(|v: &f64| *v > 0.0 && v.is_finite()).ok_or_else(|| "must be a number above 0".to_owned())
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    file: &'a Path,
    bytes: u64,
    submaps: usize,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    vertices: usize,
    /// Points on things that moved that the page has: at most 120,000 of those that were set aside.
    moving_points: usize,
    has_run: bool,
    has_truth: bool,
    /// Null unless submaps were fused.
    fused: Option<Fused>,
    /// Null with `--keep-all`, and where nothing could be left out.
    left_out: Option<LeftOut>,
}

/// Runs the command.
pub fn run(args: &ReportArgs) -> anyhow::Result<u8> {
    let pool = args.surface.pool()?;
    pool.install(|| write_report(args))
}

fn write_report(args: &ReportArgs) -> anyhow::Result<u8> {
    let map = map_files::load(&args.map, args.load.into())?;
    let store = map_files::open(&args.map)?;
    let run = map_files::run_log(&store);
    if run.is_none() {
        tracing::info!("{}: the map has no log of its run, so the page has no charts of it", args.map.display());
    }
    let details = &store.manifest().details;
    let subject = Subject { atlas: &map.atlas, settings: &map.settings, details, run, surface: &args.surface };
    let (mut report, figures) = subject.report(args.title.as_deref().unwrap_or(&name_of(&args.map)));
    report.sensor_period_ms = args.sensor_period;
    report.error_max = args.error_max as f32;
    report.planned_path = args.plan.as_deref().map(|file| StoredPath::read(file, map.origin)).transpose()?.map(StoredPath::into_drawing);
    if let Some(path) = &args.truth {
        let truth = Truth::open(path, None, &Limits::default())?;
        reporting::add_comparison(&mut report, &args.map, path, &truth)?;
    }
    let file = args.output.clone().unwrap_or_else(|| page_of(&args.map));
    let bytes = reporting::write(&report, &file)?;
    if args.json {
        output::print_json(&summary(&report, &file, (bytes, map.atlas.submaps().len(), map.damaged), figures))?;
    }
    Ok(failure::DONE)
}

fn summary<'a>(report: &Report, file: &'a Path, (bytes, submaps, submaps_damaged): (u64, usize, usize), figures: FusedFigures) -> Summary<'a> {
    Summary {
        file,
        bytes,
        submaps,
        submaps_damaged,
        vertices: report.surface.iter().map(|s| s.positions.len()).sum(),
        moving_points: report.moving.iter().map(|m| m.points.len()).sum(),
        has_run: report.run.is_some(),
        has_truth: !report.distances.is_empty(),
        fused: figures.fused,
        left_out: figures.left_out,
    }
}

/// The name of a map: `hall` for `maps/hall.vox`.
pub fn name_of(map: &Path) -> String {
    let whole = map.canonicalize().unwrap_or_else(|_| map.to_owned());
    whole.file_stem().map_or_else(|| "map".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// The default path of the report on a map.
pub fn page_of(map: &Path) -> PathBuf {
    PathBuf::from(format!("{}.html", name_of(map)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_named_after_their_maps() {
        assert_eq!(page_of(Path::new("maps/hall.v2.vox")), Path::new("hall.v2.html"));
        assert!(positive("0.1").is_ok() && ["0", "-1", "nan", "inf", "x"].iter().all(|t| positive(t).is_err()));
    }
}
