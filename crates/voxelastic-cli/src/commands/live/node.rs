//! The loop between the feed and the mapper.

use super::exploring::Exploring;
use super::figures::{OverloadWarning, diagnosis, figures};
use super::loading::Loaded;
use super::offers::Offers;
use super::place::Place;
use super::relocalisation::{MapFrame, Outcome, Relocalisation, numbered, placed};
use super::service::Service;
use super::tally::Tally;
use crate::closure_summary::ClosureSummary;
use crate::elastic::corrected;
use crate::failure::one_line;
use crate::input::{InputState, OdometryStage};
use crate::interrupt;
use crate::jumps::Jumps;
use crate::mapping::Session;
use crate::progress::Progress;
use crate::resume::{Keeper, Stages};
use crate::target::Target;
use crate::watching::Watch;
use std::path::Path;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use voxelastic::event::{Event, NodeId};
use voxelastic::sensor::BeamModel;
use voxelastic::{Mapper, Pose};
use voxelastic_io::bag::live::LiveFrames;
use voxelastic_live::feed::{Feed, Next};
use voxelastic_live::publisher::ShownScan;
use voxelastic_live::ros::output::{OdometryLink, Outputs};
use voxelastic_live::ros::services::{NotLoaded, Pending, Request, Response};
use voxelastic_live::transport::Incoming;
use voxelastic_slam::Corrector;

/// How often an interrupt is looked for while nothing comes.
const LOOK: Duration = Duration::from_millis(100);
/// The same while tiles of the surface are made.
const LOOK_SOON: Duration = Duration::from_millis(2);
/// The same while a path is planned.
const LOOK_FOR_PLAN: Duration = Duration::from_millis(10);
/// Occupancy is published at least this often while scans wait.
const LONGEST_SILENCE: Duration = Duration::from_millis(500);
/// A robot's node in a network.
pub struct OnNetwork {
    /// Its name.
    pub node: String,
    /// What it publishes.
    pub offers: Offers,
    /// The frames of what comes; none for a recording.
    pub frames: Option<LiveFrames>,
    /// Where to go next, if it explores.
    pub exploring: Option<Exploring>,
}

/// Odometry, corrections and mapping of what a feed delivers, in one thread: what happens does not depend on when it happens.
pub struct Node {
    corrector: Corrector,
    odometry: Option<OdometryStage>,
    jumps: Jumps,
    watch: Option<Watch>,
    network: Option<OnNetwork>,
    /// The last pose of the odometry, if poses are estimated.
    odometry_pose: Option<(NodeId, f64, Pose)>,
    place: Place,
    is_paused: bool,
    last_step: Instant,
    tally: Tally,
}

/// What is asked of a node, and what it needs to answer.
pub struct Requests<'a> {
    /// What is asked.
    pub pending: Receiver<Pending>,
    /// Answers those that do not change the map.
    pub service: Service<'a>,
    /// Writes checkpoints.
    pub keeper: &'a mut Keeper,
    /// The sensor's own tables of beams, if known.
    pub sensor: Option<BeamModel>,
    /// Makes the mapper and the corrector of a new map.
    pub renew: &'a dyn Fn() -> anyhow::Result<(Mapper, Corrector)>,
}

impl Node {
    /// A node; with `odometry`, raw scans can come, with `watch`, viewers are told what happens, and with `network`, others are.
    pub fn new(corrector: Corrector, odometry: Option<OdometryStage>, watch: Option<Watch>, network: Option<OnNetwork>) -> Self {
        Self {
            corrector,
            odometry,
            jumps: Jumps::default(),
            place: Place::default(),
            watch,
            network,
            odometry_pose: None,
            is_paused: false,
            last_step: Instant::now(),
            tally: Tally::default(),
        }
    }

    /// The node goes on from where another process was.
    #[must_use]
    pub fn at(self, place: Place, jumps: Jumps, skipped: usize) -> Self {
        let tally = Tally { skipped, ..self.tally };
        Self { place, jumps, tally, ..self }
    }

