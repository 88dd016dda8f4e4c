//! `voxelastic map`: builds a map from a folder of scans and poses, or from a recording.

use crate::args::data::hold_out;
use crate::args::{AlignArgs, CorrectionArgs, DataArgs, ResumeArgs, SaveArgs, SettingFlags};
use crate::commands::report;
use crate::failure::{self, Failure};
use crate::meshing::{Fused, SurfaceArgs};
use crate::progress::Progress;
use crate::reporting::{self, Subject};
use crate::{interrupt, output};
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use voxelastic::memory::keep_arrays_in_file;
use voxelastic::settings::{Dynamic, Settings};
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_report::{Correction, LoopEdge, RunLog};
use voxelastic_run::corrections::ClosureSummary;
use voxelastic_run::joining::{self, SessionSummary};
use voxelastic_run::keep::{self, CheckpointSummary, Comes, Identity, Target, Unfinished};
use voxelastic_run::mapping::TimeSummary;
use voxelastic_run::poses::{OdometrySummary, Poses};
use voxelastic_run::{HoldOut, Inputs, MappingRun, Plan, PosesCheck, SavedSession, Source, Warning, Warnings, map_files, threads, usage};

/// Map a folder of scans, or a recording, with or without poses
///
/// Scans (PCD, PLY, KITTI .bin) are searched in scans/, Scans/, velodyne/, clouds/ and the folder itself; pose files are found by name and
/// content (TUM, KITTI 3x4 rows, Newer College CSV, g2o). In recordings (ROS 1 .bag, ROS 2 MCAP and sqlite3) the topics of clouds and poses are
/// found by their types. Without poses, they are estimated from the scans. Where the choice is ambiguous, the candidates are listed. Scans that cannot be used are skipped, counted and reported.
/// The map is saved after the last scan, or after the current one on Ctrl-C; an existing map of the same name is replaced,
/// but not by one of fewer scans: that is saved next to it. While it maps, it keeps what it has in the map's directory: the same command goes on after
/// the process was killed, and the map is the same as without that.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic map hall                                   writes hall.vox here
  voxelastic map hall -o maps/hall.vox --voxel-size 0.05
  voxelastic map kitti00 --poses groundtruth            if there are several pose files
  voxelastic map drive.bag                              with the poses in it; without any, by odometry
  voxelastic map drive.bag --poses slam.tum             poses of another program, matched by time
  voxelastic map DATA --t-base-lidar \"0 0 1.7 0 0 0 1\"   the poses in the files are those of the vehicle
  voxelastic map drive.bag --dynamic=remove --dynamic-points moving.ply
  voxelastic map hall --report                          also writes hall.html, for a browser
  voxelastic map tuesday.bag --into hall.vox            go on with a saved map: adds a session to it
  voxelastic map DATA --config mapping.toml --json      settings from a file, results on stdout")]
pub struct MapArgs {
    #[command(flatten)]
    data: DataArgs,
    /// The map to write, a directory [default: the name of DATA with .vox, in the current directory]
    #[arg(short, long, value_name = "MAP.vox")]
    output: Option<PathBuf>,
    /// Add the scans to this saved map, as a session of their own. Its settings are the defaults; a session whose place in it is not found is saved as a map of its own (exit code 3)
    #[arg(long, value_name = "MAP.vox", conflicts_with_all = ["output", "report", "overwrite"])]
    into: Option<PathBuf>,
    #[command(flatten)]
    align: AlignArgs,
    /// Estimate the poses from the scans, even if the data have some
    #[arg(long)]
    slam: bool,
    /// What to do about poses that do not fit the scans: warn, and name the reading that would; fix, take that reading; off, do not compare
    #[arg(long, value_name = "warn|fix|off", value_parser = poses_check, default_value = "warn", hide_short_help = true)]
    poses_check: PosesCheck,
    /// Leave out every Nth scan, for `voxelastic heldout`
    #[arg(long, value_name = "N", value_parser = hold_out, hide_short_help = true)]
    hold_out: Option<HoldOut>,
    /// Stop after this many scans
    #[arg(long, value_name = "N", hide_short_help = true)]
    max_scans: Option<usize>,
    #[command(flatten)]
    save: SaveArgs,
    /// Fail on the first scan that cannot be used, instead of skipping it
    #[arg(long, hide_short_help = true)]
    strict: bool,
    /// Write a report on the map and the run, an HTML page [default name: that of the map with .html, in the current directory]
    #[arg(long, value_name = "FILE.html", num_args = 0..=1, require_equals = true)]
    report: Option<Option<PathBuf>>,
    /// With --dynamic=remove: write the points on things that move as a cloud (PLY, map frame)
    #[arg(long, value_name = "FILE.ply", hide_short_help = true)]
    dynamic_points: Option<PathBuf>,
    /// Print the results as one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    resume: ResumeArgs,
    #[command(flatten)]
    corrections: CorrectionArgs,
    #[command(flatten)]
    settings: SettingFlags,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    /// The map.
    #[serde(serialize_with = "crate::output::path")]
    output: PathBuf,
    /// Scans integrated.
    scans: usize,
    /// Of these, scans that an earlier process had mapped, with whose run this one has gone on.
    scans_resumed: usize,
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
    /// Where the session lies in the map that it was added to; `null` without `--into`, and where that was not found.
    session: Option<SessionSummary>,
    /// Checkpoints that were written.
    checkpoints: CheckpointSummary,
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
    /// What was found when submaps were fused for the surface of the report; `null` without `--report`, and for a single submap.
    fused: Option<Fused>,
    /// What the run had to say that is no error, each with a stable `code`, `text`, `remedy` and `count`.
    warnings: Vec<Warning>,
}

