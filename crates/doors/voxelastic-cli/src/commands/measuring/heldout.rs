//! `voxelastic heldout`: measures a map with scans that it was not built from.

use crate::args::DataArgs;
use crate::args::LoadArgs;
use crate::failure::{self, Failure, one_line};
use crate::meshing::{LayerArgs, SurfaceArgs, map_mesh};
use crate::progress::Progress;
use crate::{interrupt, output};
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use voxelastic::event::{Event, NodeId};
use voxelastic_eval::MeshView;
use voxelastic_eval::held_out::{HeldOut, HeldOutReport, HeldOutSettings};
use voxelastic_eval::layers::{LAYER_PLACES, LAYER_REACH, Layers, layers};
use voxelastic_run::HoldOut;

/// Measure a map with the scans that were held out of it
///
/// Distances from the points of the held-out scans, at the poses of the data, to the mesh of the map. Needs no survey, but errors of the poses
/// count as errors of the map.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic map hall -o hall.vox --hold-out 10
  voxelastic heldout hall.vox hall --hold-out 10
  voxelastic heldout hall.vox hall --hold-out 10 --max-range 40 --json")]
pub struct HeldoutArgs {
    /// The map, built with --hold-out
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    #[command(flatten)]
    load: LoadArgs,
    #[command(flatten)]
    data: DataArgs,
    /// The N that the map was built with: every Nth scan is measured
    #[arg(long, value_name = "N", default_value = "10", value_parser = crate::args::data::hold_out)]
    hold_out: HoldOut,
    /// Maximum range of the points, metres
    #[arg(long, value_name = "M", default_value_t = 20.0)]
    max_range: f32,
    /// Print one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    layers: LayerArgs,
    #[command(flatten)]
    surface: SurfaceArgs,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    #[serde(serialize_with = "crate::output::path")]
    map: PathBuf,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    /// Nodes of the scans in `scans`.
    nodes: Vec<NodeId>,
    /// Surfaces of the mesh on top of each other.
    layers: Option<Layers>,
    #[serde(flatten)]
    report: HeldOutReport,
}

/// Runs the command.
pub fn run(args: &HeldoutArgs, quiet: bool) -> anyhow::Result<u8> {
    args.data.check(false)?;
    let pool = args.surface.pool()?;
    let mut held = args.data.open(false)?;
    args.hold_out.keep_held_out(&mut held);
    let map = pool.install(|| args.surface.load(&args.map, args.load))?;
    let mapped: Vec<NodeId> = map.atlas.submaps().iter().flat_map(|s| s.scans().iter().map(|scan| scan.node)).collect();
    let mesh = pool.install(|| map_mesh(&map.atlas, &args.surface, args.layers))?.mesh;
    let view = MeshView::new(&mesh.positions, &mesh.triangles)?;
    let settings = HeldOutSettings { max_range: args.max_range, min_range: map.settings.min_range, ..HeldOutSettings::default() };
    let mut measure = pool.install(|| HeldOut::new(&view, settings))?;
    interrupt::install("reporting the scans measured so far");

    let mut nodes = Vec::new();
    let mut progress = Progress::new("scans", held.scans().map(|n| n as u64), quiet);
    for event in held.events() {
        match event {
            Ok(Event::Scan(scan)) if mapped.contains(&scan.node) => {
                let remedy = "use the same data and the same --hold-out as for the map";
                let what = format!("{}: scan {} is part of the map, so the map cannot be measured with it", args.map.display(), scan.node);
                return Err(Failure::new(what, remedy).into());
            }
            Ok(Event::Scan(scan)) => {
                pool.install(|| measure.add(&scan.cloud, &map.origin.to_local(scan.t_map_lidar)));
                nodes.push(scan.node);
                progress.step(|| format!("{} triangles", mesh.triangles.len()));
            }
            Ok(_) => {}
            Err(problem) => tracing::warn!("scan skipped: {}", one_line(&problem.into())),
        }
        if interrupt::requested() {
            break;
        }
    }
    drop(progress);
    let report = measure.report();
    if report.distances.count == 0 {
        let remedy = "hold out more scans (a smaller --hold-out), or raise --max-range";
        return Err(Failure::new("no point of a held-out scan is in range", remedy).into());
    }
    if args.json {
        let layers = pool.install(|| layers(&view, LAYER_PLACES, LAYER_REACH));
        output::print_json(&Summary { map: args.map.clone(), submaps_damaged: map.damaged, nodes, layers, report })?;
    } else {
        output::print(&table(&report))?;
    }
    Ok(if interrupt::requested() { failure::INTERRUPTED } else { failure::DONE })
}

/// The report as text.
fn table(report: &HeldOutReport) -> String {
    let d = &report.distances;
    let cm = |metres: Option<f64>| metres.map_or_else(|| "out of range".to_owned(), |m| format!("{:.2} cm", m * 100.0));
    let share = |part: Option<f64>| part.map_or_else(|| "-".to_owned(), |p| format!("{:.1} %", p * 100.0));
    let rows = [
        ("scans", report.scans.len().to_string()),
        ("points to the mesh", d.count.to_string()),
        ("up to range", format!("{} m", report.max_range_m)),
        ("median", cm(d.median)),
        ("90 % within", cm(d.p90)),
        ("95 % within", cm(d.p95)),
        ("mean", cm(d.mean)),
        ("under 5 cm", share(d.fraction_under_5cm)),
        ("under 10 cm", share(d.fraction_under_10cm)),
        ("under 20 cm", share(d.fraction_under_20cm)),
    ];
    rows.iter().map(|(name, value)| format!("{name:<20}{value:>12}\n")).collect()
}
