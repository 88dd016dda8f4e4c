//! `voxelastic live`: maps scans as they come.

mod node;
pub mod rate;

use crate::closure_summary::ClosureSummary;
use crate::config::SettingFlags;
use crate::data::{DataArgs, ReadingArgs};
use crate::elastic::ElasticArgs;
use crate::failure::{self, Failure};
use crate::input::Input;
use crate::mapping::{Session, TimeSummary};
use crate::odometry_log::OdometrySummary;
use crate::target::{self, OnFullDisk, Target};
use crate::watching::{ADDRESS, DetailArgs, Watch};
use crate::{interrupt, meshing, output, usage};
use clap::{Args, FromArgMatches};
use node::{Node, Tally};
use rate::Rate;
use serde::Serialize;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use voxelastic::mapper::Mapper;
use voxelastic::settings::Settings;
use voxelastic_eval::SeriesStats;
use voxelastic_io::store::{MapDetails, SaveReport};
use voxelastic_live::feed::{Feed, FeedCounts, Overload};
use voxelastic_live::replay::Replay;
use voxelastic_report::RunLog;

/// Map scans as they come, as on a robot
///
/// The input is a recording, or a folder of scans, that is played at its own speed or another: each scan comes when its time stamp says, and waits for nothing.
/// When scans come faster than they can be mapped, four wait, and the newest win: for each that comes, the oldest that waits is left out and
/// counted; edges and corrected poses are never left out. With `--rate max` every scan is mapped, as fast as possible.
/// Where no scan is left out, the map is that of `voxelastic map`, bit for bit.
/// Ctrl-C or a termination request ends the input; what has come is mapped and the map is saved.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic live --from drive.mcap                     as it was recorded, with the poses in it; writes drive.mcap.vox
  voxelastic live --from drive.mcap --rate 4 --every scan   every scan, four times as fast
  voxelastic live --from drive.mcap --view              and a page that shows it: http://127.0.0.1:7717
  voxelastic live --from kitti00 --slam --json          poses by odometry and loop closures; statistics on stdout")]
pub struct LiveArgs {
    /// Folder with scans, or a recording, to be played: as for `voxelastic map`
    #[arg(long, value_name = "DATA")]
    from: PathBuf,
    /// Speed at which it is played: 1 is its own, `max` as fast as it can be mapped, with no scan left out
    #[arg(long, value_name = "RATE", default_value = "1", value_parser = Rate::parse)]
    rate: Rate,
    /// Serve a page that shows the map while it grows, and after the end of the input until Ctrl-C. Without an address on this machine only, at
    /// 127.0.0.1:7717; port 0 is one that is free
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, require_equals = true, default_missing_value = ADDRESS)]
    view: Option<SocketAddr>,
    #[command(flatten)]
    detail: DetailArgs,
    /// The map to write, a directory [default: the name of DATA with .vox, in the current directory]
    #[arg(short, long, value_name = "MAP.vox")]
    output: Option<PathBuf>,
    /// Estimate the poses from the scans, even if the data have some
    #[arg(long)]
    slam: bool,
    /// Replace an existing map even if it has more scans than the new one
    #[arg(long)]
    overwrite: bool,
    /// What to do when the finished map cannot be written, because the disk is full for one
    #[arg(long, value_name = "WHAT", default_value = "elsewhere")]
    on_full_disk: OnFullDisk,
    /// Print statistics as one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: ReadingArgs,
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
    /// Scans that came.
    scans_came: usize,
    /// Scans that were left out, because newer ones came before they could be mapped.
    scans_left_out: usize,
    /// Scans that could not be used.
    scans_skipped: usize,
    /// Whether the run was ended by Ctrl-C or a termination request.
    interrupted: bool,
    /// Submaps in the map.
    submaps: usize,
    /// Loop edges.
    loops: usize,
    /// Pose corrections.
    corrections: usize,
    /// Root poses moved by corrections.
    submap_moves: usize,
    /// From the coming of a scan to the end of its integration, milliseconds.
    delay_ms: SeriesStats,
    /// The same: 99 of 100 scans are within it; `null` without scans.
    delay_p99_ms: Option<f64>,
    /// How much later than its time stamp says a scan was read, at most, milliseconds: decoding that cannot keep up; 0 with `--rate max`.
    late_ms: f64,
    /// Figures of the odometry; `null` where the data have poses.
    odometry: Option<OdometrySummary>,
    /// Loop closures that were tried; `null` where none were looked for.
    closures: Option<ClosureSummary>,
    /// Threads of the mapper.
    threads: usize,
    #[serde(flatten)]
    times: TimeSummary,
    /// From the start to the last scan, seconds.
    played_s: f64,
    /// From start to saved map, seconds.
    total_s: f64,
    /// Peak resident memory, megabytes (10^6 bytes); `null` where the system does not report it.
    peak_rss_mb: Option<f64>,
    /// Memory of the fields of the map, megabytes.
    map_mb: f64,
    /// Size of the map on disk, megabytes.
    file_mb: f64,
}

