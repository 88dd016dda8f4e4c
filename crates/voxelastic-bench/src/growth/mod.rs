//! How cost grows: with the sensor's rings, the range, the voxels, and the number of submaps.
//!
//! One thing is varied at a time, on the beginning of the simulated campus; the exponent b of the power law y = a x^b that fits best says how a
//! cost grows: 1 is in proportion, 0 not at all.

mod drive;
mod fit;
mod submaps;

use crate::data::{Dataset, Truth, simulated};
use crate::error::Result;
use crate::run::{Case, Run};
use crate::setting::{FIELDS, HARD, Setting, centimetres};
use crate::suite::{Machine, generator, machine};
use crate::workshop::{Workshop, load};
pub use drive::Road;
use fit::exponent;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic::settings::FieldKind;
use voxelastic_eval::Spread;

/// All of it. The keys of `growth.json`; they stay, further ones may come.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Growth {
    /// 1.
    pub format: u32,
    /// Who measured.
    pub generator: String,
    /// Where.
    pub machine: Machine,
    /// What was varied.
    pub sweeps: Vec<Sweep>,
    /// What new road costs.
    pub roads: Vec<Road>,
    /// How long it took, seconds.
    pub total_s: f64,
}

/// One thing varied.
#[derive(Clone, Debug, Serialize)]
pub struct Sweep {
    /// What: `rings`, `range`, `voxel` or `submaps`.
    pub of: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// `tsdf` or `occupancy`; what is mapped.
    pub field: String,
    /// What stayed as it was.
    pub fixed: String,
    /// What was measured.
    pub points: Vec<Point>,
    /// Exponent of the processor time of a scan.
    pub cpu_exponent: Option<f64>,
    /// Exponent of the map's memory.
    pub memory_exponent: Option<f64>,
    /// Exponent of the time for the elastic part of a scan: which submap, clustering, fusion.
    pub elastic_exponent: Option<f64>,
    /// Exponent of the time for a correction of all poses.
    pub pose_update_exponent: Option<f64>,
}

/// Costs at one value of what is varied.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Point {
    /// The value.
    pub x: f64,
    /// Processor time of a scan on one thread, milliseconds: the median.
    pub cpu_ms: Option<f64>,
    /// Memory of the map, megabytes.
    pub map_mb: Option<f64>,
    /// Most memory of the process, megabytes.
    pub peak_rss_mb: Option<f64>,
    /// Time for the elastic part of a scan, milliseconds: the mean.
    pub elastic_ms: Option<f64>,
    /// Time for a correction of all poses, milliseconds: the median.
    pub pose_update_ms: Option<f64>,
}

/// Scans of a sweep's runs: far enough to go round a corner.
const SCANS: usize = 40;
/// 16 to 128 rings: sensors of 1024 columns. The first sees 30 degrees, the others 42.
const RINGS: [(u32, &str); 4] = [(16, "vlp-16"), (32, "os1-32"), (64, "os1-64-gen2"), (128, "os1-128")];
const RANGES: [f32; 4] = [15.0, 30.0, 60.0, 120.0];
const VOXELS: [f32; 4] = [0.065, 0.13, 0.26, 0.52];

/// Measures all of it. `real_data` is the folder with real scans; `campus` one that was simulated before.
///
/// # Errors
/// When a program of ours fails.
pub fn run(shop: &Workshop, real_data: &Path, campus: Option<&Path>) -> Result<Growth> {
    let clock = Instant::now();
    let mut growth = Growth { format: 1, generator: generator(), machine: machine(), ..Growth::default() };
    let usual = Dataset { max_scans: Some(SCANS), ..crate::data::campus(shop, campus)? };
    growth.sweeps.extend(rings(shop)?);
    for field in FIELDS {
        let points = RANGES.map(|r| (f64::from(r), Setting { max_range: r, ..HARD }));
        growth.sweeps.push(settings(shop, &usual, field, ("range", "m", format!("{}, 64 rings", centimetres(HARD.voxel))), &points)?);
    }
    for field in FIELDS {
        let points = VOXELS.map(|v| ((f64::from(v) * 1e4).round() / 1e4, Setting { voxel: v, ..HARD }));
        growth.sweeps.push(settings(shop, &usual, field, ("voxel", "m", format!("{} m, 64 rings", HARD.max_range)), &points)?);
    }
    growth.sweeps.push(submaps::sweep(shop)?);
    growth.roads = drive::roads(shop, real_data)?;
    growth.machine.load_after = load();
    growth.total_s = clock.elapsed().as_secs_f64();
    Ok(growth)
}

