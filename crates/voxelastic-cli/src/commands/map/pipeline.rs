//! The way of scans from the input over corrections to the mapper.

use crate::closure_summary::ClosureSummary;
use crate::elastic::{ElasticArgs, corrected};
use crate::failure::{self, Failure, one_line};
use crate::input::{Input, InputEvents};
use crate::interrupt;
use crate::jumps::Jumps;
use crate::mapping::Session;
use crate::odometry_log::OdometrySummary;
use crate::progress::Progress;
use crate::resume::{Keeper, Stages, Unfinished};
use crate::target::Target;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use voxelastic::event::Event;
use voxelastic::mapper::Mapper;
use voxelastic::settings::Settings;
use voxelastic_slam::Corrector;

/// The scans to map, the number of those held out so far, and what is done with them before they are mapped.
pub struct Selection {
    pub input: Input,
    pub held_out: Arc<AtomicUsize>,
    pub elastic: ElasticArgs,
    /// Whether a scan that cannot be used ends the run.
    pub strict: bool,
}

/// Counts of a run.
#[derive(Debug, Default)]
pub struct Tally {
    pub skipped: usize,
    pub held_out: usize,
    pub rebuilt: usize,
    pub interrupted: bool,
    /// The input ended early because of a bug of a decoder.
    pub broken: bool,
    pub mapping_s: f64,
    pub odometry: Option<OdometrySummary>,
    pub closures: Option<ClosureSummary>,
}

/// Everything before the mapper, and counts.
pub struct Pipeline<'a> {
    selection: &'a Selection,
    events: InputEvents,
    corrector: Corrector,
    jumps: Jumps,
    tally: Tally,
    clock: Instant,
}

impl<'a> Pipeline<'a> {
    /// At the beginning, or where an unfinished run is. None if the user interrupts the reading again.
    pub fn open(
        selection: &'a Selection,
        settings: &Settings,
        pool: rayon::ThreadPool,
        unfinished: Option<Unfinished>,
    ) -> anyhow::Result<Option<(Self, Session)>> {
        let clock = Instant::now();
        let Selection { input, elastic, .. } = selection;
        let threads = pool.current_num_threads();
        let wrong_settings = |e: &dyn std::fmt::Display| Failure::usage(e.to_string(), "see `voxelastic config`");
        let Some(mut unfinished) = unfinished else {
            let mut mapper = Mapper::new(settings.clone()).map_err(|e| wrong_settings(&e))?;
            if let Some(model) = input.sensor() {
                mapper.set_sensor_model(model);
            }
            let (events, corrector) = (input.events(threads)?, elastic.corrector(input.is_raw(), None));
            let pipeline = Self { selection, events, corrector, jumps: Jumps::default(), tally: Tally::default(), clock };
            return Ok(Some((pipeline, Session::new(mapper, pool))));
        };
        let mut corrector = elastic.corrector(input.is_raw(), unfinished.searches.clone());
        // Of a recording, clouds can be read again only once it was played.
        let Some(events) = unfinished.input.take().map(|state| input.events_from(threads, state)).transpose()?.flatten() else { return Ok(None) };
        input.know_motions(unfinished.motions());
        let (jumps, tally) = (unfinished.jumps.clone(), Tally { skipped: unfinished.skipped, ..Tally::default() });
        let session = unfinished.session(settings, input.sensor(), input.clouds().as_mut(), &mut corrector, pool)?;
        Ok(Some((Self { selection, events, corrector, jumps, tally, clock }, session)))
    }

    /// Loop closures and optimisation.
    pub fn corrector(&self) -> &Corrector {
        &self.corrector
    }

    /// Passes all events to the mapper, until they end or the user interrupts, and keeps checkpoints.
    pub fn run(&mut self, session: &mut Session, target: &mut Target, keeper: &mut Keeper, quiet: bool) -> anyhow::Result<()> {
        let input = &self.selection.input;
        let mut progress = Progress::new("scans", input.scans().map(|n| n as u64), quiet);
        if session.scans() > 0 {
            progress.start_after((session.scans() + self.tally.skipped) as u64);
        }
        session.set_idle_task(|| self.events.idle_task());
        while let Some(event) = self.events.next() {
            let is_scan = matches!(event, Ok(Event::Scan(_)) | Err(_));
            let sensors = session.mapper().sensor_count();
            self.take(event, session, keeper)?;
            if let (true, Some(sensor)) = (session.mapper().sensor_count() > sensors, session.mapper().sensor()) {
                tracing::info!("sensor: {sensor}");
            }
            if is_scan {
                progress.step(|| note(input, session));
            }
            if interrupt::requested() {
                self.tally.interrupted = true;
                // The map will have what came until now, and so has this.
                keeper.keep_now(target, session, &self.stages());
                break;
            }
            keeper.keep(target, session, &self.stages());
        }
        Ok(())
    }

    fn take(&mut self, event: anyhow::Result<Event>, session: &mut Session, keeper: &mut Keeper) -> anyhow::Result<()> {
        self.tally.broken |= event.as_ref().is_err_and(failure::is_bug_of_decoder);
        let event = event.map(|event| session.localised(event));
        if let Ok(event) = &event {
            keeper.note(event);
        }
        match event.and_then(|event| Ok(corrected(&mut self.corrector, session, |c| c.take(event))?)) {
            Ok(events) => events.into_iter().try_for_each(|event| match self.jumps.check(&event) {
                Ok(()) => session.take(event).map_or_else(|e| self.skip(e.into()), |_| Ok(())),
                Err(jump) => self.skip(jump.into()),
            }),
            Err(problem) => self.skip(problem),
        }
    }

    fn skip(&mut self, problem: anyhow::Error) -> anyhow::Result<()> {
        if self.selection.strict {
            return Err(problem.context("a scan cannot be used (--strict); no map was written"));
        }
        tracing::warn!("scan skipped: {}", one_line(&problem));
        self.tally.skipped += 1;
        Ok(())
    }

    fn stages(&self) -> Stages<'_> {
        let input = Box::new(|| self.events.state());
        Stages { input, corrector: &self.corrector, jumps: &self.jumps, skipped: self.tally.skipped, came: [0; 2] }
    }

    /// Passes the last corrections to the mapper. Returns the counts.
    pub fn finish(mut self, session: &mut Session) -> Tally {
        let Selection { input, held_out, .. } = self.selection;
        self.tally.mapping_s = self.clock.elapsed().as_secs_f64();
        self.tally.skipped += input.without_pose();
        self.tally.odometry = self.events.odometry();
        self.tally.held_out = held_out.load(Ordering::Relaxed);
        let last = corrected(&mut self.corrector, session, Corrector::finish).map_err(anyhow::Error::from);
        let last = last.and_then(|events| Ok(events.into_iter().try_for_each(|event| session.take(event).map(|_| ()))?));
        self.tally.closures = self.corrector.closures().map(ClosureSummary::of);
        if let Err(problem) = last {
            tracing::warn!("the last correction is missing: {}", one_line(&problem));
        }
        self.tally
    }
}

/// What progress says beside the number of scans.
fn note(input: &Input, session: &Session) -> String {
    let read = input.progress().map_or_else(String::new, |part| format!("{:.0} % read, ", part * 100.0));
    format!("{read}{} submaps", session.mapper().atlas().submaps().len())
}
