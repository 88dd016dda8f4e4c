//! `voxelastic localize`: where in a map scans were taken.

use crate::args::LoadArgs;
use crate::args::data::hold_out;
use crate::args::raw_data::RawDataArgs;
use crate::failure::{self, Failure, one_line};
use crate::meshing::{LayerArgs, SurfaceArgs};
use crate::progress::Progress;
use crate::{interrupt, output};
use clap::Args;
use nalgebra::Vector3;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseExt;
use voxelastic_eval::SeriesStats;
use voxelastic_io::{Origin, dataset, poses};
use voxelastic_run::joining::numbers;
use voxelastic_run::precision::LARGEST;
use voxelastic_run::{HoldOut, Warnings, map_files, surfaces};
use voxelastic_slam::loops::{Localiser, LocaliserSettings, Whereabouts};

/// Find where in a map scans were taken
///
/// Each scan is localised by itself, from an unknown start: places of the map that look like it from above are found for all headings at once, and
/// the scan is registered to the best of them. It is not certain, and not written, if too few of its surfaces are in the map, or if surfaces
/// of the map are in space that the scan saw to be free, or if another place fits as well. The less
/// of the circle a scan sees, the better it must fit.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic localize hall.vox visit.bag -o visit.tum
  voxelastic localize hall.vox scans --guess 3,-2,1             only within 10 m of there
  voxelastic localize hall.vox scans --guess 3,-2,1,90          and heading along the map's y axis
  voxelastic localize hall.vox hall --truth poses.tum --json    the errors against known poses in the map")]
pub struct LocalizeArgs {
    /// The map, with surfaces
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    #[command(flatten)]
    load: LoadArgs,
    #[command(flatten)]
    data: RawDataArgs,
    /// The poses to write, in the map frame (TUM), of the scans whose place is certain [default: none, only figures]
    #[arg(short, long, value_name = "FILE.tum")]
    output: Option<PathBuf>,
    /// About where in the map the scans were taken, metres; and the direction of the sensor's x axis from the map's, degrees, right to within 45
    #[arg(long, value_name = "X,Y,Z[,YAW]", value_parser = guess, allow_hyphen_values = true)]
    guess: Option<Guess>,
    /// How far from there they may be, metres
    #[arg(long, value_name = "M", default_value_t = 10.0, requires = "guess")]
    within: f64,
    /// Known poses of the scans in the map frame to compare with: a path, or a part of a file name in DATA
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Localise one in N scans
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// Localise only the scans that `map --hold-out N` left out, to measure
    #[arg(long, value_name = "N", value_parser = hold_out, conflicts_with = "every")]
    hold_out: Option<HoldOut>,
    /// Print the results as one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    surface: SurfaceArgs,
}

/// A position, and a yaw in radians.
type Guess = (Vector3<f64>, Option<f64>);

impl LocalizeArgs {
    fn takes(&self, index: u64) -> bool {
        self.hold_out.map_or(index.is_multiple_of(self.every), |hold_out| hold_out.holds_out(index as usize))
    }

    /// The guess, in a map with this origin.
    fn whereabouts(&self, origin: &Origin) -> Option<Whereabouts> {
        let local = |position: Vector3<f64>| Vector3::from(origin.point_to_local(position.into()));
        self.guess.map(|(position, yaw)| Whereabouts { position: local(position), within: self.within, yaw })
    }
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    #[serde(serialize_with = "crate::output::path")]
    map: PathBuf,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    #[serde(serialize_with = "crate::output::optional_path")]
    output: Option<PathBuf>,
    /// Scans that were tried.
    scans: usize,
    /// Scans whose place is certain.
    certain: usize,
    /// Wall time of a scan, milliseconds, without the first, which prepares the map.
    wall_ms: SeriesStats,
    /// Time to load the map and to prepare it for the search, seconds.
    prepare_s: f64,
    /// Errors against known poses.
    errors: Option<Errors>,
    interrupted: bool,
    located: Vec<Row>,
}

/// Errors of the scans whose true pose is known.
#[derive(Debug, Serialize)]
struct Errors {
    /// Scans with a known pose.
    scans: usize,
    /// Share of them that is certain and within 0.1 m and 0.5 degrees.
    within_01m: f64,
    /// Share of them that is certain and within 0.2 m.
    within_02m: f64,
    /// Scans that are certain, but farther than 1 m from their known pose.
    wrong: usize,
    /// Errors of those that are certain, metres and degrees.
    position_m: SeriesStats,
    angle_deg: SeriesStats,
}

/// A scan.
#[derive(Debug, Serialize)]
struct Row {
    node: NodeId,
    time: f64,
    certain: bool,
    /// `[x, y, z, qx, qy, qz, qw]` in the map frame; `null` if it could not be registered.
    t_map_lidar: Option<[f64; 7]>,
    overlap: Option<f64>,
    contradiction: Option<f64>,
    error_m: Option<f64>,
    error_deg: Option<f64>,
}