    /// What viewers and others are to know of the map of before.
    pub fn show_before(&mut self, session: &Session) {
        if let Some(watch) = &mut self.watch {
            session.log().loops.iter().for_each(|edge| watch.publisher.add_loop(edge.from, edge.to));
            watch.publisher.note(session.mapper(), None);
        }
        if let Some(network) = &mut self.network {
            let scans = session.log().scans;
            scans.node.iter().zip(&scans.time_s).for_each(|(node, time)| network.offers.outputs.add_scan(*node, *time));
            network.offers.outputs.note(session.mapper(), None);
        }
    }

    /// Maps what comes until the feed ends. An interrupt stops the feed; what had come is mapped.
    pub fn run(mut self, feed: &Feed, session: &mut Session, mut requests: Requests<'_>, quiet: bool) -> (Tally, Option<Watch>) {
        let mut progress = Progress::new("scans", None, quiet);
        let mut overload = OverloadWarning::default();
        loop {
            let pause = self.show(session, feed.counts().waiting > 0);
            match feed.next(pause) {
                Next::Incoming(incoming, arrival) => {
                    let is_scan = incoming.time().is_some();
                    let first = session.scans() == 0;
                    self.place.note(&arrival, is_scan);
                    self.take(*incoming, arrival.at, session, &mut requests);
                    if let (true, Some(sensor)) = (first && session.scans() == 1, session.mapper().sensor()) {
                        tracing::info!("sensor: {sensor}");
                    }
                    if is_scan {
                        progress.step(|| format!("{} submaps", session.mapper().atlas().submaps().len()));
                    }
                    overload.check(feed.counts().left_out);
                }
                Next::Nothing => {}
                Next::End => break,
            }
            // A disk may keep it waiting.
            feed.begin_pause();
            self.answer(session, &mut requests);
            self.show_distances(session, &mut requests.service, feed.counts().waiting > 0);
            if let Some((exploring, outputs)) = self.exploring() {
                exploring.step(session, outputs, feed.counts().waiting > 0);
            }
            if let Some(target) = requests.service.target.as_deref_mut() {
                requests.keeper.keep_between_scans(target, session, &self.stages(), feed.counts().waiting > 0);
            }
            feed.end_pause();
            self.show_figures(feed, session);
            if interrupt::requested() && !std::mem::replace(&mut self.tally.interrupted, true) {
                feed.stop();
            }
        }
        drop(progress);
        if let Some(target) = requests.service.target.as_deref_mut().filter(|_| self.tally.interrupted && self.place.is_recorded()) {
            // The map will have what came until now, and so has this.
            requests.keeper.keep_now(target, session, &self.stages());
        }
        self.finish(session)
    }

