//! Keeps checkpoints of the run that is under way.

use super::every::CheckpointEvery;
use super::identity::Identity;
use super::record::Record;
use super::state::RunState;
use crate::failure::one_line;
use crate::input::InputState;
use crate::jumps::Jumps;
use crate::mapping::Session;
use crate::target::Target;
use serde::Serialize;
use std::borrow::Cow;
use std::io::{self, Write};
use std::time::{Duration, Instant};
use voxelastic::event::Event;
use voxelastic_slam::Corrector;

/// A checkpoint that cannot be written is tried again after this at the earliest.
const PAUSE: Duration = Duration::from_secs(60);
/// A checkpoint that is due waits for a moment without scans no longer than this.
const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// Writes a checkpoint now and then.
pub struct Keeper {
    every: CheckpointEvery,
    identity: Identity,
    /// What came since the last checkpoint, for the journal.
    records: Option<Vec<Vec<u8>>>,
    with_motions: bool,
    /// Whether the points by which loop closures are found are kept, as scans do not come again.
    with_points: bool,
    /// When the last checkpoint was complete, how long it took (zero before the first), and how many scans it had.
    last: (Instant, Duration, usize),
    /// Until when none is tried, as the disk has refused one.
    paused: Option<Instant>,
    count: usize,
    took: Duration,
}

/// What checkpoints took.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct CheckpointSummary {
    /// How many were written by this process.
    count: usize,
    /// Time that they took in all, seconds.
    total_s: f64,
}

/// What is stored of a run beside its mapper.
pub struct Stages<'a> {
    /// Where the input is, if that can be said between two events.
    pub input: Box<dyn Fn() -> Option<InputState> + 'a>,
    /// Loop closures and optimisation.
    pub corrector: &'a Corrector,
    /// The last position.
    pub jumps: &'a Jumps,
    /// Scans that could not be used.
    pub skipped: usize,
    /// Scans that came, and those that were left out, while they came.
    pub came: [usize; 2],
}

impl Keeper {
    /// Of a run that begins or goes on with `scans` mapped. The journal is needed if `corrector` does anything, and for motions if the poses are
    /// estimated (`is_raw`).
    pub fn new(every: CheckpointEvery, identity: Identity, corrector: &Corrector, is_raw: bool, scans: usize) -> Self {
        let records = (every != CheckpointEvery::Off && (is_raw || !corrector.is_idle())).then(Vec::new);
        let last = (Instant::now(), Duration::ZERO, scans);
        Self { every, identity, records, with_motions: is_raw, with_points: false, last, paused: None, count: 0, took: Duration::ZERO }
    }

    /// Of a run whose input does not come again.
    #[must_use]
    pub fn of_passing_scans(self, corrector: &Corrector) -> Self {
        let records = self.records.filter(|_| !corrector.is_idle());
        Self { records, with_motions: false, with_points: true, ..self }
    }

    /// Begins again, with a new map.
    pub fn restart(&mut self) {
        (self.last, self.paused) = ((Instant::now(), Duration::ZERO, 0), None);
        self.records.iter_mut().for_each(Vec::clear);
    }

    /// Notes an event of the input.
    pub fn note(&mut self, event: &Event) {
        let record = self.record_of(event);
        self.add(record, None);
    }

    /// What the journal is to have of an event of the input; none where it is not needed.
    pub fn record_of(&self, event: &Event) -> Option<Record> {
        self.records.as_ref().and_then(|_| Record::of(event, self.with_motions))
    }

    /// Adds to the journal, of a scan that comes only once with what the search for loop closures of `corrector`, which has taken it, uses of its points.
    pub fn add(&mut self, record: Option<Record>, corrector: Option<&Corrector>) {
        let (Some(record), Some(records)) = (record, &mut self.records) else { return };
        let points = corrector.filter(|_| self.with_points && record.node().is_some()).and_then(Corrector::last_points);
        let record = points.into_iter().fold(record, Record::with_points);
        records.extend(record.bytes().ok());
    }

