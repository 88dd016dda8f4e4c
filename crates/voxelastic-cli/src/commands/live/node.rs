//! The loop between the feed and the mapper.

use crate::closure_summary::ClosureSummary;
use crate::elastic::corrected;
use crate::failure::one_line;
use crate::input::OdometryStage;
use crate::interrupt;
use crate::jumps::Jumps;
use crate::mapping::Session;
use crate::odometry_log::OdometrySummary;
use crate::progress::Progress;
use crate::usage;
use crate::watching::{Figures, Watch};
use std::time::{Duration, Instant};
use voxelastic::event::Event;
use voxelastic_live::feed::{Feed, Next};
use voxelastic_live::publisher::ShownScan;
use voxelastic_live::transport::Incoming;
use voxelastic_slam::Corrector;

/// How often an interrupt is looked for while nothing comes.
const LOOK: Duration = Duration::from_millis(100);
/// Warnings about scans that were left out are at least this far apart.
const WARNING_PERIOD: Duration = Duration::from_secs(10);

/// Counts of a run.
#[derive(Debug, Default)]
pub struct Tally {
    /// Scans that could not be used.
    pub skipped: usize,
    /// Whether a signal ended the run.
    pub interrupted: bool,
    /// From the coming of each scan to the end of its integration, milliseconds.
    pub delays_ms: Vec<f64>,
    /// Figures of the odometry, if poses were estimated.
    pub odometry: Option<OdometrySummary>,
    /// Loop closures that were tried, if they were looked for.
    pub closures: Option<ClosureSummary>,
}

impl Tally {
    /// The delay that a share of the scans does not exceed; none without scans.
    pub fn delay_quantile(&self, share: f64) -> Option<f64> {
        let mut sorted = self.delays_ms.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted.get((sorted.len() as f64 * share).ceil() as usize - usize::from(!sorted.is_empty())).copied()
    }
}

/// Odometry, corrections and mapping of what a feed delivers, in one thread: what happens does not depend on when it happens.
pub struct Node {
    corrector: Corrector,
    odometry: Option<OdometryStage>,
    jumps: Jumps,
    watch: Option<Watch>,
    tally: Tally,
}

impl Node {
    /// A node; with `odometry`, raw scans can come, and with `watch`, viewers are told what happens.
    pub fn new(corrector: Corrector, odometry: Option<OdometryStage>, watch: Option<Watch>) -> Self {
        Self { corrector, odometry, jumps: Jumps::default(), watch, tally: Tally::default() }
    }

    /// Maps what comes until the feed ends. An interrupt stops the feed; what had come is mapped.
    pub fn run(mut self, feed: &Feed, session: &mut Session, quiet: bool) -> (Tally, Option<Watch>) {
        let mut progress = Progress::new("scans", None, quiet);
        let mut overload = OverloadWarning::default();
        loop {
            // Surfaces for viewers are made when nothing waits, and now and then.
            let has_work = self.watch.as_mut().is_some_and(|watch| watch.step(session.mapper().atlas(), session.pool(), feed.counts().waiting > 0));
            match feed.next(if has_work { Duration::ZERO } else { LOOK }) {
                Next::Incoming(incoming, came) => {
                    let is_scan = incoming.time().is_some();
                    let first = session.scans() == 0;
                    self.take(*incoming, came, session);
                    if let (true, Some(sensor)) = (first && session.scans() == 1, session.mapper().sensor()) {
                        tracing::info!("sensor: {sensor}");
                    }
                    if is_scan {
                        progress.step(|| format!("{} submaps", session.mapper().atlas().submaps().len()));
                    }
                    overload.check(feed.counts().left_out);
                    self.show_figures(feed, session);
                }
                Next::Nothing => {}
                Next::End => break,
            }
            if interrupt::requested() && !std::mem::replace(&mut self.tally.interrupted, true) {
                feed.stop();
            }
        }
        drop(progress);
        self.finish(session)
    }

    fn take(&mut self, incoming: Incoming, came: Instant, session: &mut Session) {
        let before = session.scans();
        match incoming {
            Incoming::Event(event) => self.map(event, session),
            Incoming::RawScan(scan, name) => match self.odometry.as_mut().map(|odometry| odometry.take(scan, &name)) {
                Some(Ok(events)) => events.into_iter().for_each(|event| self.map(event, session)),
                Some(Err(problem)) => self.skip(&problem),
                None => self.skip(&format!("scan {name} has no pose")),
            },
            Incoming::Unusable(problem) => self.skip(&problem),
            _ => {}
        }
        if session.scans() > before {
            self.tally.delays_ms.push(came.elapsed().as_secs_f64() * 1e3);
        }
    }

    fn map(&mut self, event: Event, session: &mut Session) {
        match corrected(&mut self.corrector, session, |corrector| corrector.take(event)) {
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
        let Some(watch) = &mut self.watch else { return Ok(session.take(event).map(drop)?) };
        let shown = if let Event::Scan(scan) = &event { Some(ShownScan::of(&scan.cloud, scan.time)) } else { None };
        if let Event::LoopEdge(edge) = &event {
            watch.publisher.add_loop(edge.from, edge.to);
        }
        session.take(event)?;
        watch.publisher.note(session.mapper(), shown.as_ref());
        Ok(())
    }

    fn show_figures(&mut self, feed: &Feed, session: &Session) {
        let delay_ms = self.tally.delays_ms.last().copied();
        if let Some(watch) = &mut self.watch {
            watch.figures(|| figures("mapping", feed.counts().left_out, delay_ms, session));
        }
    }

    fn skip(&mut self, problem: &str) {
        tracing::warn!("scan skipped: {problem}");
        self.tally.skipped += 1;
    }

    fn finish(mut self, session: &mut Session) -> (Tally, Option<Watch>) {
        self.tally.odometry = self.odometry.as_ref().map(OdometryStage::summary);
        let last = corrected(&mut self.corrector, session, Corrector::finish).map_err(anyhow::Error::from);
        let last = last.and_then(|events| events.into_iter().try_for_each(|event| self.tell(event, session)));
        self.tally.closures = self.corrector.closures().map(ClosureSummary::of);
        if let Err(problem) = last {
            tracing::warn!("the last correction is missing: {}", one_line(&problem));
        }
        (self.tally, self.watch)
    }
}

/// The figures of a node.
pub fn figures(state: &'static str, left_out: usize, delay_ms: Option<f64>, session: &Session) -> Figures {
    let atlas = session.mapper().atlas();
    Figures {
        state,
        scans: session.scans(),
        left_out,
        submaps: atlas.submaps().len(),
        map_mb: usage::megabytes(atlas.bytes() as u64),
        rss_mb: usage::resident_bytes().map(usage::megabytes),
        delay_ms,
    }
}

/// Says that scans are left out, now and then.
#[derive(Default)]
struct OverloadWarning {
    said: usize,
    at: Option<Instant>,
}

impl OverloadWarning {
    fn check(&mut self, left_out: usize) {
        if left_out > self.said && self.at.is_none_or(|at| at.elapsed() > WARNING_PERIOD) {
            tracing::warn!("scans come faster than they can be mapped: {left_out} left out so far; the newest win");
            (self.said, self.at) = (left_out, Some(Instant::now()));
        }
    }
}