    fn stages(&self) -> Stages<'_> {
        let Self { place, odometry, .. } = self;
        let input = || {
            let stage = match odometry {
                Some(odometry) => Some(odometry.state()?),
                None => None,
            };
            place.position().map(|position| InputState { position, stage })
        };
        Stages { input: Box::new(input), corrector: &self.corrector, jumps: &self.jumps, skipped: self.tally.skipped, came: place.came() }
    }

    /// Shows and publishes some of what changed. Surfaces are made on other threads, and occupancy when no scan waits, and now and then. Returns how long it is to be waited for
    /// a scan before there is more to show.
    fn show(&mut self, session: &Session, scans_wait: bool) -> Duration {
        let atlas = session.mapper().atlas();
        let is_busy = |watch: &Option<Watch>| watch.as_ref().is_some_and(|watch| watch.publisher.is_busy());
        let was_busy = is_busy(&self.watch);
        let mut has_work = self.watch.as_mut().is_some_and(|watch| watch.step(atlas, session.pool()));
        let mut is_busy = is_busy(&self.watch);
        if has_work {
            self.tally.note_shown();
        }
        if is_busy && (has_work || !was_busy) {
            // What was ordered just now has all scans until now.
            self.tally.in_work = self.tally.unshown.len();
        }
        if let Some(network) = self.network.as_mut().filter(|_| !scans_wait || self.last_step.elapsed() >= LONGEST_SILENCE) {
            self.last_step = Instant::now();
            let outputs = &mut network.offers.outputs;
            has_work |= session.pool().install(|| outputs.step(atlas));
            is_busy |= outputs.is_busy();
        }
        let is_planning = self.exploring().is_some_and(|(exploring, _)| exploring.is_busy());
        match (has_work, is_busy) {
            (true, _) => Duration::ZERO,
            (_, true) => LOOK_SOON,
            _ if is_planning => LOOK_FOR_PLAN,
            _ => LOOK,
        }
    }

    /// What plans where to go next, and what publishes it.
    fn exploring(&mut self) -> Option<(&mut Exploring, &mut Outputs)> {
        let network = self.network.as_mut()?;
        Some((network.exploring.as_mut()?, &mut network.offers.outputs))
    }

    /// Publishes distances around the robot, if it is time for that and no scan waits.
    fn show_distances(&mut self, session: &Session, service: &mut Service<'_>, scans_wait: bool) {
        let Some(network) = self.network.as_mut().filter(|_| !scans_wait) else { return };
        let distances = |points: &[[f64; 3]]| match service.distances(points, session) {
            Ok(found) => found.into_iter().map(|at| at.map(|at| at.distance)).collect(),
            Err(problem) => {
                tracing::warn!("no distances are published: {problem}");
                Vec::new()
            }
        };
        session.pool().install(|| network.offers.outputs.step_slice(session.mapper().atlas(), distances));
    }

    /// Answers what others ask.
    fn answer(&mut self, session: &mut Session, requests: &mut Requests<'_>) {
        while let Ok(pending) = requests.pending.try_recv() {
            let response = match &pending.request {
                Request::Pause(pause) => {
                    self.is_paused = *pause;
                    let words = if *pause { "scans are ignored until mapping is resumed" } else { "scans are mapped" };
                    tracing::info!("on request: {words}");
                    Response::Done(Ok(words.to_owned()))
                }
                Request::Reset => Response::Done(self.reset(session, requests).map_err(|problem| one_line(&problem))),
                Request::Load(path) => Response::Loaded(self.load(path, session, requests)),
                request @ (Request::Explore(_) | Request::ReturnHome) => match self.exploring() {
                    Some((exploring, outputs)) => exploring.answer(request, outputs),
                    None => Response::Done(Err("this node does not explore: start it with --explore".to_owned())),
                },
                request => requests.service.answer(request, session),
            };
            if let Response::Loaded(Err((_, words))) = &response {
                tracing::warn!("on request: no map was loaded: {words}");
            }
            pending.answer(response);
        }
    }

    /// Drops the map and begins a new one.
    fn reset(&mut self, session: &mut Session, requests: &mut Requests<'_>) -> anyhow::Result<String> {
        let scans = session.scans();
        if let Some(target) = requests.service.target.as_deref_mut() {
            target.discard_checkpoints();
        }
        self.begin_anew(session, requests)?;
        tracing::warn!("on request: the map of {scans} scans is dropped and a new one begins");
        Ok(format!("the map of {scans} scans was dropped"))
    }

    /// Goes on in a saved map, in which the scans that come are found first. The map so far is dropped; if the other one cannot be loaded, nothing changes.
    fn load(&mut self, path: &Path, session: &mut Session, requests: &mut Requests<'_>) -> Result<String, (NotLoaded, String)> {
        if self.place.is_recorded() {
            let words = "a recording is mapped from its beginning: `voxelastic map DATA --into MAP` adds one to a map";
            return Err((NotLoaded::Other, words.to_owned()));
        }
        let loaded = Loaded::read(path, session.mapper().settings(), self.network.is_some())?;
        let words = loaded.words(session);
        let Loaded { atlas, origin, log, .. } = loaded;
        let other = |problem: anyhow::Error| (NotLoaded::Other, one_line(&problem));
        let mapper = session.pool().install(|| Mapper::in_saved(session.mapper().settings().clone(), requests.sensor.clone(), atlas));
        let mapper = mapper.map_err(|problem| other(problem.into()))?;
        if let Some(target) = requests.service.target.as_deref_mut() {
            target.discard_checkpoints();
        }
        self.begin_anew(session, requests).map_err(other)?;
        (self.place.first_node, self.place.last_node) = (mapper.next_node(), mapper.last_node());
        session.go_on(mapper, log, origin);
        self.place.relocalisation = Some(Box::new(Relocalisation::new(session, self.odometry.is_none())));
        self.show_before(session);
        tracing::warn!("on request: {words}");
        Ok(words)
    }

    /// Begins a new map.
    fn begin_anew(&mut self, session: &mut Session, requests: &mut Requests<'_>) -> anyhow::Result<()> {
        let (mapper, corrector) = (requests.renew)()?;
        requests.keeper.restart();
        requests.service.esdf = None;
        session.restart(mapper);
        (self.corrector, self.jumps, self.odometry_pose) = (corrector, Jumps::default(), None);
        (self.place.relocalisation, self.place.t_map_frame) = (None, None);
        if let Some(watch) = &mut self.watch {
            watch.publisher.reset();
        }
        if let Some(network) = &mut self.network {
            network.offers.outputs.reset();
            network.exploring.iter_mut().for_each(Exploring::restart);
        }
        Ok(())
    }

    fn take(&mut self, incoming: Incoming, came: Instant, session: &mut Session, requests: &mut Requests<'_>) {
        let before = session.scans();
        if self.is_paused && incoming.time().is_some() {
            self.tally.paused += 1;
            return;
        }
        match incoming {
            Incoming::Event(event) => self.arrange(numbered(event, self.place.first_node), session, requests),
            Incoming::RawScan(mut scan, name) => {
                scan.node += self.place.first_node;
                match self.odometry.as_mut().map(|odometry| odometry.take(scan, &name)) {
                    Some(Ok(events)) => events.into_iter().for_each(|event| {
                        if self.is_of_before(&event) {
                            return;
                        }
                        if let Event::Scan(scan) = &event {
                            self.odometry_pose = Some((scan.node, scan.time, scan.t_map_lidar));
                        }
                        self.arrange(event, session, requests);
                    }),
                    Some(Err(problem)) => self.skip(&problem),
                    None => self.skip(&format!("scan {name} has no pose")),
                }
            }
            Incoming::Unusable(problem) => self.skip(&problem),
            _ => {}
        }
        if session.scans() > before {
            self.tally.delays_ms.push(came.elapsed().as_secs_f64() * 1e3);
            if self.watch.is_some() {
                self.tally.unshown.push(came);
            }
        }
    }

    /// Whether an event of the odometry is tied to a scan that came before this map was loaded.
    fn is_of_before(&self, event: &Event) -> bool {
        matches!(event, Event::OdometryEdge(edge) if edge.from < self.place.first_node)
    }

    /// Maps an event where it belongs in the map of before, once that is known.
    fn arrange(&mut self, event: Event, session: &mut Session, requests: &mut Requests<'_>) {
        // Others on the network get poses and surfaces in the frame in which poses came.
        let event = if self.network.is_some() { event } else { session.localised(event) };
        let Some(relocalisation) = &mut self.place.relocalisation else {
            let event = match &self.place.t_map_frame {
                Some(t_map_frame) => placed(event, t_map_frame),
                None => event,
            };
            return self.map(event, session, requests.keeper);
        };
        let Some(found) = relocalisation.take(event, session) else { return };
        self.place.relocalisation = None;
        let held = match found {
            Outcome::InFrame(held) => held,
            Outcome::InMap(found) => {
                let MapFrame { t_map_frame, edge, held } = *found;
                self.place.t_map_frame = Some(t_map_frame);
                // From here on poses come in the frame of the map, corrected as it is.
                let last = self.place.last_node.and_then(|node| Some((node, session.mapper().pose(node)?)));
                last.into_iter().for_each(|last| self.map(Event::PoseUpdate(vec![last]), session, requests.keeper));
                edge.into_iter().for_each(|edge| self.map(Event::LoopEdge(edge), session, requests.keeper));
                held.into_iter().map(|event| placed(event, &t_map_frame)).collect()
            }
            Outcome::NotFound(why, held) => {
                tracing::warn!("the scans are not where the map of before is, so a new one begins: {why}");
                let aside = requests.service.target.as_deref_mut().map_or(Ok(()), Target::set_unfinished_aside);
                if let Err(problem) = aside.and_then(|()| self.begin_anew(session, requests)) {
                    return self.skip(&one_line(&problem));
                }
                held
            }
        };
        held.into_iter().for_each(|event| self.map(event, session, requests.keeper));
    }

    fn map(&mut self, event: Event, session: &mut Session, keeper: &mut Keeper) {
        let record = keeper.record_of(&event);
        let done = corrected(&mut self.corrector, session, |corrector| corrector.take(event));
        keeper.add(record, Some(&self.corrector));
        match done {
            Ok(events) => events.into_iter().for_each(|event| {
                if let Err(problem) = self.jumps.check(&event).map_err(anyhow::Error::from).and_then(|()| self.tell(event, session)) {
                    self.skip(&one_line(&problem));
                }
            }),
            Err(problem) => self.skip(&one_line(&problem.into())),
        }
    }

    /// Passes an event to the mapper, and tells viewers.
    fn tell(&mut self, event: Event, session: &mut Session) -> anyhow::Result<()> {
        if self.watch.is_none() && self.network.is_none() {
            return Ok(session.take(event).map(drop)?);
        }
        let (mut shown, mut is_edge) = (None, false);
        match &event {
            Event::Scan(scan) => {
                shown = self.watch.is_some().then(|| ShownScan::of(&scan.cloud, scan.time));
                if let Some(network) = &mut self.network {
                    network.offers.outputs.add_scan(scan.node, scan.time);
                    network.exploring.iter_mut().for_each(|exploring| exploring.add_scan(scan, session.mapper().settings()));
                }
            }
            Event::LoopEdge(edge) => {
                is_edge = true;
                if let Some(watch) = &mut self.watch {
                    watch.publisher.add_loop(edge.from, edge.to);
                }
            }
            Event::OdometryEdge(_) => is_edge = true,
            _ => {}
        }
        session.take(event)?;
        if let Some(watch) = &mut self.watch {
            watch.publisher.note(session.mapper(), shown.as_ref());
        }
        let link = self.odometry_link();
        if let Some(network) = self.network.as_mut().filter(|_| !is_edge) {
            network.offers.outputs.note(session.mapper(), link);
            network.exploring.iter_mut().for_each(Exploring::note);
        }
        Ok(())
    }

    /// How the odometry is tied to the last scan.
    fn odometry_link(&self) -> Option<OdometryLink> {
        let frames = self.network.as_ref()?.frames.as_ref()?;
        if let Some((node, time, t_odom_lidar)) = self.odometry_pose {
            return Some(OdometryLink { odom: "odom".to_owned(), t_odom_lidar, node, time, base: frames.base() });
        }
        let reported = frames.reported()?;
        let node = reported.node + self.place.first_node;
        Some(OdometryLink { odom: frames.odom()?, t_odom_lidar: reported.t_odom_lidar, node, time: reported.time, base: None })
    }

    fn show_figures(&mut self, feed: &Feed, session: &Session) {
        let delay_ms = self.tally.delays_ms.last();
        if let Some(watch) = &mut self.watch {
            watch.figures(|| figures("mapping", feed.counts().left_out, delay_ms, session));
        }
        let (left_out, paused) = (feed.counts().left_out, self.is_paused);
        let is_worse = std::mem::replace(&mut self.tally.left_out, left_out) < left_out;
        if let Some(network) = &mut self.network {
            let node = network.node.clone();
            let exploring = network.exploring.as_ref();
            let diagnosis = || {
                let (health, words, mut all) = diagnosis(&figures("mapping", left_out, delay_ms, session), is_worse, paused);
                all.extend(exploring.into_iter().flat_map(Exploring::figures));
                (health, words, all)
            };
            network.offers.outputs.diagnostics(&node, diagnosis);
        }
    }

    fn skip(&mut self, problem: &str) {
        tracing::warn!("scan skipped: {problem}");
        self.tally.skipped += 1;
    }

    fn finish(mut self, session: &mut Session) -> (Tally, Option<Watch>) {
        self.tally.odometry = self.odometry.as_ref().map(OdometryStage::summary);
        self.tally.not_located = self.place.relocalisation.as_ref().map_or(0, |relocalisation| relocalisation.scans());
        let last = corrected(&mut self.corrector, session, Corrector::finish).map_err(anyhow::Error::from);
        let last = last.and_then(|events| events.into_iter().try_for_each(|event| self.tell(event, session)));
        if let Some(network) = &mut self.network {
            network.offers.outputs.finish(session.mapper());
            self.tally.exploration = network.exploring.as_ref().map(Exploring::summary);
        }
        self.tally.closures = self.corrector.closures().map(ClosureSummary::of);
        if let Err(problem) = last {
            tracing::warn!("the last correction is missing: {}", one_line(&problem));
        }
        (self.tally, self.watch)
    }
}
