//! Growth of the costs with the number of rings, the range, the voxel size and the number of submaps.
//!
//! One parameter is varied at a time, on the first scans of the simulated campus. The fitted exponent b of the power law y = a x^b describes the
//! growth: 1 is proportional, 0 is constant.

mod power_law;
mod road;
mod submaps;
mod sweep;

pub use road::Road;
pub use sweep::{Point, Sweep};

use crate::data::{Dataset, simulated};
use crate::error::Result;
use crate::results::{Machine, generator, machine};
use crate::run::{Case, Run};
use crate::setting::{FIELDS, HARDEST, Setting, centimetres};
use crate::workspace::{Workspace, load};
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic::settings::FieldKind;
use voxelastic_eval::SeriesStats;

/// Results. The keys of `growth.json` are stable; more may be added.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Growth {
    /// Version of the format: 1.
    pub format: u32,
    /// Program and version.
    pub generator: String,
    /// The machine.
    pub machine: Machine,
    /// Costs as functions of one parameter.
    pub sweeps: Vec<Sweep>,
    /// Costs of new road.
    pub roads: Vec<Road>,
    /// Duration, seconds.
    pub total_s: f64,
}

/// Scans per run, which include a corner of the route.
const SCANS: usize = 40;
/// Sensors with 16 to 128 rings and 1024 columns. The first has a vertical field of view of 30 degrees, the others 42.
const RINGS: [(u32, &str); 4] = [(16, "vlp-16"), (32, "os1-32"), (64, "os1-64-gen2"), (128, "os1-128")];
const RANGES: [f32; 4] = [15.0, 30.0, 60.0, 120.0];
const VOXELS: [f32; 4] = [0.065, 0.13, 0.26, 0.52];

/// Runs all measurements. `real_data` is the folder with real scans, `campus` an existing simulated campus.
///
/// # Errors
/// When a program of ours fails.
pub fn run(workspace: &Workspace, real_data: &Path, campus: Option<&Path>) -> Result<Growth> {
    let clock = Instant::now();
    let mut growth = Growth { format: 1, generator: generator(), machine: machine(), ..Growth::default() };
    let data = Dataset { max_scans: Some(SCANS), ..crate::data::campus(workspace, campus)? };
    growth.sweeps.extend(rings(workspace)?);
    for field in FIELDS {
        let points = RANGES.map(|r| (f64::from(r), Setting { max_range: r, ..HARDEST }));
        growth.sweeps.push(settings(workspace, &data, field, ("range", "m", format!("{}, 64 rings", centimetres(HARDEST.voxel))), &points)?);
    }
    for field in FIELDS {
        let points = VOXELS.map(|v| ((f64::from(v) * 1e4).round() / 1e4, Setting { voxel: v, ..HARDEST }));
        growth.sweeps.push(settings(workspace, &data, field, ("voxel", "m", format!("{} m, 64 rings", HARDEST.max_range)), &points)?);
    }
    growth.sweeps.push(submaps::sweep(workspace)?);
    growth.roads = road::roads(workspace, real_data)?;
    growth.machine.load_after = load();
    growth.total_s = clock.elapsed().as_secs_f64();
    Ok(growth)
}

/// The four sensors, simulated on the same route.
fn rings(workspace: &Workspace) -> Result<Vec<Sweep>> {
    let mut sweeps: Vec<Sweep> = FIELDS.map(|field| Sweep::new("rings", "", field.name(), format!("{HARDEST}, 1024 columns"))).into();
    for (rings, sensor) in RINGS {
        let name = format!("rings-{rings}");
        let folder = simulated(workspace, &name, &["campus", "--sensor", sensor, "--columns", "1024", "--scans", &SCANS.to_string()])?;
        let data = Dataset::simulated(&name, folder);
        for (sweep, field) in sweeps.iter_mut().zip(FIELDS) {
            sweep.points.push(point(workspace, f64::from(rings), &data, HARDEST, field)?);
        }
    }
    Ok(sweeps.into_iter().map(Sweep::fitted).collect())
}

/// The same scans with several settings.
fn settings(
    workspace: &Workspace,
    data: &Dataset,
    field: FieldKind,
    (of, unit, fixed): (&'static str, &'static str, String),
    points: &[(f64, Setting)],
) -> Result<Sweep> {
    let points = points.iter().map(|&(x, setting)| point(workspace, x, data, setting, field)).collect::<Result<_>>()?;
    Ok(Sweep { points, ..Sweep::new(of, unit, field.name(), fixed) }.fitted())
}

fn point(workspace: &Workspace, x: f64, data: &Dataset, setting: Setting, field: FieldKind) -> Result<Point> {
    tracing::info!("{}, {setting}, {}", data.name, field.name());
    let run: Run = Case { data, setting, field, threads: 1, one_submap: false }.run(workspace, "growth.vox")?;
    workspace.remove_scratch("growth.vox");
    let elastic_ms = SeriesStats::new(&run.series.elastic_ms).mean;
    Ok(Point { x, cpu_ms: run.cpu_ms.median, map_mb: run.map_mb, peak_rss_mb: run.peak_rss_mb, elastic_ms, pose_update_ms: None })
}
