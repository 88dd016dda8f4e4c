//! The input of `voxelastic map`: scans with poses, or raw scans whose poses are estimated.

mod positions;
mod raw_input;

use crate::data::{DataArgs, HoldOut};
use crate::failure::{self, Failure};
use crate::interrupt;
use crate::odometry_log::OdometrySummary;
pub use positions::Positions;
use raw_input::RawEvents;
pub use raw_input::{OdometryStage, RawInput, StageState};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use voxelastic::Motion;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::{IdleTask, ScanSource};
use voxelastic::sensor::BeamModel;
use voxelastic_io::source::{Events, Source};
use voxelastic_io::{Error, PoseKind, ReadPosition};
use voxelastic_live::transport::Incoming;

/// Scans with poses, or raw ones.
pub enum Input {
    /// With the poses of a SLAM system.
    Registered(Box<Source>),
    /// Without: odometry gives the poses.
    Raw(Box<RawInput>),
}

impl Input {
    /// Opens the data: with its poses, or raw if it has none or `slam` asks for that.
    pub fn open(data: &DataArgs, strict: bool, slam: bool, pose_kind: PoseKind) -> anyhow::Result<Self> {
        data.check()?;
        let named = data.names_poses();
        if slam && let Some(flag) = named {
            return Err(Failure::usage(format!("--slam estimates the poses, so {flag} has no meaning with it"), "do without one of the two").into());
        }
        if slam {
            return Ok(Self::Raw(Box::new(RawInput::open(data)?)));
        }
        match data.open_with(strict, pose_kind) {
            Ok(source) => Ok(Self::Registered(Box::new(source))),
            Err(Error::NoPoses { path, .. }) if named.is_none() && path == data.path() => {
                tracing::info!("no poses in {}: they are estimated from the scans", data.path().display());
                Ok(Self::Raw(Box::new(RawInput::open(data)?)))
            }
            Err(problem) => Err(problem.into()),
        }
    }

    /// Whether the poses are estimated.
    pub fn is_raw(&self) -> bool {
        matches!(self, Self::Raw(_))
    }

    /// What was found, in a few lines.
    pub fn description(&self) -> String {
        match self {
            Self::Registered(source) => source.description(),
            Self::Raw(raw) => raw.description(),
        }
    }

    /// Number of scans, if it is known before they are read.
    pub fn scans(&self) -> Option<usize> {
        match self {
            Self::Registered(source) => source.scans(),
            Self::Raw(raw) => raw.scans(),
        }
    }

    /// How much of a recording has been played, 0 to 1, if known.
    pub fn progress(&self) -> Option<f64> {
        match self {
            Self::Registered(source) => source.progress(),
            Self::Raw(_) => None,
        }
    }

    /// The sensor's own tables of beams, if the data contain them.
    pub fn sensor(&self) -> Option<BeamModel> {
        match self {
            Self::Registered(source) => source.sensor(),
            Self::Raw(raw) => raw.sensor(),
        }
    }

    /// Clouds without a pose, as far as known.
    pub fn without_pose(&self) -> usize {
        match self {
            Self::Registered(source) => source.without_pose(),
            Self::Raw(_) => 0,
        }
    }

    /// Takes no more than the first `most` scans.
    pub fn limit(&mut self, most: usize) {
        match self {
            Self::Registered(source) => source.limit(most),
            Self::Raw(raw) => raw.limit(most),
        }
    }

    /// Leaves out the held-out scans; the returned counter grows with each of them.
    pub fn remove_held_out(&mut self, hold_out: HoldOut) -> Arc<AtomicUsize> {
        match self {
            Self::Registered(source) => hold_out.remove_held_out(source),
            Self::Raw(raw) => raw.remove_held_out(hold_out),
        }
    }

    /// The registered cloud list. `threads` is the number of threads of the odometry, 0 for all cores.
    ///
    /// # Errors
    /// When the threads cannot be started.
    pub fn events(&self, threads: usize) -> anyhow::Result<InputEvents> {
        Ok(match self {
            Self::Registered(source) => InputEvents::Registered(Box::new(source.events())),
            Self::Raw(raw) => InputEvents::Raw(Box::new(raw.events(threads)?)),
        })
    }

    /// The events that come after those that an earlier process has taken; of a recording, the first are read again. None if the user
    /// interrupts that.
    ///
    /// # Errors
    /// When the threads cannot be started.
    pub fn events_from(&self, threads: usize, state: InputState) -> anyhow::Result<Option<InputEvents>> {
        let Some(position) = state.position else { return self.events(threads).map(Some) };
        let items = items_to_skip(&position);
        let (events, is_there) = match self {
            Self::Registered(source) => {
                let mut events = source.events_from(position);
                let is_there = skip(items, || events.next().is_some());
                (InputEvents::Registered(Box::new(events)), is_there)
            }
            Self::Raw(raw) => {
                let mut events = raw.events_from(threads, &position, state.stage)?;
                let is_there = skip(items, || events.skip_scan());
                (InputEvents::Raw(Box::new(events)), is_there)
            }
        };
        Ok(is_there.then_some(events))
    }

