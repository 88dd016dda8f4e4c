//! Keeps checkpoints of the run that is under way.

use super::Comes;
use super::every::CheckpointEvery;
use super::identity::Identity;
use super::record::Record;
use super::state::RunState;
use super::target::Target;
use crate::error::{Error, Result};
use crate::mapping::Mapping;
use crate::poses::{Jumps, PoseStage, StreamPosition};
use crate::warning::{Code, Warnings};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::time::{Duration, Instant};
use voxelastic::event::Event;
use voxelastic_io::store::MapDetails;
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
    comes: Comes,
    /// Sensors whose first cloud is in the journal.
    sensors: BTreeSet<u16>,
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

/// What is stored of a run.
pub struct Stages<'a> {
    /// The mapper and the log.
    pub mapping: &'a Mapping,
    /// Where poses come from.
    pub poses: &'a PoseStage,
    /// How far it is in what comes; none where nobody can go on from there.
    pub position: Option<&'a StreamPosition>,
    /// Loop closures and optimisation.
    pub corrector: &'a Corrector,
    /// The last position.
    pub jumps: &'a Jumps,
}

impl Keeper {
    /// Of a run that begins or goes on with `scans` mapped. The journal is needed if `corrector` does anything, for motions if the poses are
    /// estimated (`is_raw`) and scans are read again, and for the first clouds of sensors if they come from a program.
    pub fn new(every: CheckpointEvery, identity: Identity, comes: Comes, corrector: &Corrector, is_raw: bool, scans: usize) -> Self {
        let has_journal = !corrector.is_idle() || is_raw && comes == Comes::Again || comes == Comes::InOrder;
        let records = (every != CheckpointEvery::Off && has_journal).then(Vec::new);
        let last = (Instant::now(), Duration::ZERO, scans);
        Self { every, identity, comes, records, with_motions: is_raw, sensors: BTreeSet::new(), last, paused: None, count: 0, took: Duration::ZERO }
    }

    /// Keeps no clouds of these sensors, as it has them.
    pub fn know_sensors(&mut self, sensors: impl IntoIterator<Item = u16>) {
        self.sensors.extend(sensors);
    }

    /// Begins again, with a new map.
    pub fn restart(&mut self) {
        (self.last, self.paused) = ((Instant::now(), Duration::ZERO, 0), None);
        self.sensors.clear();
        self.records.iter_mut().for_each(Vec::clear);
    }

    /// What the journal is to have of an event of the input; none where it is not needed.
    pub fn record_of(&mut self, event: &Event) -> Option<Record> {
        self.records.as_ref()?;
        let record = Record::of(event, self.with_motions && self.comes == Comes::Again)?;
        Some(match event {
            Event::Scan(scan) if self.comes == Comes::InOrder && self.sensors.insert(scan.cloud.sensor) => record.with_cloud(&scan.cloud),
            _ => record,
        })
    }

    /// Adds to the journal, of a scan that comes only once with what the search for loop closures of `corrector`, which has taken it, uses of its points.
    pub fn add(&mut self, record: Option<Record>, corrector: &Corrector) {
        let (Some(record), Some(records)) = (record, &mut self.records) else { return };
        let points = Some(corrector).filter(|_| self.comes != Comes::Again && record.node().is_some()).and_then(Corrector::last_points);
        let record = points.into_iter().fold(record, Record::with_points);
        records.extend(record.bytes().ok());
    }

    /// Writes a checkpoint if one is due. One that cannot be written does not end the run. By default none is due while scans wait, as those that come meanwhile may
    /// be left out.
    pub fn keep(&mut self, target: &mut Target, stages: &Stages<'_>, scans_wait: bool, warnings: &mut Warnings) {
        let waits = scans_wait && self.every == CheckpointEvery::Auto && self.last.0.elapsed() < LONGEST_WAIT;
        if !waits && self.is_due(stages.mapping) {
            self.keep_now(target, stages, warnings);
        }
    }

    /// Writes a checkpoint unless a fusion is in progress or the run has no state now.
    pub fn keep_now(&mut self, target: &mut Target, stages: &Stages<'_>, warnings: &mut Warnings) {
        if self.every == CheckpointEvery::Off || stages.mapping.scans() == 0 {
            return;
        }
        let clock = Instant::now();
        let scans = stages.mapping.scans();
        let Some(state) = state(stages, warnings) else { return };
        let written = self.write(target, stages, &state);
        drop(state);
        match written {
            Ok(()) => {
                self.last = (Instant::now(), clock.elapsed(), scans);
                (self.count, self.took, self.paused) = (self.count + 1, self.took + clock.elapsed(), None);
                tracing::debug!("checkpoint at {scans} scans in {:.0} ms", clock.elapsed().as_secs_f64() * 1e3);
            }
            Err(problem) => {
                let text = format!("a checkpoint could not be written, so a kill would lose what came since the last: {}", problem.one_line());
                warnings.add(Code::NoCheckpoint, text, "");
                self.paused = Some(Instant::now() + PAUSE);
            }
        }
    }

    fn is_due(&self, mapping: &Mapping) -> bool {
        let (at, took, scans) = self.last;
        let took = if took.is_zero() { CheckpointEvery::expected(mapping.atlas().bytes()) } else { took };
        self.every.is_due(mapping.scans() - scans, at.elapsed(), took) && self.paused.is_none_or(|until| Instant::now() >= until)
    }

    fn write(&mut self, target: &mut Target, stages: &Stages<'_>, state: &RunState<'_>) -> Result<()> {
        let (mapping, details) = (stages.mapping, stages.details());
        let checkpoints = target.checkpoints()?;
        self.records.iter_mut().flat_map(std::mem::take).for_each(|record| checkpoints.record(&record));
        let (atlas, identity) = (mapping.atlas(), &self.identity);
        // As it is serialised it goes to the disk: copies of what grows with the run would make the process grow, too.
        let write_state = |out: &mut dyn Write| {
            identity.write(out).and_then(|()| postcard::to_io(state, out).map(drop)).map_err(|problem| io::Error::other(problem.to_string()))
        };
        mapping.pool().install(|| checkpoints.write_with(atlas, &details, write_state)).map_err(Error::from)?;
        Ok(())
    }

    /// Checkpoints written, and the time that they took in all.
    pub fn summary(&self) -> CheckpointSummary {
        CheckpointSummary { count: self.count, total_s: self.took.as_secs_f64() }
    }
}

impl Stages<'_> {
    /// How the map is made, to be stored with it.
    pub fn details(&self) -> MapDetails {
        details(self.mapping, self.poses)
    }
}

/// How a map is made, to be stored with it.
pub fn details(mapping: &Mapping, poses: &PoseStage) -> MapDetails {
    MapDetails::describe(mapping.mapper().settings(), mapping.mapper().sensor()).with_origin(poses.origin())
}

/// What a run knows, if it can go on from here.
fn state<'a>(stages: &Stages<'a>, warnings: &'a Warnings) -> Option<RunState<'a>> {
    let Stages { mapping, poses, position, corrector, jumps } = stages;
    let stage = match poses.odometry() {
        Some(odometry) => Some(odometry.state()?),
        None => None,
    };
    let position = (*position)?;
    Some(RunState {
        position: position.position()?,
        stage,
        jumps: Cow::Borrowed(jumps),
        warnings: Cow::Borrowed(warnings),
        came: position.came(),
        log: mapping.stored_log(),
        origin: poses.origin().coordinates(),
        searches: corrector.searches(),
        loop_voxel_m: corrector.voxel_size(),
        mapper: mapping.mapper().state()?,
    })
}
