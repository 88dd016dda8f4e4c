//! `voxelastic live`: maps scans as they come.

mod delays;
mod exploring;
mod figures;
mod loading;
mod network;
mod node;
mod offers;
mod ouster_address;
mod positions;
pub mod rate;
mod service;
mod source;
mod spinning_address;
mod tally;
#[cfg(test)]
mod tests;

use crate::args::{CorrectionArgs, DataArgs, ReadingArgs, ResumeArgs, SaveArgs, SettingFlags};
use crate::failure::{self, Failure};
use crate::watching::{ADDRESS, DetailArgs, Watch};
use crate::{allocator, interrupt, output};
use clap::Args;
use exploring::{ExplorationSummary, Exploring, ExploringArgs};
use network::{Network, NetworkArgs};
use node::{Node, OnNetwork, Requests};
use offers::{InputRecording, Offers};
use ouster_address::OusterAddress;
use rate::Rate;
use serde::Serialize;
use service::Service;
use source::Source;
use spinning_address::SpinningAddress;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::mpsc::channel;
use std::time::Instant;
use tally::Tally;
use voxelastic::settings::Settings;
use voxelastic_eval::SeriesStats;
use voxelastic_live::feed::{Feed, FeedCounts};
use voxelastic_live::planner::PlannerSettings;
use voxelastic_live::ros::services::RequestSender;
use voxelastic_live::viewer::Control;
use voxelastic_report::RunLog;
use voxelastic_run::corrections::ClosureSummary;
use voxelastic_run::keep::{self, CheckpointSummary, Comes, Identity, Target, Unfinished};
use voxelastic_run::mapping::TimeSummary;
use voxelastic_run::poses::{OdometrySummary, Poses};
use voxelastic_run::{Corrections, MappingRun, Plan, Warning, Warnings, threads, usage};

/// Map scans as they come, as on a robot
///
/// The input is a recording, or a folder of scans, that is played at its own speed or another: each scan comes when its time stamp says, and waits for nothing.
/// Or it is a robot: with --ros2, scans come from topics, with poses by topic or /tf, or estimated; the topics are found by their types. With --ouster or --velodyne they are the packets of a sensor.
/// When scans come faster than they can be mapped, four wait (sixteen that came within 0.4 s), and the newest win: for each that comes, the oldest that waits is left out and
/// counted; edges and corrected poses are never left out. With `--rate max` every scan is mapped, as fast as possible.
/// Where no scan is left out, the map is that of `voxelastic map`, bit for bit.
/// Ctrl-C or a termination request ends the input; what has come is mapped and the map is saved. While it maps, it keeps what it has in the folder
/// `unfinished` of the map, a map itself, when no scan waits: the same command goes on after the process was killed or the power failed. A recording goes on from
/// where it was. Scans of a robot, which may have moved meanwhile, are found in the map first, by their poses or by the places that they show; if twenty
/// are not, a new map begins, and that of before is set aside under another name.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic live --from drive.mcap                     as it was recorded, with the poses in it; writes drive.mcap.vox
  voxelastic live --from drive.mcap --rate 4 --every scan   every scan, four times as fast
  voxelastic live --from drive.mcap --view              and a page that shows it: http://127.0.0.1:7717
  voxelastic live --from kitti00 --slam --json          poses by odometry and loop closures; statistics on stdout
  voxelastic live --ros2 --view                         the topics of a robot, until Ctrl-C; writes live.vox
  voxelastic live --ros2=zenoh --cloud-topic /os/points --slam -o site.vox
  voxelastic live --from drive.mcap --ros2              play a recording, and publish its map
  voxelastic live --ros2 --field both --explore --every 0.5m   and publish where to go next
  voxelastic live --ouster os-122312.local --view       straight from an Ouster sensor, without a driver
  voxelastic live --velodyne 192.168.1.201 --view       straight from a Velodyne, Hesai or RoboSense")]
