//! `voxelastic map`: builds a map from a folder of scans and poses, or from a recording.

use crate::closure_summary::ClosureSummary;
use crate::commands::report;
use crate::config::SettingFlags;
use crate::data::{DataArgs, HoldOut};
use crate::elastic::{ElasticArgs, corrected};
use crate::failure::{self, Failure, one_line};
use crate::input::Input;
use crate::jumps::Jumps;
use crate::mapping::{Session, TimeSummary};
use crate::meshing::SurfaceArgs;
use crate::odometry_log::OdometrySummary;
use crate::progress::Progress;
use crate::reporting::{self, Subject};
use crate::target::{self, OnFullDisk, Target};
use crate::{interrupt, meshing, output, usage};
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use voxelastic::event::Event;
use voxelastic::mapper::Mapper;
use voxelastic::settings::Dynamic;
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_io::store::{MapDetails, SaveReport};
use voxelastic_report::{Correction, LoopEdge, RunLog};
use voxelastic_slam::Corrector;

/// Map a folder of scans, or a recording, with or without poses
///
/// Scans (PCD, PLY, KITTI .bin) are searched in scans/, Scans/, velodyne/, clouds/ and the folder itself; pose files are found by name and
/// content (TUM, KITTI 3x4 rows, Newer College CSV, g2o). In recordings (ROS 1 .bag, ROS 2 MCAP and sqlite3) the topics of clouds and poses are
/// found by their types. Without poses, they are estimated from the scans. Where the choice is ambiguous, the candidates are listed. Scans that cannot be used are skipped, counted and reported.
/// The map is saved after the last scan, or after the current one on Ctrl-C; an existing map of the same name is replaced,
/// but not by one of fewer scans: that is saved beside it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic map hall                                   writes hall.vox here
  voxelastic map hall -o maps/hall.vox --voxel-size 0.05
  voxelastic map kitti00 --poses groundtruth            if there are several pose files
  voxelastic map drive.bag                              with the poses in it; without any, by odometry
  voxelastic map drive.bag --poses slam.tum             poses of another program, matched by time
  voxelastic map DATA --t-base-lidar \"0 0 1.7 0 0 0 1\"   the poses in the files are those of the vehicle
  voxelastic map drive.bag --dynamic remove --dynamic-points moving.ply
  voxelastic map hall --report                          also writes hall.html, for a browser
  voxelastic map DATA --config mapping.toml --json      settings from a file, results on stdout")]
