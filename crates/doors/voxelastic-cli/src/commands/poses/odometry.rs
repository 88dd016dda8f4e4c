//! `voxelastic odometry`: poses of scans from the scans alone.

mod output_file;
mod tracked;
mod truth;

use crate::args::raw_data::RawDataArgs;
use crate::failure::{self, Failure, one_line};
use crate::progress::Progress;
use crate::{interrupt, output};
use clap::Args;
use output_file::OutputFile;
use serde::Serialize;
use std::path::PathBuf;
use tracked::Tracked;
use truth::{PathErrors, TruePoses};
use voxelastic_run::poses::{OdometryLog, OdometrySummary};
use voxelastic_run::threads;
use voxelastic_run::usage::{self, PoolClock};
use voxelastic_run::{Code, Warnings};
use voxelastic_slam::odometry::{Odometry, OdometrySettings};

/// Estimate the poses of scans from the scans alone
///
/// Each scan is registered to a local map of those before it; no poses are needed, and none of the data are used. Points that have times are
/// corrected for the motion during the sweep. A scan that fits nowhere is left out; after three of these a new piece of the trajectory
/// begins, which is said. `voxelastic map` does this by itself for data without poses.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic odometry drive.bag -o drive.tum
  voxelastic odometry kitti/sequences/00 -o 00.txt       KITTI rows, one for each scan
  voxelastic odometry hall -o hall.g2o                   a pose graph with odometry edges and their information
  voxelastic odometry hall -o hall.tum --truth poses.tum the errors against other poses of the same scans
  voxelastic map hall --poses hall.tum                   maps with these poses")]
pub struct OdometryArgs {
    #[command(flatten)]
    data: RawDataArgs,
    /// The trajectory to write: .tum (time x y z qx qy qz qw), .txt (KITTI 3x4 rows) or .g2o (with edges) [default: none, only figures]
    #[arg(short, long, value_name = "FILE", value_parser = OutputFile::parse)]
    output: Option<OutputFile>,
    /// True poses to compare with: a path, or a part of a file name in DATA [default: the file named ground truth, if there is one]
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Stop after this many scans
    #[arg(long, value_name = "N")]
    max_scans: Option<usize>,
    /// Edge of the finest voxels of the local map, metres [default: from the ranges of the first scan, 0.2 to 0.7]
    #[arg(long, value_name = "M", value_parser = metres)]
    voxel_size: Option<f64>,
    /// Nearest return that is used, metres
    #[arg(long, value_name = "M", default_value_t = OdometrySettings::default().min_range, value_parser = metres)]
    min_range: f64,
    /// Farthest return that is used, metres
    #[arg(long, value_name = "M", default_value_t = OdometrySettings::default().max_range, value_parser = metres)]
    max_range: f64,
    /// Threads, 0 for all cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print the results as one JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    /// The trajectory, if one was written.
    #[serde(serialize_with = "crate::output::optional_path")]
    output: Option<PathBuf>,
    /// Scans that could not be read.
    unreadable: usize,
    #[serde(flatten)]
    odometry: OdometrySummary,
    /// Errors against the true poses, if there are any.
    errors: Option<PathErrors>,
    /// Threads.
    threads: usize,
    /// Whether the run was ended by Ctrl-C or a termination request.
    interrupted: bool,
    /// Peak resident memory, megabytes (10^6 bytes); `null` where the system does not report it.
    peak_rss_mb: Option<f64>,
}

/// Runs the command.
pub fn run(args: &OdometryArgs, quiet: bool) -> anyhow::Result<u8> {
    let mut warnings = Warnings::default();
    let (scans, are_distorted) = args.data.open(&mut warnings)?;
    scans.description().lines().for_each(|line| tracing::info!("{line}"));
    let truth = TruePoses::find(args.data.path(), scans.is_recording(), args.truth.as_deref())?;
    let mut settings = OdometrySettings::default();
    settings.voxel_size = args.voxel_size;
    (settings.min_range, settings.max_range) = (args.min_range, args.max_range);
    settings.deskew = are_distorted;
    let pool = threads::pool(args.threads)?;
    let clock = PoolClock::new(&pool);
    let mut odometry = Odometry::new(settings);
    interrupt::install("finishing this scan and writing the poses");

    let total = scans.count().map(|n| n.min(args.max_scans.unwrap_or(n)) as u64);
    let mut progress = Progress::new("scans", total, quiet);
    let (mut tracked, mut log, mut unreadable) = (Vec::new(), OdometryLog::default(), 0);
    for scan in scans.iter().take(args.max_scans.unwrap_or(usize::MAX)) {
        let scan = match scan {
            Ok(scan) => scan,
            Err(problem) => {
                tracing::warn!("scan skipped: {}", one_line(&problem.into()));
                unreadable += 1;
                continue;
            }
        };
        scan.imu.iter().for_each(|sample| odometry.add_imu(*sample));
        let before = clock.now();
        let report = pool.install(|| odometry.register(&scan.cloud, Some(scan.time)));
        let cpu = before.zip(clock.now()).map(|(before, after)| after.saturating_sub(before));
        if let Some(problem) = log.add(scan.node, &report, cpu, &mut warnings) {
            warnings.add(Code::NotRegistered, format!("scan {}: {problem}", scan.name), "");
        }
        progress.step(|| format!("piece {}", report.piece + 1));
        tracked.push(Tracked { node: scan.node, time: scan.time, report });
        if interrupt::requested() {
            break;
        }
    }
    drop(progress);
    if log.registered() == 0 {
        let remedy = "the warnings above give the reason for each scan";
        return Err(Failure::new(format!("{}: no scan could be registered", args.data.path().display()), remedy).into());
    }
    if let Some(file) = &args.output {
        file.write(&tracked)?;
    }
    let summary = Summary {
        output: args.output.as_ref().map(|file| file.path().to_owned()),
        unreadable,
        odometry: log.summary(),
        errors: truth.and_then(|truth| truth.errors(&tracked)),
        threads: pool.current_num_threads(),
        interrupted: interrupt::requested(),
        peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
    };
    summary.odometry.log(summary.threads);
    if let Some(errors) = &summary.errors {
        tracing::info!("{errors}");
    }
    if let Some(path) = &summary.output {
        tracing::info!("wrote {}", path.display());
    }
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(if summary.interrupted { failure::INTERRUPTED } else { failure::DONE })
}

fn metres(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|m: &f64| *m > 0.0 && m.is_finite()).ok_or_else(|| "must be a number of metres, more than 0".to_owned())
}