pub struct LiveArgs {
    /// Folder with scans, or a recording, to be played: as for `voxelastic map`
    #[arg(long, value_name = "DATA", required_unless_present_any = ["ros2", "ouster", "velodyne"])]
    from: Option<PathBuf>,
    /// An Ouster sensor: its name or address, which is asked what it is, or the port to which packets come (with --metadata). Poses are estimated
    #[arg(long, value_name = "HOST|PORT", value_parser = OusterAddress::parse, conflicts_with = "from")]
    ouster: Option<OusterAddress>,
    /// A Velodyne, a Hesai or a RoboSense, which its packets tell: its name or address, or the port to which packets come (2368 unless it is given; 6699 is usual for RoboSense). Poses are estimated
    #[arg(long, visible_aliases = ["hesai", "robosense"], value_name = "HOST[:PORT]|PORT", value_parser = SpinningAddress::parse, conflicts_with_all = ["from", "ouster"])]
    velodyne: Option<SpinningAddress>,
    /// Speed at which it is played: 1 is its own, `max` as fast as it can be mapped, with no scan left out
    #[arg(long, value_name = "RATE", default_value = "1", value_parser = Rate::parse)]
    rate: Rate,
    /// Serve a page that shows the map while it grows, and after the end of the input until Ctrl-C. Without an address on this machine only, at
    /// 127.0.0.1:7717; port 0 is one that is free
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, require_equals = true, default_missing_value = ADDRESS)]
    view: Option<SocketAddr>,
    /// Let those control the node over HTTP who know the token in this file: POST /save, /mesh, /pause, /resume, /reset, and /load with the path of a saved map, at
    /// the viewer's address; with --explore also /explore, /explore/pause and /explore/home
    #[arg(long, value_name = "FILE", requires = "view")]
    token: Option<PathBuf>,
    #[command(flatten)]
    detail: DetailArgs,
    /// The map to write, a directory [default: the name of DATA with .vox, in the current directory]
    #[arg(short, long, value_name = "MAP.vox")]
    output: Option<PathBuf>,
    /// Estimate the poses from the scans, even if the data have some
    #[arg(long)]
    slam: bool,
    #[command(flatten)]
    save: SaveArgs,
    #[command(flatten)]
    resume: ResumeArgs,
    /// Print statistics as one JSON object on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    network: NetworkArgs,
    #[command(flatten)]
    exploring: ExploringArgs,
    #[command(flatten)]
    reading: ReadingArgs,
    #[command(flatten)]
    corrections: CorrectionArgs,
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
    /// Of these, scans that an earlier process had mapped, with whose run this one has gone on.
    scans_resumed: usize,
    /// Scans that came, with those that came to an earlier process.
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
    /// From the coming of a scan to the first change of the surface after it in the viewer's server, milliseconds; empty without `--view`.
    shown_ms: SeriesStats,
    /// The same: 99 of 100 scans are within it; `null` without `--view`.
    shown_p99_ms: Option<f64>,
    /// How much later than its time stamp says a scan was read, at most, milliseconds: decoding that cannot keep up; 0 with `--rate max`.
    late_ms: f64,
    /// Scans that were ignored, because mapping was paused on request.
    scans_paused: usize,
    /// Messages of topics that were not looked at, because those before them took too long.
    messages_lost: usize,
    /// Figures of the odometry; `null` where the data have poses.
    odometry: Option<OdometrySummary>,
    /// Loop closures that were tried; `null` where none were looked for.
    closures: Option<ClosureSummary>,
    /// What was planned; `null` without `--explore`.
    exploration: Option<ExplorationSummary>,
    /// Checkpoints that were written.
    checkpoints: CheckpointSummary,
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
    /// What the run had to say that is no error, each with a stable `code`, `text`, `remedy` and `count`.
    warnings: Vec<Warning>,
}

/// What is to be mapped, told and kept.
struct Play<'a> {
    /// What is mapped, for the title of the viewer and for messages.
    name: &'a Path,
    settings: Settings,
    corrections: Corrections,
    /// Where the viewer is, if there is one, and who may control the node by it.
    view: Option<(SocketAddr, DetailArgs)>,
    token: Option<&'a Path>,
    /// Where the map is kept, if it is.
    kept: Option<(&'a Path, SaveArgs, ResumeArgs)>,
    /// The network, if there is one, and what is planned for it.
    network: Option<&'a NetworkArgs>,
    planner: Option<PlannerSettings>,
    /// Whether it comes from a robot, which may deliver nothing for long.
    is_robot: bool,
    prints_json: bool,
}

/// What came of a run, beside its map.
struct Played {
    tally: Tally,
    skipped: usize,
    counts: FeedCounts,
    late_ms: f64,
    messages_lost: usize,
    played_s: f64,
    start: Instant,
}

/// Runs the command.
pub fn run(args: &LiveArgs, quiet: bool) -> anyhow::Result<u8> {
    if args.from.is_none() && args.corrections.rebuilds() {
        let remedy = "record the topics, and map the recording with it";
        return Err(Failure::usage("submaps cannot be rebuilt: the scans of a robot are not kept".to_owned(), remedy).into());
    }
    let output = keep::path(args.output.as_deref(), args.name())?;
    args.play(&output, quiet, |network, recording, threads| args.source(network, recording, threads))
}