/// What the run of the command knows beside the map.
struct Tally {
    skipped: usize,
    held_out: usize,
    rebuilt: usize,
    interrupted: bool,
    mapping_s: f64,
}

impl MapArgs {
    /// Opens the data, logs its description, and applies the limits on scans. The counter grows with each scan that is held out.
    fn source(&self, warnings: &mut Warnings) -> anyhow::Result<(Source, Arc<AtomicUsize>)> {
        let kind = self.corrections.corrections().pose_kind();
        let (mut source, _) = self.data.source(self.strict, self.slam, kind, self.poses_check, warnings)?;
        source.description().lines().for_each(|line| tracing::info!("{line}"));
        if let Some(most) = self.max_scans {
            source.limit(most);
        }
        let held_out = self.hold_out.map(|hold_out| source.remove_held_out(hold_out)).unwrap_or_default();
        Ok((source, held_out))
    }

    /// What decides about the bits of the map.
    fn identity(&self, settings: &Settings, source: &Source) -> Identity {
        let or_none = |number: Option<String>| number.unwrap_or_else(|| "none".to_owned());
        Identity::new(settings)
            .with("data", format!("{:016x}", source.fingerprint()))
            .with("reading", self.data.identity())
            .with("poses by odometry", source.is_raw())
            .with("corrections", self.corrections.corrections().identity())
            .with("--hold-out", or_none(self.hold_out.map(|n| n.to_string())))
            .with("--max-scans", or_none(self.max_scans.map(|n| n.to_string())))
            .with("--into", if self.into.is_some() { "a map" } else { "none" })
    }

    /// The settings, and the directory of the map.
    fn target(&self, warnings: &mut Warnings) -> anyhow::Result<(Settings, Target)> {
        let Some(map) = &self.into else {
            if self.align.align.is_some() {
                return Err(Failure::usage("--align says where a session lies in a map", "name the map with --into").into());
            }
            let settings = self.settings.resolve()?;
            return Ok((settings, Target::create(&self.path(self.output.as_deref())?, self.save.into(), warnings)?));
        };
        let base = map_files::settings_of(&map_files::open(map)?)?;
        let settings = self.settings.resolve_over(base.clone())?;
        joining::check_settings(map, &base, &settings, "leave them out of flags and file: those of the map are used")?;
        Ok((settings, Target::open(map, self.save.into())?))
    }

    fn path(&self, output: Option<&Path>) -> anyhow::Result<PathBuf> {
        Ok(keep::path(output, self.data.path())?)
    }

    /// The run, anew or where an unfinished one is, and what it is to be given. None if the user interrupts the reading again.
    fn begin(&self, source: &Source, settings: &Settings, unfinished: Option<Unfinished>) -> anyhow::Result<Option<(MappingRun, Inputs)>> {
        let pool = threads::pool(settings.threads)?;
        let poses = source.odometry(pool.current_num_threads())?.map_or(Poses::Given, |stage| Poses::Estimated(Box::new(stage)));
        let (corrections, comes) = (self.corrections.corrections(), Comes::Again);
        let plan = Plan { settings: settings.clone(), corrections, poses, sensor: source.sensor(), comes };
        let Some(mut unfinished) = unfinished else {
            return Ok(Some((MappingRun::new(plan, pool)?, source.inputs())));
        };
        // Of a recording, clouds can be read again only once it was played.
        let inputs = match unfinished.position.take() {
            Some(position) => source.inputs_from(position, interrupt::requested),
            None => Some(source.inputs()),
        };
        let Some(inputs) = inputs else { return Ok(None) };
        source.know_motions(unfinished.motions());
        Ok(Some((MappingRun::resumed(plan, pool, unfinished, source.clouds().as_mut())?, inputs)))
    }

