//! A node: what comes is mapped, told to viewers and to others in a network, and kept.

mod delays;
mod exploring;
mod figures;
mod health;
mod listeners;
mod loading;
mod managed_state;
mod mapping_loop;
mod network;
mod offers;
mod played;
mod positions;
mod service;
mod source;
mod tally;
mod watch;

pub use exploring::ExplorationSummary;
pub use network::{Backend, NetworkSetup};
pub use played::Played;
pub use source::ScansFrom;
pub use watch::{Figures, ViewerSetup, Watch};

use crate::feed::Feed;
use crate::planner::PlannerSettings;
use crate::ros::lifecycle::State;
use crate::ros::services::RequestSender;
use crate::viewer::Control;
use exploring::Exploring;
use health::Rates;
use listeners::{Listeners, OnNetwork};
use managed_state::Waiting;
use mapping_loop::{Node, Requests};
use network::Network;
use offers::{InputRecording, Offers};
use service::Service;
use source::Source;
use std::path::PathBuf;
use std::sync::mpsc::channel;
use std::time::Instant;
use voxelastic::settings::{FieldKind, Settings};
use voxelastic_io::OpenOptions;
use voxelastic_run::keep::{CheckpointEvery, Identity, Resume, SaveOptions, Target, Unfinished};
use voxelastic_run::poses::Poses;
use voxelastic_run::{Corrections, Error, Mapping, MappingRun, Plan, Result, Warnings, threads};

/// What a node maps, tells and keeps.
#[derive(Clone, Debug)]
pub struct Setup {
    /// What is mapped, for the title of the viewer and for messages.
    pub name: PathBuf,
    /// How what comes is read.
    pub reading: OpenOptions,
    /// Settings of the mapper.
    pub settings: Settings,
    /// Loop closures and optimisation.
    pub corrections: Corrections,
    /// The viewer, if there is one.
    pub viewer: Option<ViewerSetup>,
    /// Where the map is kept, if it is.
    pub kept: Option<KeptIn>,
    /// What is published, and the network.
    pub network: Option<NetworkSetup>,
    /// Of a robot whose poses may be corrected, so many bytes of its scans are kept on disk, about: what corrections bend is rebuilt from them while the node runs.
    pub keep_scans: u64,
    /// Where to go next is planned, if asked for.
    pub planner: Option<PlannerSettings>,
    /// Whether the input is to end, which ends the node orderly: what has come is mapped and the map is kept.
    pub is_stopped: fn() -> bool,
}

/// Where a node keeps its map.
#[derive(Clone, Debug)]
pub struct KeptIn {
    /// The directory of the map.
    pub path: PathBuf,
    /// How it is saved.
    pub save: SaveOptions,
    /// Whether it goes on with a run that did not end.
    pub resume: Resume,
    /// When checkpoints are written.
    pub checkpoints: CheckpointEvery,
}