    /// Writes a checkpoint if one is due. One that cannot be written does not end the run.
    pub fn keep(&mut self, target: &mut Target, session: &Session, stages: &Stages<'_>) {
        if self.is_due(session) {
            self.keep_now(target, session, stages);
        }
    }

    /// Writes a checkpoint if one is due. By default it is due when no scan waits, as those that come meanwhile may be left out.
    pub fn keep_between_scans(&mut self, target: &mut Target, session: &Session, stages: &Stages<'_>, scans_wait: bool) {
        let waits = scans_wait && self.every == CheckpointEvery::Auto && self.last.0.elapsed() < LONGEST_WAIT;
        if !waits {
            self.keep(target, session, stages);
        }
    }

    /// Writes a checkpoint unless a fusion is in progress or the scan's events are not all taken.
    pub fn keep_now(&mut self, target: &mut Target, session: &Session, stages: &Stages<'_>) {
        if self.every != CheckpointEvery::Off && session.scans() > 0 {
            self.write(target, session, stages);
        }
    }

    fn is_due(&self, session: &Session) -> bool {
        let (at, took, scans) = self.last;
        let took = if took.is_zero() { CheckpointEvery::expected(session.mapper().atlas().bytes()) } else { took };
        self.every.is_due(session.scans() - scans, at.elapsed(), took) && self.paused.is_none_or(|until| Instant::now() >= until)
    }

    /// Writes a checkpoint, unless the run has no state now.
    fn write(&mut self, target: &mut Target, session: &Session, stages: &Stages<'_>) {
        let clock = Instant::now();
        let Some(state) = state(session, stages) else { return };
        match self.try_write(target, session, &state) {
            Ok(()) => {
                self.last = (Instant::now(), clock.elapsed(), session.scans());
                (self.count, self.took, self.paused) = (self.count + 1, self.took + clock.elapsed(), None);
                tracing::debug!("checkpoint at {} scans in {:.0} ms", session.scans(), clock.elapsed().as_secs_f64() * 1e3);
            }
            Err(problem) => {
                tracing::warn!("a checkpoint could not be written, so a kill would lose what came since the last: {}", one_line(&problem));
                self.paused = Some(Instant::now() + PAUSE);
            }
        }
    }

    fn try_write(&mut self, target: &mut Target, session: &Session, state: &RunState<'_>) -> anyhow::Result<()> {
        let details = session.details();
        let checkpoints = target.checkpoints()?;
        self.records.iter_mut().flat_map(std::mem::take).for_each(|record| checkpoints.record(&record));
        let (atlas, identity) = (session.mapper().atlas(), &self.identity);
        // As it is serialised it goes to the disk: copies of what grows with the run would make the process grow, too.
        let write_state = |out: &mut dyn Write| {
            identity.write(out).and_then(|()| postcard::to_io(state, out).map(drop)).map_err(|problem| io::Error::other(problem.to_string()))
        };
        session.pool().install(|| checkpoints.write_with(atlas, &details, write_state))?;
        Ok(())
    }

    /// Checkpoints written, and the time that they took in all.
    pub fn summary(&self) -> CheckpointSummary {
        CheckpointSummary { count: self.count, total_s: self.took.as_secs_f64() }
    }
}

/// What a run knows, if it can go on from here.
fn state<'a>(session: &'a Session, stages: &Stages<'a>) -> Option<RunState<'a>> {
    let (input, mapper) = ((stages.input)()?, session.mapper().state()?);
    Some(RunState {
        input,
        jumps: Cow::Borrowed(stages.jumps),
        skipped: stages.skipped,
        came: stages.came,
        log: session.stored_log(),
        origin: session.origin().coordinates(),
        searches: stages.corrector.searches(),
        loop_voxel_m: stages.corrector.voxel_size(),
        mapper,
    })
}