/// What came of a run, beside the session.
struct Run {
    tally: Tally,
    counts: FeedCounts,
    late_ms: f64,
    played_s: f64,
    start: Instant,
}

/// Runs the command.
pub fn run(args: &LiveArgs, quiet: bool) -> anyhow::Result<u8> {
    let output = target::path(args.output.as_deref(), &args.from)?;
    play(args, Some(&output), quiet)
}

/// Maps `data` with the usual settings, for the viewer at `address` only.
pub fn watch(data: &Path, rate: Option<Rate>, address: SocketAddr, detail: DetailArgs, quiet: bool) -> anyhow::Result<u8> {
    let command = LiveArgs::augment_args(clap::Command::new("live"));
    let mut args = LiveArgs::from_arg_matches(&command.try_get_matches_from(["live".as_ref(), "--from".as_ref(), data.as_os_str()])?)?;
    args.rate = rate.unwrap_or(args.rate);
    (args.view, args.detail) = (Some(address), detail);
    play(&args, None, quiet)
}

/// Maps what comes, and saves the map if there is an `output`.
fn play(args: &LiveArgs, output: Option<&Path>, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let settings = args.settings.resolve()?;
    let data = DataArgs::at(&args.from, &args.reading);
    let input = Input::open(&data, false, args.slam, args.elastic.pose_kind())?;
    input.description().lines().for_each(|line| tracing::info!("{line}"));
    let pool = meshing::pool(settings.threads)?;
    let mut mapper = Mapper::new(settings.clone()).map_err(|e| Failure::usage(e.to_string(), "see `voxelastic config`"))?;
    if let Some(model) = input.sensor() {
        mapper.set_sensor_model(model);
    }
    let mut target = output.map(|output| Target::create(output, args.overwrite, args.on_full_disk)).transpose()?;
    interrupt::install(if target.is_some() { "mapping what has come and saving the map" } else { "closing the viewer" });

    let mut session = Session::new(mapper, pool);
    let watch = args.view.map(|address| Watch::start(&args.from, address, args.detail)).transpose()?;
    let broken = Arc::new(AtomicBool::new(false));
    let replay = Replay::new(input.incoming(Arc::clone(&broken)), args.rate.factor());
    let lateness = replay.lateness();
    let overload = if args.rate.factor().is_some() { Overload::NewestWin } else { Overload::Wait };
    let feed = Feed::start(Box::new(replay), overload)
        .map_err(|e| Failure::new(format!("cannot start a thread: {e}"), "end other programs, or raise the limit of processes"))?;
    let odometry = input.odometry(session.threads())?;
    let (mut tally, watch) = Node::new(args.elastic.corrector(input.is_raw()), odometry, watch).run(&feed, &mut session, quiet);
    tally.skipped += input.without_pose();
    let played_s = clock.elapsed().as_secs_f64();
    if session.scans() == 0 {
        let what = if interrupt::requested() { "interrupted before the first scan was mapped" } else { "no scan could be mapped" };
        return Err(Failure::new(format!("{}: {what}; no map was written", args.from.display()), "").into());
    }
    args.elastic.finish(&input, &mut session, quiet);
    let late_ms = lateness.most().as_secs_f64() * 1e3;
    let run = Run { tally, counts: feed.counts(), late_ms, played_s, start: clock };
    if let Some(target) = &mut target {
        save(target, &settings, &session, &run, args.json)?;
    }
    let ended = run.tally.interrupted;
    if let Some(mut watch) = watch.filter(|_| !ended) {
        watch.publisher.note(session.mapper(), None);
        let figures = node::figures("finished", run.counts.left_out, run.tally.delays_ms.last().copied(), &session);
        watch.stay(session.mapper().atlas(), session.pool(), figures);
    }
    Ok(match () {
        () if broken.load(Ordering::Relaxed) => failure::BUG,
        () if target.is_some_and(|target| target.is_elsewhere()) => failure::ELSEWHERE,
        () if ended => failure::INTERRUPTED,
        () => failure::DONE,
    })
}