/// Maps what comes until it ends or is to end; the map is then complete, and not saved yet. `progress` is called after each scan. None if a robot was stopped before its first scan was
/// mapped.
///
/// # Errors
/// When nothing can be read or mapped, a network, a port or the directory of the map cannot be had, or settings are wrong.
pub fn play(setup: &Setup, from: ScansFrom, progress: &mut dyn FnMut(&Mapping)) -> Result<Option<Played>> {
    let start = Instant::now();
    let is_stopped = setup.is_stopped;
    setup.settings.validate()?;
    setup.settings.limit_memory()?;
    let pool = threads::pool(setup.settings.threads)?;
    let (is_robot, name) = (from.is_robot(), from.name());
    let mut network = setup.network.as_ref().map(|network| Network::join(network, &setup.settings)).transpose()?.flatten();
    let recording = setup.network.as_ref().and_then(|network| network.record.as_deref()).map(InputRecording::begin).transpose()?;
    let (sender, pending) = channel();
    let requests = RequestSender::new(sender);
    // A robot may publish nothing for long: meanwhile it can be asked how the node is. What is wrong with a recording is said before where the page is.
    let early = if is_robot { setup.watch(&requests)? } else { None };
    let managed = setup.network.as_ref().is_some_and(|network| network.lifecycle).then_some(network.as_mut()).flatten();
    let lifecycle = managed.map(|network| network.offer_states(&requests)).transpose()?;
    let waiting = Waiting::new(&pending, lifecycle.is_some());
    let is_over = || {
        waiting.answer();
        is_stopped() || waiting.state() == Some(State::Finalized)
    };
    let joined = network.as_mut().zip(setup.network.as_ref());
    let mut warnings = Warnings::default();
    let opened = Source::open(from, &setup.reading, joined, recording.as_ref(), pool.current_num_threads(), &is_over, &mut warnings)?;
    let state = waiting.state();
    let Some(mut source) = opened else { return Ok(setup.nothing_came("interrupted before the topics were there")) };
    let comes = source.comes();
    let mut unfinished = None;
    let kept = match &setup.kept {
        Some(kept) => {
            let mut target = Target::create(&kept.path, kept.save, &mut warnings)?;
            let identity = setup.identity(&source, &name);
            unfinished = kept.resume.find_or_set_aside(&mut target, &identity, &mut warnings)?;
            Some((target, identity, kept.checkpoints))
        }
        None => None,
    };
    let position = unfinished.as_mut().and_then(|found| found.position.take());
    let frames = source.frames.clone();
    // Of a recording, clouds can be read again only once it was played.
    let transport = source.play(position, is_stopped);
    let transport = transport.ok_or_else(|| Error::new("interrupted before the run went on; it can still be gone on with", ""))?;
    let mut run = setup.begin(&mut source, unfinished, pool)?;
    if let Some((target, identity, every)) = kept {
        run = run.kept_in(target, identity, every, comes, &[]);
        run.keep_log_on_disk();
    }
    run.warnings_mut().append(warnings);
    if is_robot && setup.keep_scans > 0 && setup.may_be_corrected(&run) {
        let folder = run.target().map_or_else(std::env::temp_dir, |target| target.path().to_owned());
        run.keep_scans(&folder, setup.keep_scans);
    }
    let watch = if early.is_some() { early } else { setup.watch(&requests)? };
    let explores = setup.planner.is_some();
    if network.is_some() && setup.settings.field == FieldKind::Occupancy {
        tracing::warn!("{}", voxelastic_run::export::grid::NO_SURFACES);
    }
    let offers = setup.network.as_ref().map(|network_setup| Offers::announce(network_setup, network.as_mut(), &requests, explores));
    let exploring = setup.planner.map(Exploring::start).transpose()?;
    let on_network = offers.transpose()?.flatten().zip(setup.network.as_ref()).map(|(mut offers, network_setup)| {
        if let Some(frames) = frames.clone().filter(|_| network_setup.use_sim_time) {
            offers.outputs.set_clock(move || frames.clock());
        }
        // Others on the network get poses and surfaces in the frame in which poses came.
        run.keep_frame();
        frames.iter().for_each(|frames| offers.outputs.set_frames(frames.clone()));
        let node = network_setup.names.full().trim_start_matches('/').to_owned();
        OnNetwork { node, offers, frames, heard: source.heard.clone(), rates: Rates::default(), exploring }
    });
    let feed = Feed::start(transport, source.overload())
        .map_err(|e| Error::new(format!("cannot start a thread: {e}"), "end other programs, or raise the limit of processes"))?;
    let mut listeners = Listeners::new(watch, on_network);
    if run.scans_resumed() > 0 {
        listeners.show_before(run.mapping());
    }
    let node = Node::new(source.positions(), listeners, state);
    let (tally, watch) = node.run(&feed, &mut run, Requests { pending, service: Service::default() }, is_stopped, progress);
    if tally.not_located > 0 {
        tracing::warn!("{} scans are not in the map: where they belong in what was mapped before was not found until the end", tally.not_located);
    }
    let played_s = start.elapsed().as_secs_f64();
    if run.scans() == 0 && is_robot && (is_stopped() || tally.interrupted) {
        return Ok(setup.nothing_came("interrupted before the first scan was mapped"));
    }
    if run.scans() == 0 {
        return Err(setup.nothing(if is_stopped() { "interrupted before the first scan was mapped" } else { "no scan could be mapped" }));
    }
    run.complete(source.clouds().as_mut(), |_, _| !is_stopped());
    Ok(Some(Played {
        scans_skipped: run.skipped() + source.without_pose(),
        scans_left_out: run.position().before().left_out + feed.counts().left_out,
        scans_came: run.position().before().scans + feed.counts().scans,
        late_ms: source.late().as_secs_f64() * 1e3,
        messages_lost: source.lost(),
        is_broken: source.is_broken(),
        is_robot,
        left_out_now: feed.counts().left_out,
        run,
        tally,
        watch,
        played_s,
        start,
    }))
}