    /// Gives the run all inputs, until they end or the user interrupts. Returns whether that was so.
    fn map(&self, run: &mut MappingRun, source: &Source, inputs: &mut Inputs, quiet: bool) -> anyhow::Result<bool> {
        let mut progress = Progress::new("scans", source.scans().map(|n| n as u64), quiet);
        if run.scans() > 0 {
            progress.start_after((run.scans() + run.skipped()) as u64);
        }
        run.set_idle_task(|| inputs.idle_task());
        while !run.is_full()
            && let Some(input) = inputs.next()
        {
            let (is_scan, sensors) = (input.is_scan(), run.mapping().mapper().sensor_count());
            let taken = run.take(input, &mut ());
            if let Some(problem) = taken.refused.first().filter(|_| self.strict) {
                return Err(anyhow::Error::msg(problem.clone()).context("a scan cannot be used (--strict); no map was written"));
            }
            run.note_position(inputs.read_position());
            if let (true, Some(sensor)) = (run.mapping().mapper().sensor_count() > sensors, run.mapping().mapper().sensor()) {
                tracing::info!("sensor: {sensor}");
            }
            if is_scan {
                progress.step(|| note(source, run));
            }
            if interrupt::requested() {
                // The map will have what came until now, and so has this.
                run.keep_now();
                return Ok(true);
            }
            run.keep(false);
        }
        Ok(false)
    }

    /// Saves the map; a session is added to the map that is there, or saved as a map of its own.
    fn save(&self, run: &mut MappingRun, digest: String, interrupted: bool) -> anyhow::Result<SavedSession> {
        if self.into.is_none() {
            return Ok(SavedSession { report: run.save()?, ..SavedSession::default() });
        }
        let apart = self.path(None)?;
        Ok(run.save_session(self.data.path(), digest, self.align.align, interrupted, &apart)?)
    }
}

fn poses_check(text: &str) -> Result<PosesCheck, String> {
    text.parse()
}

/// Runs the command.
pub fn run(args: &MapArgs, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let mut warnings = Warnings::default();
    let (settings, mut target) = args.target(&mut warnings)?;
    if args.dynamic_points.is_some() && settings.dynamic == Dynamic::Keep {
        return Err(Failure::usage("--dynamic-points: nothing is set aside with --dynamic keep", "add --dynamic remove").into());
    }
    let (source, held_out) = args.source(&mut warnings)?;
    let identity = args.identity(&settings, &source);
    let digest = identity.digest().context("the run cannot be described")?;
    if let Some(number) = args.into.as_ref().and(joining::session_of_run(target.store()?, &digest)) {
        let map = target.path().display();
        let remedy = format!("`voxelastic remove {map} --session {number}` takes it out");
        return Err(Failure::new(format!("session {number} of {map} is this run already: the same data and settings"), remedy).into());
    }
    // Before what was mapped of a run that did not end is read.
    settings.limit_memory()?;
    let unfinished = args.resume.resume().find(&mut target, &identity, &mut warnings)?;
    interrupt::install("finishing this scan and saving the map");

    let mapping_clock = Instant::now();
    let Some((run, mut inputs)) = args.begin(&source, &settings, unfinished)? else {
        return Err(Failure::new("interrupted before the run went on; it can still be gone on with", "").into());
    };
    let mut run = run.kept_in(target, identity, args.resume.checkpoints, Comes::Again, &[]);
    run.warnings_mut().append(warnings);
    if args.dynamic_points.is_some() {
        if run.scans() > 0 {
            tracing::warn!(
                "--dynamic-points: points that were set aside before the run was killed are not in the file; --restart maps from the beginning"
            );
        }
        run.mapping_mut().keep_moving_points();
    }
    let interrupted = args.map(&mut run, &source, &mut inputs, quiet)?;
    let mapping_s = mapping_clock.elapsed().as_secs_f64();
    run.finish(&mut ());
    if run.scans() == 0 {
        let (what, remedy) = if interrupted {
            ("interrupted before the first scan was integrated", "")
        } else {
            ("no scan could be integrated", "the warnings above give the reason for each scan")
        };
        return Err(Failure::new(format!("{}: {what}; no map was written", args.data.path().display()), remedy).into());
    }
    let mut progress = None;
    let rebuilt = run.complete(source.clouds().as_mut(), |done, all| {
        let progress = progress.get_or_insert_with(|| Progress::new("submaps rebuilt", all as u64, quiet));
        if done > 0 {
            progress.step(String::new);
        }
        !interrupt::requested()
    });
    drop(progress);
    let (skipped, held_out) = (run.skipped() + source.without_pose(), held_out.load(Ordering::Relaxed));
    let tally = Tally { skipped, held_out, rebuilt, interrupted, mapping_s };
    let saved = args.save(&mut run, digest, interrupted)?;
    if !interrupted {
        run.discard_checkpoints();
    }
    let (output, is_elsewhere) = run.target().map(|target| (target.path().to_owned(), target.is_elsewhere())).unwrap_or_default();
    let summary = Summary { session: saved.added, ..summarise(&run, &tally, saved.report.bytes, &output, clock) };
    let log =
        RunLog { total_s: summary.total_s, input: args.data.path().display().to_string(), interrupted, scans_skipped: tally.skipped, ..run.log() };
    if args.into.is_none() || is_elsewhere {
        run.save_log(&log);
    }
    if let Some(odometry) = &summary.odometry {
        odometry.log(summary.threads);
    }
    if let Some(closures) = &summary.closures {
        closures.log();
    }
    log_summary(&summary, saved.is_kept);
    if let Some(path) = &args.dynamic_points {
        write_moving_points(path, &run).with_context(|| format!("the map is saved as {}, but not the points on what moves", output.display()))?;
    }
    // No scan needs its arrays any more.
    keep_arrays_in_file(true);
    // A page that cannot be written is an error, but the map is there, and its summary, too.
    let mut summary = summary;
    let reported = args.report.as_ref().map_or(Ok(0), |page| {
        let page = page.clone().unwrap_or_else(|| report::page_of(&output));
        let (mapping, details) = (run.mapping(), run.details());
        let (atlas, settings) = (mapping.atlas(), mapping.mapper().settings());
        let subject = Subject { atlas, settings, details: &details, run: Some(log), surface: &SurfaceArgs::default() };
        let (report, figures) = mapping.pool().install(|| subject.report(&report::name_of(&output)));
        summary.fused = figures.fused;
        mapping.pool().install(|| reporting::write(&report, &page))
    });
    if args.json {
        output::print_json(&summary)?;
    }
    reported.with_context(|| format!("the map is saved as {}, but not its report", output.display()))?;
    Ok(match () {
        () if inputs.is_broken() => failure::BUG,
        () if is_elsewhere => failure::ELSEWHERE,
        () if interrupted => failure::INTERRUPTED,
        () => failure::DONE,
    })
}