/// Maps `data` with the usual settings, for the viewer at `address` only.
pub fn watch(data: &Path, rate: Option<Rate>, address: SocketAddr, detail: DetailArgs, quiet: bool) -> anyhow::Result<u8> {
    let corrections = Corrections::default();
    let play = Play {
        name: data,
        settings: Settings::default(),
        corrections,
        view: Some((address, detail)),
        token: None,
        kept: None,
        network: None,
        planner: None,
        is_robot: false,
        prints_json: false,
    };
    let data = DataArgs::at(data, &ReadingArgs::default());
    play.run(
        quiet,
        |_: &Source, _: &Settings| Identity::default(),
        |_, _, threads| Source::recording(&data, rate.unwrap_or_default(), false, corrections.pose_kind(), threads).map(Some),
    )
}

impl LiveArgs {
    /// What is mapped, for the name of the map and the title of the viewer.
    fn name(&self) -> &Path {
        self.from.as_deref().unwrap_or(Path::new("live"))
    }

    /// Maps what comes from the source that `open` opens.
    fn play(
        &self,
        output: &Path,
        quiet: bool,
        open: impl FnOnce(Option<&mut Network>, Option<&InputRecording>, usize) -> anyhow::Result<Option<Source>>,
    ) -> anyhow::Result<u8> {
        let mut settings = self.settings.resolve()?;
        let planner = self.exploring.prepare(&mut settings, self.network.publishes())?;
        let play = Play {
            name: self.name(),
            settings,
            corrections: self.corrections.corrections(),
            view: self.view.map(|address| (address, self.detail)),
            token: self.token.as_deref(),
            kept: Some((output, self.save, self.resume)),
            network: Some(&self.network),
            planner,
            is_robot: self.from.is_none(),
            prints_json: self.json,
        };
        play.run(quiet, |source, settings| self.identity(settings, source), open)
    }

    /// What decides about the bits of the map; for the topics of a robot, what must not change.
    fn identity(&self, settings: &Settings, source: &Source) -> Identity {
        let passing = match (&self.ouster, &self.velodyne) {
            (Some(_), _) => "ouster",
            (_, Some(_)) => "velodyne",
            _ => "topics",
        };
        let path = self.from.as_deref().unwrap_or(Path::new(passing));
        let data = source.recorded().map_or_else(|| path.display().to_string(), |input| format!("{:016x}", input.fingerprint()));
        Identity::new(settings)
            .with("command", "live")
            .with("data", data)
            .with("reading", DataArgs::at(path, &self.reading).identity())
            .with("poses by odometry", source.odometry.is_some())
            .with("corrections", self.corrections.corrections().identity())
            .with("poses in the frame of a network", self.network.publishes())
    }

    /// Where scans come from; none if an interrupt came before they did.
    fn source(&self, network: Option<&mut Network>, recording: Option<&InputRecording>, threads: usize) -> anyhow::Result<Option<Source>> {
        if let Some(sensor) = &self.velodyne {
            return Source::spinning(sensor, &self.reading, threads).map(Some);
        }
        match (&self.from, &self.ouster, network) {
            (Some(data), ..) => {
                let pose_kind = self.corrections.corrections().pose_kind();
                Source::recording(&DataArgs::at(data, &self.reading), self.rate, self.slam, pose_kind, threads).map(Some)
            }
            (None, Some(sensor), _) => Source::ouster(sensor, &self.reading, threads).map(Some),
            (None, None, Some(network)) => Source::topics(network, &self.reading, &self.network, self.slam, recording, threads),
            (None, None, None) => anyhow::bail!("neither a recording nor a network"),
        }
    }
}

