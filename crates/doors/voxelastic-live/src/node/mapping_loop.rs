//! The loop between the feed and the mapper.

use super::exploring::Exploring;
use super::figures::{OverloadWarning, figures};
use super::health::Condition;
use super::listeners::{Listeners, OnNetwork};
use super::loading::Loaded;
use super::managed_state;
use super::positions::Positions;
use super::service::{Service, find_path};
use super::tally::Tally;
use super::watch::Watch;
use crate::feed::{Feed, Next};
use crate::ros::lifecycle::State;
use crate::ros::output::Outputs;
use crate::ros::services::{NotLoaded, Pending, Place, Request, Response};
use std::path::Path;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use voxelastic_io::bag::live::LiveFrames;
use voxelastic_run::{Code, Input, Mapping, MappingRun};
use voxelastic_slam::loops::Whereabouts;

/// How often an interrupt is looked for while nothing comes.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// The same while tiles of the surface are made.
const POLL_INTERVAL_MESHING: Duration = Duration::from_millis(2);
/// The same while a path is planned.
const POLL_INTERVAL_PLANNING: Duration = Duration::from_millis(10);
/// Surface and occupancy are published at least this often while scans wait.
const LONGEST_SILENCE: Duration = Duration::from_millis(500);

/// Gives a run what a feed delivers, in one thread: what happens does not depend on when it happens. Tells viewers and others about it.
pub struct Node {
    listeners: Listeners,
    /// Where the reading of a recording was after each item; none for a robot.
    positions: Option<Positions>,
    is_paused: bool,
    /// Of a managed node.
    state: Option<State>,
    last_step: Instant,
    tally: Tally,
}

/// What is asked of a node, and what it needs to answer.
pub struct Requests {
    /// What is asked.
    pub pending: Receiver<Pending>,
    /// Answers those that do not change the map.
    pub service: Service,
}

impl Node {
    /// A node. `positions` are those of a recording, `state` that of a managed node.
    pub fn new(positions: Option<Positions>, listeners: Listeners, state: Option<State>) -> Self {
        let is_paused = state.is_some_and(|state| state != State::Active);
        Self { listeners, positions, is_paused, state, last_step: Instant::now(), tally: Tally::default() }
    }

    /// Maps what comes until the feed ends, and says so after each scan. Once it `is_stopped`, the feed stops; what had come is mapped.
    pub fn run(
        mut self,
        feed: &Feed,
        run: &mut MappingRun,
        mut requests: Requests,
        is_stopped: fn() -> bool,
        progress: &mut dyn FnMut(&Mapping),
    ) -> (Tally, Option<Watch>) {
        let mut overload = OverloadWarning::default();
        loop {
            let pause = self.show(run.mapping(), feed.counts().waiting > 0);
            match feed.next(if run.is_following() { Duration::ZERO } else { pause }) {
                Next::Incoming(input, arrival) => {
                    let is_scan = input.time().is_some();
                    let first = run.scans() == 0;
                    if is_scan {
                        run.note_scan(arrival.left_out);
                    }
                    run.note_position(self.positions.as_ref().and_then(|positions| positions.after(arrival.number)));
                    self.take(*input, arrival.at, run);
                    if let (true, Some(sensor)) = (first && run.scans() == 1, run.mapping().mapper().sensor()) {
                        tracing::info!("sensor: {sensor}");
                    }
                    if is_scan {
                        progress(run.mapping());
                    }
                    overload.check(feed.counts().left_out);
                }
                Next::Nothing => {}
                Next::End => break,
            }
            run.follow(feed.counts().waiting > 0, &mut self.listeners);
            // A disk may keep it waiting.
            feed.begin_pause();
            self.answer(run, &mut requests);
            self.show_distances(run, &mut requests.service, feed.counts().waiting > 0);
            if let Some((exploring, outputs)) = self.exploring() {
                exploring.step(run.mapping(), outputs, feed.counts().waiting > 0);
            }
            run.keep(feed.counts().waiting > 0);
            feed.end_pause();
            self.show_figures(feed, run);
            let is_ended = is_stopped() || self.state == Some(State::Finalized);
            if is_ended && !std::mem::replace(&mut self.tally.interrupted, true) {
                feed.stop();
            }
        }
        if self.tally.interrupted && self.positions.is_some() {
            // The map will have what came until now, and so has this.
            run.keep_now();
        }
        self.finish(run)
    }