pub struct MapArgs {
    #[command(flatten)]
    data: DataArgs,
    /// The map to write, a directory [default: the name of DATA with .vox, in the current directory]
    #[arg(short, long, value_name = "MAP.vox")]
    output: Option<PathBuf>,
    /// Estimate the poses from the scans, even if the data have some
    #[arg(long)]
    slam: bool,
    /// Leave out every Nth scan, for `voxelastic heldout`
    #[arg(long, value_name = "N", value_parser = HoldOut::parse)]
    hold_out: Option<HoldOut>,
    /// Stop after this many scans
    #[arg(long, value_name = "N")]
    max_scans: Option<usize>,
    /// Replace an existing map even if it has more scans than the new one
    #[arg(long)]
    overwrite: bool,
    /// What to do when the finished map cannot be written, because the disk is full for one
    #[arg(long, value_name = "WHAT", default_value = "elsewhere")]
    on_full_disk: OnFullDisk,
    /// Fail on the first scan that cannot be used, instead of skipping it
    #[arg(long)]
    strict: bool,
    /// Write a report on the map and the run, an HTML page [default name: that of the map with .html, in the current directory]
    #[arg(long, value_name = "FILE.html", num_args = 0..=1, require_equals = true)]
    report: Option<Option<PathBuf>>,
    /// With --dynamic remove: write the points on things that move as a cloud (PLY, map frame)
    #[arg(long, value_name = "FILE.ply")]
    dynamic_points: Option<PathBuf>,
    /// Print the results as one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    elastic: ElasticArgs,
    #[command(flatten)]
    settings: SettingFlags,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    /// The map.
    output: PathBuf,
    /// Scans integrated.
    scans: usize,
    /// Scans that could not be used.
    scans_skipped: usize,
    /// Scans left out with `--hold-out`.
    scans_held_out: usize,
    /// Whether the run was ended by Ctrl-C or a termination request.
    interrupted: bool,
    /// Submaps in the map.
    submaps: usize,
    /// Submaps that were fused into others.
    fusions: usize,
    /// Finest voxels that a single scan had marked as occupied and that other submaps observed as free.
    voxels_freed: usize,
    /// Points set aside because they are on things that move.
    moving_points: usize,
    /// TSDF voxels removed because nothing is there before or after.
    voxels_removed: usize,
    /// Root poses moved by corrections.
    submap_moves: usize,
    /// Groups of submaps joined by loop edges that are not merged, because the result would be too large.
    groups_apart: usize,
    /// Loop edges in order, each with its time.
    loops: Vec<LoopEdge>,
    /// Pose corrections in order, each with its time.
    corrections: Vec<Correction>,
    /// Submaps rebuilt from their scans at the end.
    submaps_rebuilt: usize,
    /// Figures of the odometry; `null` where the data have poses.
    odometry: Option<OdometrySummary>,
    /// Loop closures that were tried; `null` where none were looked for.
    closures: Option<ClosureSummary>,
    /// Fields of the map: `tsdf`, `occupancy`, `both`.
    field: &'static str,
    /// Edge of the finest voxel, metres.
    voxel_m: f32,
    /// Largest range integrated, metres.
    max_range_m: f32,
    /// The sensor model, in words.
    sensor: String,
    /// How the clouds are laid out: `grid`, `rings`, `ring order`, `projected` or `scattered`.
    sensor_layout: &'static str,
    /// Threads of the mapper.
    threads: usize,
    #[serde(flatten)]
    times: TimeSummary,
    /// From reading the first scan to integrating the last, seconds.
    mapping_s: f64,
    /// From start to saved map, seconds.
    total_s: f64,
    /// Peak resident memory, megabytes (10^6 bytes); `null` where the system does not report it.
    peak_rss_mb: Option<f64>,
    /// Memory of the fields of the map, megabytes.
    map_mb: f64,
    /// Size of the map on disk, megabytes.
    file_mb: f64,
    /// Blocks of 8 x 8 x 8 finest voxels over all submaps (TSDF).
    blocks: usize,
}

/// Counts of a run.
#[derive(Debug, Default)]
struct Tally {
    skipped: usize,
    held_out: usize,
    rebuilt: usize,
    interrupted: bool,
    /// The input ended early because of a bug of a decoder.
    broken: bool,
    mapping_s: f64,
    odometry: Option<OdometrySummary>,
    closures: Option<ClosureSummary>,
}