/// What progress says beside the number of scans.
fn note(source: &Source, run: &MappingRun) -> String {
    let read = source.progress().map_or_else(String::new, |part| format!("{:.0} % read, ", part * 100.0));
    format!("{read}{} submaps", run.mapping().atlas().submaps().len())
}

/// Writes the points that were set aside because they are on something that moves.
fn write_moving_points(path: &Path, run: &MappingRun) -> anyhow::Result<()> {
    let positions = run.mapping().moving_points();
    write_ply(path, &MeshRef { positions, origin: run.origin().coordinates(), ..MeshRef::default() })?;
    tracing::info!("{} points on what moves in {}", positions.len(), path.display());
    Ok(())
}

fn summarise(run: &MappingRun, tally: &Tally, bytes: u64, output: &Path, clock: Instant) -> Summary {
    let (mapping, log) = (run.mapping(), run.mapping().log());
    let mapper = mapping.mapper();
    let (settings, atlas) = (mapper.settings(), mapper.atlas());
    Summary {
        output: output.to_owned(),
        scans: run.scans(),
        scans_resumed: run.scans_resumed(),
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
        session: None,
        checkpoints: run.checkpoints(),
        submaps_rebuilt: tally.rebuilt,
        odometry: run.odometry(),
        closures: run.closures(),
        field: settings.field.name(),
        voxel_m: settings.voxel_size,
        max_range_m: settings.max_range,
        sensor: mapper.sensor().unwrap_or_default().to_owned(),
        sensor_layout: mapper.sensor_layout().unwrap_or_default(),
        threads: mapping.threads(),
        times: mapping.times(),
        mapping_s: tally.mapping_s,
        total_s: clock.elapsed().as_secs_f64(),
        peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
        map_mb: usage::megabytes(atlas.bytes() as u64),
        file_mb: usage::megabytes(bytes),
        blocks: atlas.submaps().iter().map(|s| s.tsdf().len()).sum(),
        fused: None,
        warnings: run.warnings().all().to_vec(),
    }
}

/// Logs the results in three lines.
fn log_summary(s: &Summary, is_kept: bool) {
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
    if !is_kept {
        tracing::info!("saved {} ({:.1} MB)", s.output.display(), s.file_mb);
    }
}