/// Runs the command.
pub fn run(args: &LocalizeArgs, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let pool = args.surface.pool()?;
    let (scans, _) = args.data.open(&mut Warnings::default())?;
    scans.description().lines().for_each(|line| tracing::info!("{line}"));
    let mut truth = args.truth.as_deref().map(|file| true_poses(args.data.path(), file)).transpose()?;
    let map = pool.install(|| map_files::load(&args.map, args.load.into()))?;
    let points = pool.install(|| surfaces::of_submaps(&map.atlas, &args.surface.options(LayerArgs::default())))?.positions;
    let viewpoints = map.atlas.submaps().iter().flat_map(|s| s.scans().iter().map(|scan| s.t_map_submap() * scan.t_submap_lidar)).collect();
    let (submaps_damaged, origin) = (map.damaged, map.origin);
    drop(map);
    truth.iter_mut().flatten().for_each(|(_, pose)| *pose = origin.to_local(*pose));
    let whereabouts = args.whereabouts(&origin);
    let mut localiser = Localiser::new(points, viewpoints, LocaliserSettings::default());
    interrupt::install("reporting the scans localised so far");

    let mut progress = Progress::new("scans", scans.count().map(|n| n as u64 / args.every), quiet);
    let (mut rows, mut trajectory, mut wall_ms, mut prepare_s) = (Vec::new(), Vec::new(), Vec::new(), 0.0);
    for (index, scan) in (0u64..).zip(scans.iter()) {
        let scan = match scan {
            Ok(scan) if args.takes(index) => scan,
            Ok(_) => continue,
            Err(problem) => {
                tracing::warn!("scan skipped: {}", one_line(&problem.into()));
                continue;
            }
        };
        let begin = Instant::now();
        let found = pool.install(|| localiser.locate(&scan.cloud, whereabouts));
        if rows.is_empty() {
            prepare_s = clock.elapsed().as_secs_f64();
        } else {
            wall_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        }
        let certain = found.is_some_and(|f| f.is_certain);
        if let Some(found) = found.filter(|f| f.is_certain) {
            trajectory.push((scan.time, origin.to_map(found.t_map_lidar)));
        }
        let error = found.zip(truth.as_ref().and_then(|truth| truth.iter().find(|(node, _)| *node == scan.node)));
        rows.push(Row {
            node: scan.node,
            time: scan.time,
            certain,
            t_map_lidar: found.map(|f| numbers(&origin.to_map(f.t_map_lidar))),
            overlap: found.map(|f| f.overlap),
            contradiction: found.map(|f| f.contradiction),
            error_m: error.map(|(found, (_, right))| found.t_map_lidar.translation_distance(right)),
            error_deg: error.map(|(found, (_, right))| found.t_map_lidar.rotation_distance(right).to_degrees()),
        });
        progress.step(|| format!("{} certain", trajectory.len()));
        if interrupt::requested() {
            break;
        }
    }
    drop(progress);
    if rows.is_empty() {
        return Err(Failure::new(format!("{}: no scan could be read", args.data.path().display()), "the warnings above give the reasons").into());
    }
    if let Some(path) = &args.output {
        poses::write_tum(path, &trajectory)?;
    }
    let summary = Summary {
        map: args.map.clone(),
        submaps_damaged,
        output: args.output.clone(),
        scans: rows.len(),
        certain: trajectory.len(),
        wall_ms: SeriesStats::new(&wall_ms),
        prepare_s,
        errors: truth.map(|truth| errors(&rows, &truth)),
        interrupted: interrupt::requested(),
        located: rows,
    };
    log_summary(&summary);
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(if summary.interrupted { failure::INTERRUPTED } else { failure::DONE })
}

fn log_summary(s: &Summary) {
    let time = s.wall_ms.median.map_or_else(String::new, |ms| format!(", {ms:.0} ms a scan"));
    tracing::info!("{} of {} scans localised{time}", s.certain, s.scans);
    if let Some(e) = &s.errors {
        let median = |series: &SeriesStats| series.median.unwrap_or(f64::NAN);
        let (position, angle) = (median(&e.position_m), median(&e.angle_deg));
        let share = |part: f64| 100.0 * part;
        tracing::info!(
            "of {} with known poses: {:.1} % within 0.1 m and 0.5 degrees, {:.1} % within 0.2 m, {} wrong; median {position:.3} m, {angle:.2} degrees",
            e.scans,
            share(e.within_01m),
            share(e.within_02m),
            e.wrong
        );
    }
    if let Some(path) = &s.output {
        tracing::info!("wrote {}", path.display());
    }
}

fn errors(rows: &[Row], truth: &[(NodeId, Pose)]) -> Errors {
    let known: Vec<&Row> = rows.iter().filter(|row| truth.iter().any(|(node, _)| *node == row.node)).collect();
    let certain: Vec<(f64, f64)> = known.iter().filter(|row| row.certain).filter_map(|row| row.error_m.zip(row.error_deg)).collect();
    let share = |is_good: &dyn Fn(&(f64, f64)) -> bool| certain.iter().filter(|e| is_good(e)).count() as f64 / known.len().max(1) as f64;
    Errors {
        scans: known.len(),
        within_01m: share(&|e| e.0 <= 0.1 && e.1 <= 0.5),
        within_02m: share(&|e| e.0 <= 0.2),
        wrong: certain.iter().filter(|e| e.0 > 1.0).count(),
        position_m: SeriesStats::new(&certain.iter().map(|e| e.0).collect::<Vec<_>>()),
        angle_deg: SeriesStats::new(&certain.iter().map(|e| e.1).collect::<Vec<_>>()),
    }
}

fn true_poses(data: &Path, file: &Path) -> anyhow::Result<Vec<(NodeId, Pose)>> {
    let found = dataset::open_truth(data, Some(file))?;
    Ok(found.map_or_else(Vec::new, |(_, data)| data.scans().iter().map(|s| (s.node, s.t_map_lidar)).collect()))
}

fn guess(text: &str) -> Result<Guess, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok().filter(|v: &f64| v.abs() <= LARGEST)).collect();
    match numbers.as_deref() {
        Some([x, y, z]) => Ok((Vector3::new(*x, *y, *z), None)),
        Some([x, y, z, yaw]) => Ok((Vector3::new(*x, *y, *z), Some(yaw.to_radians()))),
        _ => Err(format!("must be three or four numbers up to {LARGEST:e}: X,Y,Z in metres, and YAW in degrees")),
    }
}