/// Runs the command.
pub fn run(args: &MapArgs, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let settings = args.settings.resolve()?;
    let output = target::path(args.output.as_deref(), args.data.path())?;
    let selection = Selection::open(args)?;
    let pool = meshing::pool(settings.threads)?;
    let mut mapper = Mapper::new(settings.clone()).map_err(|e| Failure::usage(e.to_string(), "see `voxelastic config`"))?;
    if let Some(model) = selection.input.sensor() {
        mapper.set_sensor_model(model);
    }
    let mut target = Target::create(&output, args.overwrite, args.on_full_disk)?;
    interrupt::install("finishing this scan and saving the map");

    let mut session = Session::new(mapper, pool);
    if args.dynamic_points.is_some() {
        if settings.dynamic == Dynamic::Keep {
            return Err(Failure::usage("--dynamic-points needs --dynamic remove: otherwise nothing is set aside", "add --dynamic remove").into());
        }
        session.keep_moving_points();
    }
    let mut tally = integrate(&selection, args, &mut session, quiet)?;
    if session.scans() == 0 {
        let (what, remedy) = if tally.interrupted {
            ("interrupted before the first scan was integrated", "")
        } else {
            ("no scan could be integrated", "the warnings above give the reason for each scan")
        };
        return Err(Failure::new(format!("{}: {what}; no map was written", args.data.path().display()), remedy).into());
    }
    tally.rebuilt = args.elastic.finish(selection.input.clouds(), &mut session, quiet);
    let details = MapDetails::describe(&settings, session.mapper().sensor());
    let saved = target.save(&session, &details)?;
    let output = target.path().to_owned();
    let summary = summarise(&session, &tally, saved, &output, clock);
    let log = RunLog { total_s: summary.total_s, interrupted: tally.interrupted, scans_skipped: tally.skipped, ..session.log() };
    target.log(&log);
    if let Some(odometry) = &summary.odometry {
        odometry.log(summary.threads);
    }
    if let Some(closures) = &summary.closures {
        closures.log();
    }
    log_summary(&summary);
    // A page that cannot be written is an error, but the map is there, and its summary, too.
    if let Some(path) = &args.dynamic_points {
        let points = MeshRef { positions: session.moving_points(), ..MeshRef::default() };
        write_ply(path, &points).with_context(|| format!("the map is saved as {}, but not the points on what moves", output.display()))?;
        tracing::info!("{} points on what moves in {}", points.positions.len(), path.display());
    }
    let reported = args.report.as_ref().map_or(Ok(0), |page| {
        let page = page.clone().unwrap_or_else(|| report::page_of(&output));
        let (atlas, settings) = (session.mapper().atlas(), session.mapper().settings());
        let subject = Subject { atlas, settings, details: &details, run: Some(log), surface: &SurfaceArgs::default() };
        session.pool().install(|| reporting::write(&subject.report(&report::name_of(&output)), &page))
    });
    if args.json {
        output::print_json(&summary)?;
    }
    reported.with_context(|| format!("the map is saved as {}, but not its report", output.display()))?;
    Ok(match () {
        () if tally.broken => failure::BUG,
        () if target.is_elsewhere() => failure::ELSEWHERE,
        () if tally.interrupted => failure::INTERRUPTED,
        () => failure::DONE,
    })
}

/// The scans to map, and the number of those held out.
struct Selection {
    input: Input,
    held_out: Arc<AtomicUsize>,
}

impl Selection {
    /// Opens the data, logs its description, and applies the limits on scans.
    fn open(args: &MapArgs) -> anyhow::Result<Self> {
        let mut input = Input::open(&args.data, args.strict, args.slam, args.elastic.pose_kind())?;
        input.description().lines().for_each(|line| tracing::info!("{line}"));
        if let Some(most) = args.max_scans {
            input.limit(most);
        }
        let held_out = args.hold_out.map(|hold_out| input.remove_held_out(hold_out)).unwrap_or_default();
        Ok(Self { input, held_out })
    }
}