impl Setup {
    /// How the node is controlled over HTTP, if it is.
    fn control(&self, viewer: &ViewerSetup, requests: &RequestSender) -> Result<Option<Control>> {
        let Some(file) = &viewer.token else { return Ok(None) };
        let text = std::fs::read_to_string(file)
            .map_err(|e| Error::new(format!("{}: cannot read the token: {e}", file.display()), "name a file with a token"))?;
        let control = Control::new(requests.clone(), text.trim());
        let remedy = "make one with: head -c 32 /dev/urandom | base64";
        Ok(Some(control.ok_or_else(|| Error::new(format!("{}: a token has 16 characters or more, without spaces", file.display()), remedy))?))
    }

    fn watch(&self, requests: &RequestSender) -> Result<Option<Watch>> {
        let start = |viewer: &ViewerSetup| Watch::start(&self.name, viewer, self.control(viewer, requests)?);
        self.viewer.as_ref().map(start).transpose()
    }

    /// Whether poses of scans that are mapped may be corrected later.
    fn may_be_corrected(&self, run: &MappingRun) -> bool {
        run.is_raw() == Some(true) || self.reading.correction_topic.is_some() || self.corrections.optimise || self.corrections.loops == Some(true)
    }

    /// A robot was stopped before it had done anything, which is no fault.
    fn nothing_came(&self, what: &str) -> Option<Played> {
        tracing::info!("{}: {what}; no map was written", self.name.display());
        None
    }

    fn nothing(&self, what: &str) -> Error {
        Error::new(format!("{}: {what}; no map was written", self.name.display()), "")
    }

    /// What decides about the bits of the map; for the topics of a robot, what must not change.
    fn identity(&self, source: &Source, name: &str) -> Identity {
        let data = source.recorded().map_or_else(|| name.to_owned(), |input| format!("{:016x}", input.fingerprint()));
        let publishes = self.network.as_ref().is_some_and(|network| network.backend.is_some() || network.foxglove.is_some());
        Identity::new(&self.settings)
            .with("command", "live")
            .with("data", data)
            .with("reading", format!("{:?}", self.reading))
            .with("poses by odometry", source.odometry.is_some())
            .with("corrections", self.corrections.identity())
            .with("poses in the frame of a network", publishes)
    }

    /// The run, anew or where an unfinished one is, and what comes to it.
    fn begin(&self, source: &mut Source, unfinished: Option<Unfinished>, pool: rayon::ThreadPool) -> Result<MappingRun> {
        let poses = source.odometry.take().map_or(Poses::Given, |stage| Poses::Estimated(Box::new(stage)));
        let (settings, comes) = (self.settings.clone(), source.comes());
        let plan = Plan { settings, corrections: self.corrections, poses, sensor: source.sensor.clone(), comes };
        let mut run = match unfinished {
            None => MappingRun::new(plan, pool)?,
            Some(mut unfinished) => {
                if let Some(input) = source.recorded() {
                    input.know_motions(unfinished.motions());
                }
                MappingRun::resumed(plan, pool, unfinished, source.clouds().as_mut())?
            }
        };
        run.watch_poses();
        Ok(run)
    }
}