/// Saves the map with the log of the run, and prints the results.
fn save(target: &mut Target, settings: &Settings, session: &Session, run: &Run, prints_json: bool) -> anyhow::Result<()> {
    let details = MapDetails::describe(settings, session.mapper().sensor());
    let saved = target.save(session, &details)?;
    target.log(&RunLog {
        total_s: run.start.elapsed().as_secs_f64(),
        interrupted: run.tally.interrupted,
        scans_skipped: run.tally.skipped,
        ..session.log()
    });
    let summary = summarise(session, run, saved, target.path());
    log_summary(&summary);
    if prints_json { output::print_json(&summary) } else { Ok(()) }
}

fn summarise(session: &Session, run: &Run, saved: SaveReport, output: &Path) -> Summary {
    let (log, atlas) = (session.log(), session.mapper().atlas());
    Summary {
        output: output.to_owned(),
        scans: session.scans(),
        scans_came: run.counts.scans,
        scans_left_out: run.counts.left_out,
        scans_skipped: run.tally.skipped,
        interrupted: run.tally.interrupted,
        submaps: atlas.submaps().len(),
        loops: log.loops.len(),
        corrections: log.corrections.len(),
        submap_moves: log.submap_moves,
        delay_ms: SeriesStats::new(&run.tally.delays_ms),
        delay_p99_ms: run.tally.delay_quantile(0.99),
        late_ms: run.late_ms,
        odometry: run.tally.odometry.clone(),
        closures: run.tally.closures.clone(),
        threads: session.threads(),
        times: session.times(),
        played_s: run.played_s,
        total_s: run.start.elapsed().as_secs_f64(),
        peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
        map_mb: usage::megabytes(atlas.bytes() as u64),
        file_mb: usage::megabytes(saved.bytes),
    }
}

/// Logs the results in a few lines.
fn log_summary(s: &Summary) {
    let skipped = if s.scans_skipped > 0 { format!(", {} skipped", s.scans_skipped) } else { String::new() };
    tracing::info!(
        "{} of {} scans mapped{skipped} in {:.1} s; {} submaps, {:.0} MB in memory",
        s.scans,
        s.scans_came,
        s.played_s,
        s.submaps,
        s.map_mb
    );
    if s.scans_left_out > 0 {
        tracing::warn!("{} scans came faster than they could be mapped and were left out: the newest win", s.scans_left_out);
    }
    if let (Some(median), Some(p99)) = (s.delay_ms.median, s.delay_p99_ms) {
        tracing::info!("from a scan's coming to its being in the map: median {median:.1} ms, 99 % within {p99:.1} ms, {} threads", s.threads);
    }
    tracing::info!("map: {} ({:.1} MB)", s.output.display(), s.file_mb);
}
