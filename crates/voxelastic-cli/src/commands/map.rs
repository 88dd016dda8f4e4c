//! `voxelastic map`: a folder of scans and poses, or a recording, into a map.

use crate::commands::report;
use crate::config::SettingFlags;
use crate::data::{DataArgs, HoldOut};
use crate::elastic::ElasticArgs;
use crate::failure::{self, Failure};
use crate::mapping::{Session, TimeSummary};
use crate::meshing::SurfaceArgs;
use crate::progress::Progress;
use crate::reporting::{self, Subject};
use crate::{interrupt, map_files, meshing, output, usage};
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use voxelastic::event::Event;
use voxelastic::mapper::Mapper;
use voxelastic_io::source::Source;
use voxelastic_io::store::{MapDetails, MapWriter, SaveReport};
use voxelastic_report::{Correction, LoopEdge, RunLog};

/// Map a folder of scans and poses, or a recording
///
/// Scans (PCD, PLY, KITTI .bin) are looked for in scans/, Scans/, velodyne/, clouds/ or the folder itself; poses are found by name and content
/// (TUM, KITTI 3x4 rows, Newer College CSV, g2o). Of recordings (ROS 1 .bag, ROS 2 MCAP and sqlite3) the
/// topics with clouds and poses are found by their types. Where several could be meant, the choices are listed. A scan that cannot be used is skipped,
/// counted and reported. The map is saved when all scans are done, or after the current one on Ctrl-C; a map of that name is then replaced.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic map hall                                   makes hall.vox here
  voxelastic map hall -o maps/hall.vox --voxel 0.05
  voxelastic map kitti00 --poses groundtruth            where there are several pose files
  voxelastic map drive.bag --poses slam.tum             poses of another program, matched by time
  voxelastic map DATA --t-base-lidar \"0 0 1.7 0 0 0 1\"   poses are those of the vehicle
  voxelastic map hall --report                          and hall.html, to look at in a browser
  voxelastic map DATA --config mapping.toml --json      settings from a file, figures on stdout")]
pub struct MapArgs {
    #[command(flatten)]
    data: DataArgs,
    /// The map to write, a directory [default: the name of DATA with .vox, in the current directory]
    #[arg(short, long, value_name = "MAP.vox")]
    output: Option<PathBuf>,
    /// Leave out every Nth scan, so that `voxelastic heldout` can measure the map with them
    #[arg(long, value_name = "N", value_parser = HoldOut::parse)]
    hold_out: Option<HoldOut>,
    /// Stop after this many scans
    #[arg(long, value_name = "N")]
    max_scans: Option<usize>,
    /// Fail on the first scan that cannot be used, instead of skipping it
    #[arg(long)]
    strict: bool,
    /// Show the map and the run as an HTML page [default name: that of the map with .html, in the current directory]
    #[arg(long, value_name = "FILE.html", num_args = 0..=1, require_equals = true)]
    report: Option<Option<PathBuf>>,
    /// Print one JSON object with the figures on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    elastic: ElasticArgs,
    #[command(flatten)]
    settings: SettingFlags,
}

/// The figures of a run: the keys of `--json`.
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
    /// Finest voxels that one scan had called occupied and other submaps knew to be free.
    voxels_freed: usize,
    /// Root poses that corrections moved.
    submap_moves: usize,
    /// Groups of submaps that closed loops join and that stay apart, because together they would be too large.
    groups_apart: usize,
    /// Loop edges as they came, each with its time.
    loops: Vec<LoopEdge>,
    /// Corrections of the poses as they came, each with its time.
    corrections: Vec<Correction>,
    /// Submaps made anew from their scans at the end.
    submaps_rebuilt: usize,
    /// What the map stores: `tsdf`, `occupancy`, `both`.
    field: &'static str,
    /// Edge of the finest voxel, metres.
    voxel_m: f32,
    /// Largest range integrated, metres.
    max_range_m: f32,
    /// What the sensor was taken for.
    sensor: String,
    /// Threads of the mapper.
    threads: usize,
    #[serde(flatten)]
    times: TimeSummary,
    /// From the first scan that is read to the last that is integrated, seconds.
    mapping_s: f64,
    /// From start to saved map, seconds.
    total_s: f64,
    /// Most memory the process ever held, megabytes (10^6 bytes); `null` where the system does not tell.
    peak_rss_mb: Option<f64>,
    /// Memory that the map's fields hold, megabytes.
    map_mb: f64,
    /// Size of the map on disk, megabytes.
    file_mb: f64,
    /// Blocks of 8 x 8 x 8 finest voxels over all submaps (TSDF).
    blocks: usize,
}