    /// Shows and publishes some of what changed. Surfaces are made on other threads, and occupancy when no scan waits, and now and then. Returns how long it is to be waited for
    /// a scan before there is more to show.
    fn show(&mut self, mapping: &Mapping, scans_wait: bool) -> Duration {
        let atlas = mapping.atlas();
        let is_busy = |watch: &Option<Watch>| watch.as_ref().is_some_and(|watch| watch.publisher.is_busy());
        let was_busy = is_busy(&self.listeners.watch);
        let mut has_work = self.listeners.watch.as_mut().is_some_and(|watch| watch.step(atlas, mapping.pool()));
        let mut is_busy = is_busy(&self.listeners.watch);
        if has_work {
            self.tally.note_shown();
        }
        if is_busy && (has_work || !was_busy) {
            // What was ordered just now has all scans until now.
            self.tally.in_work = self.tally.unshown.len();
        }
        if let Some(network) = &mut self.listeners.network {
            let outputs = &mut network.offers.outputs;
            has_work |= if !scans_wait || self.last_step.elapsed() >= LONGEST_SILENCE {
                self.last_step = Instant::now();
                mapping.pool().install(|| outputs.step(atlas))
            } else {
                mapping.pool().install(|| outputs.step_urgent(atlas))
            };
            is_busy |= outputs.is_busy();
        }
        let is_planning = self.exploring().is_some_and(|(exploring, _)| exploring.is_busy());
        match (has_work, is_busy) {
            (true, _) => Duration::ZERO,
            (_, true) => POLL_INTERVAL_MESHING,
            _ if is_planning => POLL_INTERVAL_PLANNING,
            _ => POLL_INTERVAL,
        }
    }

    /// What plans where to go next, and what publishes it.
    fn exploring(&mut self) -> Option<(&mut Exploring, &mut Outputs)> {
        let network = self.listeners.network.as_mut()?;
        Some((network.exploring.as_mut()?, &mut network.offers.outputs))
    }

    /// Publishes distances around the robot, if it is time for that and no scan waits.
    fn show_distances(&mut self, run: &MappingRun, service: &mut Service, scans_wait: bool) {
        let Some(network) = self.listeners.network.as_mut().filter(|_| !scans_wait) else { return };
        let distances = |points: &[[f64; 3]]| match service.distances(points, run) {
            Ok(found) => found.into_iter().map(|at| at.map(|at| at.distance)).collect(),
            Err(problem) => {
                tracing::warn!("no distances are published: {problem}");
                Vec::new()
            }
        };
        run.mapping().pool().install(|| network.offers.outputs.step_slice(run.mapping().atlas(), distances));
    }

    /// Answers what others ask.
    fn answer(&mut self, run: &mut MappingRun, requests: &mut Requests) {
        while let Ok(pending) = requests.pending.try_recv() {
            let response = match &pending.request {
                Request::Pause(pause) => {
                    self.is_paused = *pause;
                    let words = if *pause { "scans are ignored until mapping is resumed" } else { "scans are mapped" };
                    tracing::info!("on request: {words}");
                    Response::Done(Ok(words.to_owned()))
                }
                Request::Reset => Response::Done(self.reset(run, requests).map_err(|problem| problem.one_line())),
                Request::Load(path) => Response::Loaded(self.load(path, run, requests)),
                request @ (Request::Explore(_) | Request::ReturnHome) => match self.exploring() {
                    Some((exploring, outputs)) => exploring.answer(request, outputs),
                    None => Response::Done(Err("this node does not explore: start it with --explore".to_owned())),
                },
                Request::Grid => self.grid(run),
                Request::State => Response::State(self.state.unwrap_or(State::Active)),
                Request::ChangeState(id, label) => Response::Done(self.change_state(*id, label, run, requests)),
                Request::InitialPose { place, sigma } => self.look_near(place, *sigma, run),
                Request::Plan { start, goal, .. } => self.plan([start, goal], run),
                request => requests.service.answer(request, run),
            };
            if let Response::Loaded(Err((_, words))) = &response {
                tracing::warn!("on request: no map was loaded: {words}");
            }
            pending.answer(response);
        }
    }

    fn grid(&mut self, run: &MappingRun) -> Response {
        match &mut self.listeners.network {
            Some(OnNetwork { offers, .. }) => {
                let outputs = &mut offers.outputs;
                Response::Grid(run.mapping().pool().install(|| outputs.grid(run.mapping().atlas())))
            }
            None => Response::Done(Err("no grid is published here".to_owned())),
        }
    }

    /// Leads a managed node to another state.
    fn change_state(&mut self, id: u8, label: &str, run: &mut MappingRun, requests: &mut Requests) -> Result<String, String> {
        let now = self.state;
        let state = managed_state::change(now, id, label, |transition| {
            if transition.cleans_up() {
                self.reset(run, requests).map_err(|problem| problem.one_line())?;
            }
            Ok(())
        })?;
        (self.state, self.is_paused) = (Some(state), state != State::Active);
        Ok(state.label().to_owned())
    }

    /// A path between two places in frames of the robot; none, and a warning, if a frame is not known.
    fn plan(&self, ends: [&Place; 2], run: &mut MappingRun) -> Response {
        let in_map = |place: &Place| match &self.listeners.network {
            Some(network) => network.in_map(place),
            None => Ok(place.pose),
        };
        let [start, goal] = ends.map(in_map);
        match (start, goal) {
            (Ok(start), Ok(goal)) => Response::Path(find_path(run.mapping(), &start, &goal)),
            (Err(problem), _) | (_, Err(problem)) => {
                run.warnings_mut().add(Code::RequestRefused, format!("no path: {problem}"), "ask in one of these frames");
                Response::Path(Vec::new())
            }
        }
    }