impl Play<'_> {
    /// How the node is controlled over HTTP, if it is.
    fn control(&self, requests: &RequestSender) -> anyhow::Result<Option<Control>> {
        let Some(file) = self.token else { return Ok(None) };
        let text = std::fs::read_to_string(file)
            .map_err(|e| Failure::new(format!("{}: cannot read the token: {e}", file.display()), "name a file with a token"))?;
        let control = Control::new(requests.clone(), text.trim());
        let remedy = "make one with: head -c 32 /dev/urandom | base64";
        Ok(Some(control.ok_or_else(|| Failure::new(format!("{}: a token has 16 characters or more, without spaces", file.display()), remedy))?))
    }

    fn watch(&self, requests: &RequestSender) -> anyhow::Result<Option<Watch>> {
        self.view.map(|(address, detail)| Watch::start(self.name, address, detail, self.control(requests)?)).transpose()
    }

    fn nothing(&self, what: &str) -> Failure {
        Failure::new(format!("{}: {what}; no map was written", self.name.display()), "")
    }

    /// The run, anew or where an unfinished one is, and what comes to it. None if an interrupt came before a recording was read up to there.
    fn begin(&self, source: &mut Source, unfinished: Option<Unfinished>, pool: rayon::ThreadPool) -> anyhow::Result<MappingRun> {
        let poses = source.odometry.take().map_or(Poses::Given, |stage| Poses::Estimated(Box::new(stage)));
        let (settings, comes) = (self.settings.clone(), source.comes());
        let plan = Plan { settings, corrections: self.corrections, poses, sensor: source.sensor.clone(), comes };
        let Some(mut unfinished) = unfinished else { return Ok(MappingRun::new(plan, pool)?) };
        if let Some(input) = source.recorded() {
            input.know_motions(unfinished.motions());
        }
        Ok(MappingRun::resumed(plan, pool, unfinished, source.clouds().as_mut())?)
    }

    /// Maps what comes from the source that `open` opens, and saves the map if it is kept.
    fn run(
        self,
        quiet: bool,
        identity: impl FnOnce(&Source, &Settings) -> Identity,
        open: impl FnOnce(Option<&mut Network>, Option<&InputRecording>, usize) -> anyhow::Result<Option<Source>>,
    ) -> anyhow::Result<u8> {
        let start = Instant::now();
        allocator::give_back_large_pieces();
        self.settings.validate()?;
        self.settings.limit_memory()?;
        let pool = threads::pool(self.settings.threads)?;
        interrupt::install(if self.kept.is_some() { "mapping what has come and saving the map" } else { "closing the viewer" });
        let mut network = self.network.map(|args| Network::join(args, &self.settings)).transpose()?.flatten();
        let recording = self.network.and_then(|args| args.record.as_deref()).map(InputRecording::begin).transpose()?;
        let (sender, pending) = channel();
        let requests = RequestSender::new(sender);
        // A robot may publish nothing for long: meanwhile it can be asked how the node is. What is wrong with a recording is said before where the page is.
        let early = if self.is_robot { self.watch(&requests)? } else { None };
        let Some(mut source) = open(network.as_mut(), recording.as_ref(), pool.current_num_threads())? else {
            return Err(self.nothing("interrupted before the topics were there").into());
        };
        let (mut warnings, comes) = (Warnings::default(), source.comes());
        let mut unfinished = None;
        let kept = match self.kept {
            Some((output, save, resume)) => {
                let mut target = Target::create(output, save.into(), &mut warnings)?;
                let identity = identity(&source, &self.settings);
                unfinished = resume.resume().find_or_set_aside(&mut target, &identity, &mut warnings)?;
                Some((target, identity, resume.checkpoints))
            }
            None => None,
        };
        let position = unfinished.as_mut().and_then(|found| found.position.take());
        let frames = source.frames.clone();
        // Of a recording, clouds can be read again only once it was played.
        let Some(transport) = source.play(position) else {
            return Err(Failure::new("interrupted before the run went on; it can still be gone on with", "").into());
        };
        let mut run = self.begin(&mut source, unfinished, pool)?;
        if let Some((target, identity, every)) = kept {
            run = run.kept_in(target, identity, every, comes, &[]);
            run.keep_log_on_disk();
        }
        run.warnings_mut().append(warnings);
        let watch = if early.is_some() { early } else { self.watch(&requests)? };
        let offers = self.network.map(|args| Offers::announce(args, network.as_mut(), &requests, self.planner.is_some())).transpose()?.flatten();
        let exploring = self.planner.map(Exploring::start).transpose()?;
        let on_network = offers.zip(self.network).map(|(mut offers, args)| {
            if let Some(frames) = frames.clone().filter(|_| args.use_sim_time) {
                offers.outputs.set_clock(move || frames.clock());
            }
            // Others on the network get poses and surfaces in the frame in which poses came.
            run.keep_frame();
            OnNetwork { node: args.node.clone(), offers, frames, exploring }
        });
        let feed = Feed::start(transport, source.overload())
            .map_err(|e| Failure::new(format!("cannot start a thread: {e}"), "end other programs, or raise the limit of processes"))?;
        let mut node = Node::new(source.positions(), watch, on_network);
        if run.scans_resumed() > 0 {
            node.show_before(run.mapping());
        }
        let (tally, watch) = node.run(&feed, &mut run, Requests { pending, service: Service::default() }, quiet);
        if tally.not_located > 0 {
            tracing::warn!("{} scans are not in the map: where they belong in what was mapped before was not found until the end", tally.not_located);
        }
        let played_s = start.elapsed().as_secs_f64();
        if run.scans() == 0 {
            let what = if interrupt::requested() { "interrupted before the first scan was mapped" } else { "no scan could be mapped" };
            return Err(self.nothing(what).into());
        }
        run.complete(source.clouds().as_mut(), |_, _| !interrupt::requested());
        let played = Played {
            skipped: run.skipped() + source.without_pose(),
            tally,
            counts: feed.counts(),
            late_ms: source.late().as_secs_f64() * 1e3,
            messages_lost: source.lost(),
            played_s,
            start,
        };
        if self.kept.is_some() {
            save(&mut run, &played, self.prints_json)?;
        }
        // Nothing but an interrupt ends a robot's topics, so nobody looks at their map afterwards.
        let ended = played.tally.interrupted && !self.is_robot;
        if !ended {
            run.discard_checkpoints();
        }
        if let Some(mut watch) = watch.filter(|_| comes == Comes::Again && !played.tally.interrupted) {
            let mapping = run.mapping();
            watch.publisher.note(mapping.mapper(), None);
            let figures = figures::figures("finished", played.counts.left_out, played.tally.delays_ms.last(), mapping);
            watch.stay(mapping.atlas(), mapping.pool(), figures);
        }
        Ok(match () {
            () if source.is_broken() => failure::BUG,
            () if run.target().is_some_and(Target::is_elsewhere) => failure::ELSEWHERE,
            () if ended => failure::INTERRUPTED,
            () => failure::DONE,
        })
    }
}