/// What became of the scans.
#[derive(Debug, Default)]
struct Tally {
    skipped: usize,
    held_out: usize,
    rebuilt: usize,
    interrupted: bool,
    mapping_s: f64,
}

/// Maps the data.
pub fn run(args: &MapArgs, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let settings = args.settings.resolve()?;
    let output = output_path(args)?;
    let selection = Selection::open(args)?;
    let pool = meshing::pool(settings.threads)?;
    let mut mapper = Mapper::new(settings.clone()).map_err(|e| Failure::usage(e.to_string(), "see `voxelastic config`"))?;
    if let Some(model) = selection.source.sensor() {
        mapper.know_sensor(model);
    }
    let mut target = Target::create(&output)?;
    interrupt::install("finishing this scan and saving the map");

    let mut session = Session::new(mapper, pool);
    let mut tally = integrate(&selection, args, &mut session, quiet)?;
    if session.scans() == 0 {
        let (what, remedy) = if tally.interrupted {
            ("interrupted before the first scan was integrated", "")
        } else {
            ("no scan could be integrated", "look at the warnings above: each says why its scan was left out")
        };
        return Err(Failure::new(format!("{}: {what}; no map was written", args.data.path().display()), remedy).into());
    }
    tally.rebuilt = args.elastic.finish(&selection.source, &mut session, quiet);
    let details = map_files::details(&settings, session.mapper().sensor());
    let saved = target.save(&session, &details)?;
    let summary = summarise(&session, &tally, saved, &output, clock);
    let log = RunLog { total_s: summary.total_s, interrupted: tally.interrupted, scans_skipped: tally.skipped, ..session.log() };
    target.log(&log);
    tell(&summary);
    if let Some(page) = &args.report {
        let page = page.clone().unwrap_or_else(|| report::page_of(&output));
        let (atlas, settings) = (session.mapper().atlas(), session.mapper().settings());
        let subject = Subject { atlas, settings, details: &details, run: Some(log), surface: &SurfaceArgs::default() };
        session.pool().install(|| reporting::write(&subject.report(&report::name_of(&output)), &page))?;
    }
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(if tally.interrupted { failure::INTERRUPTED } else { failure::DONE })
}

/// The scans to map, and how many are not among them.
struct Selection {
    source: Source,
    held_out: Arc<AtomicUsize>,
}

impl Selection {
    /// Opens the data, says what was found, and leaves out what is to be left out.
    fn open(args: &MapArgs) -> anyhow::Result<Self> {
        let mut source = args.data.open(args.strict)?;
        source.description().lines().for_each(|line| tracing::info!("{line}"));
        if let Some(most) = args.max_scans {
            source.limit(most);
        }
        let held_out = args.hold_out.map(|hold_out| hold_out.drop_held(&mut source)).unwrap_or_default();
        Ok(Self { source, held_out })
    }
}