    /// A number that differs, as a rule, for other data.
    pub fn fingerprint(&self) -> u64 {
        match self {
            Self::Registered(source) => source.fingerprint(),
            Self::Raw(raw) => raw.fingerprint(),
        }
    }

    /// Takes over how the lidar moved during sweeps that an earlier process has registered.
    pub fn know_motions(&self, motions: impl IntoIterator<Item = (NodeId, Motion)>) {
        if let Self::Raw(raw) = self {
            raw.know_motions(motions);
        }
    }

    /// What came to the robot that recorded the data, in order: scans with poses and edges, or raw scans; after those up to a position, if an earlier process
    /// has taken them. `positions` are told where it is. Sets `broken` if a decoder panics. None if the user interrupts the reading of what was taken.
    pub fn incoming(&self, from: Option<ReadPosition>, positions: Positions, broken: Arc<AtomicBool>) -> Option<IncomingInputs> {
        let unusable = move |problem: anyhow::Error| {
            broken.fetch_or(failure::is_bug_of_decoder(&problem), Ordering::Relaxed);
            Incoming::Unusable(failure::one_line(&problem))
        };
        let items = from.as_ref().map_or(0, items_to_skip);
        match self {
            Self::Registered(source) => {
                let mut events = from.map_or_else(|| source.events(), |from| source.events_from(from));
                skip(items, || events.next().is_some()).then_some(())?;
                Some(Box::new(std::iter::from_fn(move || {
                    let event = events.next()?;
                    positions.add(events.read_position());
                    Some(event.map_or_else(|problem| unusable(problem.into()), Incoming::Event))
                })))
            }
            Self::Raw(raw) => {
                let mut scans = raw.raw_scans(from.as_ref());
                skip(items, || scans.next().is_some()).then_some(())?;
                Some(Box::new(std::iter::from_fn(move || {
                    let scan = scans.next()?;
                    positions.add(Some(scans.read_position()));
                    Some(match scan.map(raw_input::raw_scan) {
                        Ok((scan, name)) => Incoming::RawScan(scan, name),
                        Err(problem) => unusable(problem.into()),
                    })
                })))
            }
        }
    }

    /// The stage that registers raw scans; none for scans with poses.
    ///
    /// # Errors
    /// When its threads cannot be started.
    pub fn odometry(&self, threads: usize) -> anyhow::Result<Option<OdometryStage>> {
        match self {
            Self::Registered(_) => Ok(None),
            Self::Raw(raw) => raw.stage(threads).map(Some),
        }
    }

    /// Reads clouds again that [`events`](Self::events) delivered.
    pub fn clouds(&self) -> Box<dyn ScanSource + Send> {
        match self {
            Self::Registered(source) => source.clouds(),
            Self::Raw(raw) => raw.clouds(),
        }
    }
}

/// What came to a robot, in order.
pub type IncomingInputs = Box<dyn Iterator<Item = Incoming> + Send>;

/// Where the reading of an [`Input`] is, between two scans.
#[derive(Serialize, Deserialize)]
pub struct InputState {
    /// None where what came does not come again.
    pub position: Option<ReadPosition>,
    /// Of the odometry, if there is one.
    pub stage: Option<StageState>,
}

/// Items of a recording to be read again. Says so, if there are some.
fn items_to_skip(position: &ReadPosition) -> usize {
    let items = position.items_to_skip();
    if items > 0 {
        tracing::info!("reading the recording again up to where the run was");
    }
    items
}

/// Skips so many items; whether there were so many, and no interrupt came.
fn skip(items: usize, mut next: impl FnMut() -> bool) -> bool {
    (0..items).all(|_| !interrupt::requested() && next())
}

/// Iterator over the events of an [`Input`].
pub enum InputEvents {
    /// Of scans with poses.
    Registered(Box<Events>),
    /// Of raw scans.
    Raw(Box<RawEvents>),
}

impl InputEvents {
    /// Work for threads that would be idle: reading one scan ahead.
    pub fn idle_task(&mut self) -> IdleTask {
        match self {
            Self::Registered(events) => IdleTask::new(events.idle_step()),
            Self::Raw(events) => IdleTask::new(events.idle_step()),
        }
    }

    /// Where it is; none between the events of one scan.
    pub fn state(&self) -> Option<InputState> {
        match self {
            Self::Registered(events) => Some(InputState { position: Some(events.read_position()?), stage: None }),
            Self::Raw(events) => events.state().map(|(position, stage)| InputState { position: Some(position), stage: Some(stage) }),
        }
    }

    /// Figures of the odometry so far, if there is one.
    pub fn odometry(&self) -> Option<OdometrySummary> {
        match self {
            Self::Registered(_) => None,
            Self::Raw(events) => Some(events.summary()),
        }
    }
}

impl Iterator for InputEvents {
    type Item = anyhow::Result<Event>;

    fn next(&mut self) -> Option<anyhow::Result<Event>> {
        match self {
            Self::Registered(events) => events.next().map(|event| event.map_err(anyhow::Error::from)),
            Self::Raw(events) => events.next(),
        }
    }
}