/// Passes all events to the mapper, until they end or the user interrupts.
fn integrate(selection: &Selection, args: &MapArgs, session: &mut Session, quiet: bool) -> anyhow::Result<Tally> {
    let clock = Instant::now();
    let Selection { input, held_out } = selection;
    let mut tally = Tally::default();
    let mut progress = Progress::new("scans", input.scans().map(|n| n as u64), quiet);
    let mut skip = |problem: anyhow::Error| -> anyhow::Result<()> {
        if args.strict {
            return Err(problem.context("a scan cannot be used (--strict); no map was written"));
        }
        tracing::warn!("scan skipped: {}", one_line(&problem));
        tally.skipped += 1;
        Ok(())
    };
    let mut corrector = args.elastic.corrector(input.is_raw());
    let mut jumps = Jumps::default();
    let mut events = input.events(session.threads())?;
    session.set_idle_task(|| events.idle_task());
    for event in events.by_ref() {
        tally.broken |= event.as_ref().is_err_and(failure::is_bug_of_decoder);
        let is_scan = !matches!(event, Ok(Event::OdometryEdge(_) | Event::LoopEdge(_) | Event::PoseUpdate(_)));
        let first = session.scans() == 0;
        match event.and_then(|event| Ok(corrected(&mut corrector, session, |c| c.take(event))?)) {
            Ok(events) => events.into_iter().try_for_each(|event| match jumps.check(&event) {
                Ok(()) => session.take(event).map_or_else(|e| skip(e.into()), |_| Ok(())),
                Err(jump) => skip(jump.into()),
            })?,
            Err(problem) => skip(problem)?,
        }
        if let (true, Some(sensor)) = (first && session.scans() == 1, session.mapper().sensor()) {
            tracing::info!("sensor: {sensor}");
        }
        if is_scan {
            progress.step(|| {
                let read = input.progress().map_or_else(String::new, |part| format!("{:.0} % read, ", part * 100.0));
                format!("{read}{} submaps", session.mapper().atlas().submaps().len())
            });
        }
        if interrupt::requested() {
            tally.interrupted = true;
            break;
        }
    }
    tally.mapping_s = clock.elapsed().as_secs_f64();
    tally.skipped += input.without_pose();
    tally.odometry = events.odometry();
    tally.held_out = held_out.load(Ordering::Relaxed);
    let last = corrected(&mut corrector, session, Corrector::finish).map_err(anyhow::Error::from);
    let last = last.and_then(|events| Ok(events.into_iter().try_for_each(|event| session.take(event).map(|_| ()))?));
    tally.closures = corrector.closures().map(ClosureSummary::of);
    if let Err(problem) = last {
        tracing::warn!("the last correction is missing: {}", one_line(&problem));
    }
    Ok(tally)
}

fn summarise(session: &Session, tally: &Tally, saved: SaveReport, output: &Path, clock: Instant) -> Summary {
    let (mapper, log) = (session.mapper(), session.log());
    let (settings, atlas) = (mapper.settings(), mapper.atlas());
    Summary {
        output: output.to_owned(),
        scans: session.scans(),
        scans_skipped: tally.skipped,
        scans_held_out: tally.held_out,
        interrupted: tally.interrupted,
        submaps: atlas.submaps().len(),
        fusions: log.fusions,
        voxels_freed: mapper.elastic_counts().voxels_freed,
        moving_points: mapper.elastic_counts().moving_points,
        voxels_removed: mapper.elastic_counts().voxels_removed,
        submap_moves: log.submap_moves,
        groups_apart: log.groups_apart,
        loops: log.loops,
        corrections: log.corrections,
        submaps_rebuilt: tally.rebuilt,
        odometry: tally.odometry.clone(),
        closures: tally.closures.clone(),
        field: settings.field.name(),
        voxel_m: settings.voxel_size,
        max_range_m: settings.max_range,
        sensor: mapper.sensor().unwrap_or_default().to_owned(),
        sensor_layout: mapper.sensor_layout().unwrap_or_default(),
        threads: session.threads(),
        times: session.times(),
        mapping_s: tally.mapping_s,
        total_s: clock.elapsed().as_secs_f64(),
        peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
        map_mb: usage::megabytes(atlas.bytes() as u64),
        file_mb: usage::megabytes(saved.bytes),
        blocks: atlas.submaps().iter().map(|s| s.tsdf().len()).sum(),
    }
}

/// Logs the results in three lines.
fn log_summary(s: &Summary) {
    let skipped = if s.scans_skipped > 0 { format!(", {} skipped", s.scans_skipped) } else { String::new() };
    let held_out = if s.scans_held_out > 0 { format!(", {} held out", s.scans_held_out) } else { String::new() };
    tracing::info!("{} scans{skipped}{held_out} in {:.1} s; {} submaps, {:.0} MB in memory", s.scans, s.total_s, s.submaps, s.map_mb);
    let spread = &s.times.integrate_ms;
    if let (Some(median), Some(p95)) = (spread.median, spread.p95) {
        tracing::info!("integration: median {median:.1} ms, 95 % within {p95:.1} ms a scan, {} threads", s.threads);
    }
    if s.moving_points + s.voxels_removed > 0 {
        tracing::info!("moving: {} points set aside, {} voxels removed where nothing is before or after", s.moving_points, s.voxels_removed);
    }
    tracing::info!("saved {} ({:.1} MB)", s.output.display(), s.file_mb);
}
