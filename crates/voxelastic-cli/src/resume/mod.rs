//! Going on with a run that was killed: what it kept on disk, and whether it is the same run.
//!
//! While a run goes on, a [`Keeper`] writes checkpoints beside the map. Each has what is needed to go on as if nothing had happened: the submaps, what the
//! mapper and the odometry know beside them, the place in the input, and a journal of the poses and edges that came, by which loop closures and
//! optimisation are brought back to where they were.

mod every;
mod identity;
mod keeper;
mod record;
mod state;

pub use every::CheckpointEvery;
pub use identity::Identity;
pub use keeper::{CheckpointSummary, Keeper, Stages};

use crate::failure::Failure;
use crate::input::InputState;
use crate::jumps::Jumps;
use crate::target::Target;
use clap::Args;
use record::Record;
use state::RunState;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::{MapperState, ScanSource};
use voxelastic::{Cloud, Motion};
use voxelastic_io::Origin;
use voxelastic_io::store::Checkpoint;
use voxelastic_report::RunLog;
use voxelastic_slam::Corrector;
use voxelastic_slam::loops::Searches;

/// Arguments about runs that did not end.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Runs that did not end")]
pub struct ResumeArgs {
    /// Go on with the run that did not end; fail if there is none. Without it, a run with the same input and settings goes on, too
    #[arg(long, conflicts_with = "restart")]
    resume: bool,
    /// Map from the beginning, and give up what a run that did not end has mapped
    #[arg(long)]
    restart: bool,
    /// When to keep what is mapped so far, to go on after the process is killed: auto (so that it takes at most a fiftieth of the time),
    /// off, a number of scans, or seconds (30s)
    #[arg(long, value_name = "auto|off|N|SECONDSs", default_value = "auto")]
    checkpoints: CheckpointEvery,
}

/// A run that did not end, to be gone on with.
pub struct Unfinished {
    /// Where the reading of the input is, until it is taken.
    pub input: Option<InputState>,
    /// The last position.
    pub jumps: Jumps,
    /// Scans that could not be used.
    pub skipped: usize,
    /// The log.
    pub log: RunLog,
    /// The origin of the map.
    pub origin: Origin,
    /// Outcomes of the searches for loop closures.
    pub searches: Option<Searches>,
    /// What the mapper knows beside the atlas.
    pub mapper: MapperState,
    /// The submaps.
    pub atlas: Atlas,
    records: Vec<Record>,
}

impl ResumeArgs {
    /// When checkpoints are written.
    pub fn checkpoints(&self) -> CheckpointEvery {
        self.checkpoints
    }

    /// The run in the directory of the target that did not end, if it is to be gone on with. One that has mapped more than the map that is there
    /// is not given up without [`restart`](Self).
    pub fn find(&self, target: &mut Target, identity: &Identity) -> anyhow::Result<Option<Unfinished>> {
        if self.restart {
            target.remove_checkpoints()?;
            return Ok(None);
        }
        let map = target.path().display().to_string();
        let unusable = |problem: String| {
            let remedy = format!("--restart maps from the beginning; `voxelastic repair {map}/unfinished` makes a map of what is whole");
            anyhow::Error::from(Failure::new(format!("cannot go on with the run that did not end: {problem}"), remedy))
        };
        let found = target.take_checkpoint().map_err(|error| unusable(error.to_string()))?;
        let Some(found) = found else {
            let remedy = "do without --resume to map from the beginning";
            return if self.resume { Err(Failure::new(format!("{map}: there is no run that did not end"), remedy).into()) } else { Ok(None) };
        };
        let scans = found.atlas.submaps().iter().map(|submap| submap.scans().len()).sum::<usize>();
        let (before, _) = Identity::split(&found.state).map_err(unusable)?;
        let differences = identity.differences(&before);
        if differences.is_empty() {
            tracing::info!("going on with the run that did not end: {scans} scans are mapped (--restart maps from the beginning)");
            return unfinished(found).map(Some).map_err(unusable);
        }
        let differ = format!("{map} has {scans} scans of a run that did not end, and that is another run: {}", differences.join("; "));
        if self.resume || scans > target.scans() {
            let remedy = "use the same input and settings to go on with it, name another map with -o, or give it up with --restart";
            return Err(Failure::new(differ, remedy).into());
        }
        tracing::warn!("{differ}; the map that is there has no fewer scans, so it is given up");
        target.remove_checkpoints()?;
        Ok(None)
    }
}

fn unfinished(found: Checkpoint) -> Result<Unfinished, String> {
    let (_, state) = Identity::split(&found.state)?;
    let RunState { input, jumps, skipped, log, origin, searches, mapper } = postcard::from_bytes(state).map_err(|e| format!("its state: {e}"))?;
    let origin = Origin::new(origin).ok_or("its origin is no place")?;
    let log = RunLog::from_json(&log).map_err(|e| e.to_string())?;
    let records = found.records.iter().map(|bytes| Record::read(bytes)).collect::<Result<_, _>>()?;
    Ok(Unfinished { input: Some(input), jumps, skipped, log, origin, searches, mapper, atlas: found.atlas, records })
}

impl Unfinished {
    /// Motions of the lidar during sweeps that the run has found.
    pub fn motions(&mut self) -> impl Iterator<Item = (NodeId, Motion)> {
        self.records.iter_mut().filter_map(Record::take_motion)
    }

    /// Shows `corrector` all that the one of the run has seen. Clouds are read again where it looks for loop closures.
    pub fn bring_up(&mut self, corrector: &mut Corrector, clouds: &mut (dyn ScanSource + Send)) -> anyhow::Result<()> {
        if corrector.is_idle() {
            return Ok(());
        }
        let looks = self.searches.is_some();
        for record in std::mem::take(&mut self.records) {
            let cloud = match record.node().filter(|_| looks) {
                Some(node) => clouds.cloud(node).map_err(|problem| {
                    Failure::new(format!("the scan of node {node} cannot be read again: {problem}"), "--restart maps from the beginning")
                })?,
                None => Cloud::default(),
            };
            let event: Event = record.event(cloud);
            // What could not be used then cannot be used now.
            let _ = corrector.take(event);
        }
        Ok(())
    }
}