/// Feeds the events to the mapper until they end or the user has enough.
fn integrate(selection: &Selection, args: &MapArgs, session: &mut Session, quiet: bool) -> anyhow::Result<Tally> {
    let clock = Instant::now();
    let Selection { source, held_out } = selection;
    let mut tally = Tally::default();
    let mut progress = Progress::new("scans", source.scans().map(|n| n as u64), quiet);
    let mut skip = |problem: anyhow::Error| -> anyhow::Result<()> {
        if args.strict {
            return Err(problem.context("a scan cannot be used (--strict); no map was written"));
        }
        tracing::warn!("scan skipped: {problem}");
        tally.skipped += 1;
        Ok(())
    };
    let mut corrector = args.elastic.corrector();
    let mut events = source.events();
    session.in_spare_time(|| events.chore());
    for event in events {
        let is_scan = !matches!(event, Ok(Event::OdometryEdge(_) | Event::LoopEdge(_) | Event::PoseUpdate(_)));
        let first = session.scans() == 0;
        match event.map_err(anyhow::Error::from).and_then(|event| corrector.take(event, session)) {
            Ok(events) => events.into_iter().try_for_each(|event| session.take(event).map_or_else(|e| skip(e.into()), |_| Ok(())))?,
            Err(problem) => skip(problem)?,
        }
        if let (true, Some(sensor)) = (first && session.scans() == 1, session.mapper().sensor()) {
            tracing::info!("sensor: {sensor}");
        }
        if is_scan {
            progress.step(|| {
                let read = source.progress().map_or_else(String::new, |part| format!("{:.0} % read, ", part * 100.0));
                format!("{read}{} submaps", session.mapper().atlas().submaps().len())
            });
        }
        if interrupt::requested() {
            tally.interrupted = true;
            break;
        }
    }
    tally.mapping_s = clock.elapsed().as_secs_f64();
    tally.skipped += source.without_pose();
    tally.held_out = held_out.load(Ordering::Relaxed);
    let last = corrector.last(session).and_then(|event| event.map_or(Ok(()), |event| Ok(session.take(event).map(|_| ())?)));
    if let Err(problem) = last {
        tracing::warn!("the last correction is missing: {problem:#}");
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
        submap_moves: log.submap_moves,
        groups_apart: log.groups_apart,
        loops: log.loops,
        corrections: log.corrections,
        submaps_rebuilt: tally.rebuilt,
        field: settings.field.name(),
        voxel_m: settings.voxel,
        max_range_m: settings.max_range,
        sensor: mapper.sensor().unwrap_or_default().to_owned(),
        threads: session.threads(),
        times: session.times(),
        mapping_s: tally.mapping_s,
        total_s: clock.elapsed().as_secs_f64(),
        peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
        map_mb: usage::megabytes(atlas.bytes() as u64),
        file_mb: usage::megabytes(saved.bytes),
        blocks: atlas.submaps().iter().map(|s| s.tsdf.len()).sum(),
    }
}

/// The outcome in three lines.
fn tell(s: &Summary) {
    let skipped = if s.scans_skipped > 0 { format!(", {} skipped", s.scans_skipped) } else { String::new() };
    let held_out = if s.scans_held_out > 0 { format!(", {} held out", s.scans_held_out) } else { String::new() };
    tracing::info!("{} scans{skipped}{held_out} in {:.1} s; {} submaps, {:.0} MB in memory", s.scans, s.total_s, s.submaps, s.map_mb);
    let spread = &s.times.integrate_ms;
    if let (Some(median), Some(p95)) = (spread.median, spread.p95) {
        tracing::info!("integration: median {median:.1} ms, 95 % within {p95:.1} ms a scan, {} threads", s.threads);
    }
    tracing::info!("saved {} ({:.1} MB)", s.output.display(), s.file_mb);
}

/// The map directory while it is being made. A run that fails leaves what was there before, which may be nothing.
struct Target(Option<MapWriter>);

impl Target {
    fn create(path: &Path) -> anyhow::Result<Self> {
        Ok(Self(Some(MapWriter::create(path).context("cannot write the map there")?)))
    }

    fn save(&mut self, session: &Session, details: &MapDetails) -> anyhow::Result<SaveReport> {
        let writer = self.0.as_mut().context("the map was given up before it was saved")?;
        let atlas = session.mapper().atlas();
        session.pool().install(|| writer.save(atlas, details)).context("cannot save the map")
    }

    /// Puts the log of the run beside the saved map. The map is worth having without it.
    fn log(&mut self, log: &RunLog) {
        let Some(writer) = &mut self.0 else { return };
        let written = log.to_json().map_err(anyhow::Error::from).and_then(|text| Ok(writer.write_run_log(&text)?));
        if let Err(problem) = written {
            tracing::warn!("no log of the run is kept, so a later report has no charts of it: {problem:#}");
        }
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        if let Some(writer) = self.0.take() {
            writer.abandon();
        }
    }
}

/// Where the map goes: what the user said, or the name of the data with `.vox` in the current directory.
fn output_path(args: &MapArgs) -> anyhow::Result<PathBuf> {
    if let Some(path) = &args.output {
        return Ok(path.clone());
    }
    let data = args.data.path();
    let named = data.file_name().map(|_| data.to_owned()).or_else(|| data.canonicalize().ok());
    match named.as_deref().and_then(Path::file_name) {
        Some(name) => Ok(PathBuf::from(format!("{}.vox", name.to_string_lossy()))),
        None => Err(Failure::usage(format!("{}: no name to call the map after", data.display()), "give one with -o MAP.vox").into()),
    }
}