/// The four sensors, each simulated on the same way.
fn rings(shop: &Workshop) -> Result<Vec<Sweep>> {
    let mut sweeps: Vec<Sweep> = FIELDS.map(|field| Sweep::new("rings", "", field.name(), format!("{HARD}, 1024 columns"))).into();
    for (rings, sensor) in RINGS {
        let name = format!("rings-{rings}");
        let folder = simulated(shop, &name, &["campus", "--sensor", sensor, "--columns", "1024", "--scans", &SCANS.to_string()])?;
        let data = dataset(&name, folder);
        for (sweep, field) in sweeps.iter_mut().zip(FIELDS) {
            sweep.points.push(point(shop, f64::from(rings), &data, HARD, field)?);
        }
    }
    Ok(sweeps.into_iter().map(Sweep::fitted).collect())
}

/// The same scans at several settings.
fn settings(
    shop: &Workshop,
    data: &Dataset,
    field: FieldKind,
    (of, unit, fixed): (&'static str, &'static str, String),
    points: &[(f64, Setting)],
) -> Result<Sweep> {
    let points = points.iter().map(|&(x, setting)| point(shop, x, data, setting, field)).collect::<Result<_>>()?;
    Ok(Sweep { points, ..Sweep::new(of, unit, field.name(), fixed) }.fitted())
}

fn point(shop: &Workshop, x: f64, data: &Dataset, setting: Setting, field: FieldKind) -> Result<Point> {
    tracing::info!("{}, {setting}, {}", data.name, field.name());
    let run: Run = Case { data, setting, field, threads: 1, one_submap: false }.run(shop, "growth.vox")?;
    shop.discard("growth.vox");
    let elastic_ms = Spread::of(&run.series.elastic_ms).mean;
    Ok(Point { x, cpu_ms: run.cpu_ms.median, map_mb: run.map_mb, peak_rss_mb: run.peak_rss_mb, elastic_ms, pose_update_ms: None })
}

fn dataset(name: &str, folder: PathBuf) -> Dataset {
    Dataset { name: name.to_owned(), folder, poses: Some("groundtruth"), truth: Truth::None, max_scans: None }
}

impl Sweep {
    fn new(of: &'static str, unit: &'static str, field: &str, fixed: String) -> Self {
        let points = Vec::new();
        let field = field.to_owned();
        Self { of, unit, field, fixed, points, cpu_exponent: None, memory_exponent: None, elastic_exponent: None, pose_update_exponent: None }
    }

    fn fitted(self) -> Self {
        let fit = |cost: fn(&Point) -> Option<f64>| {
            let points: Option<Vec<(f64, f64)>> = self.points.iter().map(|p| Some((p.x, cost(p)?))).collect();
            points.and_then(exponent)
        };
        Self {
            cpu_exponent: fit(|p| p.cpu_ms),
            memory_exponent: fit(|p| p.map_mb),
            elastic_exponent: fit(|p| p.elastic_ms),
            pose_update_exponent: fit(|p| p.pose_update_ms),
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_are_those_of_what_was_measured() {
        let points = [1.0, 10.0, 100.0].map(|x: f64| Point { x, cpu_ms: Some(2.0 * x), map_mb: Some(7.0), ..Point::default() });
        let sweep = Sweep { points: points.into(), ..Sweep::new("submaps", "", "tsdf", String::new()) }.fitted();
        assert!((sweep.cpu_exponent.unwrap() - 1.0).abs() < 1e-9 && sweep.memory_exponent.unwrap().abs() < 1e-9);
        assert_eq!((sweep.elastic_exponent, sweep.pose_update_exponent), (None, None));
    }
}