/// Saves the map with the log of the run, and prints the results.
fn save(run: &mut MappingRun, played: &Played, prints_json: bool) -> anyhow::Result<()> {
    let saved = run.save()?;
    let log =
        RunLog { total_s: played.start.elapsed().as_secs_f64(), interrupted: played.tally.interrupted, scans_skipped: played.skipped, ..run.log() };
    run.save_log(&log);
    let summary = summarise(run, played, saved.bytes);
    log_summary(&summary);
    if prints_json { output::print_json(&summary) } else { Ok(()) }
}

fn summarise(run: &MappingRun, played: &Played, bytes: u64) -> Summary {
    let (mapping, before) = (run.mapping(), run.position().before());
    let (log, atlas) = (mapping.log(), mapping.atlas());
    Summary {
        output: run.target().map(|target| target.path().to_owned()).unwrap_or_default(),
        scans: run.scans(),
        scans_resumed: run.scans_resumed(),
        scans_came: before.scans + played.counts.scans,
        scans_left_out: before.left_out + played.counts.left_out,
        scans_skipped: played.skipped,
        interrupted: played.tally.interrupted,
        submaps: atlas.submaps().len(),
        loops: log.loops.len(),
        corrections: log.corrections.len(),
        submap_moves: log.submap_moves,
        delay_ms: played.tally.delays_ms.stats(),
        delay_p99_ms: played.tally.delays_ms.quantile(0.99),
        shown_ms: played.tally.shown_ms.stats(),
        shown_p99_ms: played.tally.shown_ms.quantile(0.99),
        late_ms: played.late_ms,
        scans_paused: played.tally.paused,
        messages_lost: played.messages_lost,
        odometry: run.odometry(),
        closures: run.closures(),
        exploration: played.tally.exploration.clone(),
        checkpoints: run.checkpoints(),
        threads: mapping.threads(),
        times: mapping.times(),
        played_s: played.played_s,
        total_s: played.start.elapsed().as_secs_f64(),
        peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
        map_mb: usage::megabytes(atlas.bytes() as u64),
        file_mb: usage::megabytes(bytes),
        warnings: run.warnings().all().to_vec(),
    }
}

/// Logs the results in a few lines.
fn log_summary(s: &Summary) {
    let skipped = if s.scans_skipped > 0 { format!(", {} skipped", s.scans_skipped) } else { String::new() };
    let resumed = if s.scans_resumed > 0 { format!(", {} of them by an earlier process,", s.scans_resumed) } else { String::new() };
    tracing::info!(
        "{} of {} scans mapped{skipped}{resumed} in {:.1} s; {} submaps, {:.0} MB in memory",
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