    /// Somebody says about where the robot is.
    fn look_near(&self, place: &Place, sigma: f64, run: &mut MappingRun) -> Response {
        let about = self.listeners.network.as_ref().ok_or_else(|| "nobody can say here where the robot is".to_owned());
        let about = about.and_then(|network| network.whereabouts(place, sigma)).and_then(|about| run.look_near(about));
        Response::Done(match about {
            Ok(Whereabouts { position, within, .. }) => {
                let words = format!("scans are looked for within {within:.1} m of ({:.2}, {:.2}, {:.2})", position.x, position.y, position.z);
                tracing::info!("on request: {words}");
                Ok(words)
            }
            Err(problem) => {
                let remedy = "it is of use after a map was loaded, or gone on with, until the scans are found in it";
                run.warnings_mut().add(Code::RequestRefused, format!("initial pose: {problem}"), remedy);
                Err(problem)
            }
        })
    }

    /// Drops the map and begins a new one.
    fn reset(&mut self, run: &mut MappingRun, requests: &mut Requests) -> voxelastic_run::Result<String> {
        let scans = run.scans();
        run.discard_checkpoints();
        requests.service.esdf = None;
        run.restart(&mut self.listeners)?;
        tracing::warn!("on request: the map of {scans} scans is dropped and a new one begins");
        Ok(format!("the map of {scans} scans was dropped"))
    }

    /// Goes on in a saved map, in which the scans that come are found first. The map so far is dropped; if the other one cannot be loaded, nothing changes.
    fn load(&mut self, path: &Path, run: &mut MappingRun, requests: &mut Requests) -> Result<String, (NotLoaded, String)> {
        if self.positions.is_some() {
            let words = "a recording is mapped from its beginning: `voxelastic map DATA --into MAP` adds one to a map";
            return Err((NotLoaded::Other, words.to_owned()));
        }
        let loaded = Loaded::read(path, run.mapping().mapper().settings(), self.listeners.network.is_some())?;
        let words = loaded.words(run.scans());
        run.go_on_in(loaded.map, &mut self.listeners).map_err(|problem| (NotLoaded::Other, problem.one_line()))?;
        requests.service.esdf = None;
        self.listeners.show_before(run.mapping());
        tracing::warn!("on request: {words}");
        Ok(words)
    }

    fn take(&mut self, input: Input, came: Instant, run: &mut MappingRun) {
        if self.is_paused && input.time().is_some() {
            self.tally.paused += 1;
            return;
        }
        if !run.take(input, &mut self.listeners).integrated.is_empty() {
            self.tally.delays_ms.push(came.elapsed().as_secs_f64() * 1e3);
            if self.listeners.watch.is_some() {
                self.tally.unshown.push(came);
            }
        }
    }

    fn show_figures(&mut self, feed: &Feed, run: &mut MappingRun) {
        let (left_out, is_paused, delay_ms) = (feed.counts().left_out, self.is_paused, self.tally.delays_ms.last());
        if let Some(watch) = &mut self.listeners.watch {
            watch.figures(|| figures("mapping", left_out, delay_ms, run.mapping()));
        }
        let is_worse = std::mem::replace(&mut self.tally.left_out, left_out) < left_out;
        let Some(network) = &mut self.listeners.network else { return };
        for note in network.frames.iter().flat_map(LiveFrames::take_notes) {
            run.warnings_mut().add_said(Code::MountChanged, note);
        }
        if !network.offers.outputs.is_time_for_diagnostics() {
            self.tally.was_worse |= is_worse;
            return;
        }
        let condition = Condition {
            warnings: run.warnings().all(),
            is_paused: is_paused && self.state.is_none_or(|state| state == State::Active),
            state: self.state.filter(|state| *state != State::Active),
            is_worse: std::mem::take(&mut self.tally.was_worse) || is_worse,
            bent: Some(run.bent()).filter(|bent| run.is_following() || bent.waiting + bent.for_good > 0),
            // Once it is to end, it does not listen any more.
            topics: network.heard.as_ref().filter(|_| !self.tally.interrupted).map(|heard| network.rates.of(heard)).unwrap_or_default(),
            waits_for: network.frames.as_ref().and_then(LiveFrames::waits_for),
            rival: network.rival(),
        };
        let (health, words, mut all) = condition.diagnosis(&figures("mapping", left_out, delay_ms, run.mapping()));
        all.extend(network.exploring.iter().flat_map(Exploring::figures).map(|(key, value)| (key.to_owned(), value)));
        let node = network.node.clone();
        self.tally.say(health, &words);
        network.offers.outputs.diagnostics(&node, (health, words, all));
    }

    fn finish(mut self, run: &mut MappingRun) -> (Tally, Option<Watch>) {
        self.tally.not_located = run.scans_waiting();
        run.finish(&mut self.listeners);
        while run.is_following() {
            run.follow(false, &mut self.listeners);
        }
        if let Some(network) = &mut self.listeners.network {
            network.offers.outputs.finish(run.mapping().mapper());
            self.tally.exploration = network.exploring.as_ref().map(Exploring::summary);
        }
        (self.tally, self.listeners.watch)
    }
}
