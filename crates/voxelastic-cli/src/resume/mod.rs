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

use crate::failure::{Failure, one_line};
use crate::input::InputState;
use crate::jumps::Jumps;
use crate::mapping::Session;
use crate::target::Target;
use clap::Args;
use record::Record;
use state::RunState;
use voxelastic::Motion;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::{Mapper, MapperState, ResumeError, ScanSource};
use voxelastic::sensor::BeamModel;
use voxelastic::settings::Settings;
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
    /// Scans that came, and those that were left out, while they came.
    pub came: [usize; 2],
    /// The log.
    log: RunLog,
    /// The origin of the map.
    origin: Origin,
    /// Outcomes of the searches for loop closures.
    pub searches: Option<Searches>,
    /// The edge of the voxels in which they were looked for, metres.
    pub loop_voxel_m: Option<f64>,
    /// What the mapper knows beside the atlas.
    mapper: MapperState<'static>,
    /// The submaps.
    atlas: Atlas,
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
        let unusable = |problem: String| unusable(&map, problem);
        let Some((found, differences)) = self.look(target, identity)? else { return Ok(None) };
        if differences.is_empty() {
            return going_on(found).map(Some).map_err(unusable);
        }
        let scans = scans_in(&found);
        let differ = differ(&map, scans, &differences);
        if self.resume || scans > target.scans() {
            let remedy = "use the same input and settings to go on with it, name another map with -o, or give it up with --restart";
            return Err(Failure::new(differ, remedy).into());
        }
        tracing::warn!("{differ}; the map that is there has no fewer scans, so it is given up");
        target.remove_checkpoints()?;
        Ok(None)
    }

    /// As [`find`](Self::find), for what must begin in any case: a run that is not gone on with is set aside, as a map of its own.
    pub fn find_or_set_aside(&self, target: &mut Target, identity: &Identity) -> anyhow::Result<Option<Unfinished>> {
        if self.restart {
            target.remove_checkpoints()?;
            return Ok(None);
        }
        let map = target.path().display().to_string();
        let found = self.look(target, identity).and_then(|found| match found {
            Some((found, differences)) if differences.is_empty() => going_on(found).map(Some).map_err(|problem| unusable(&map, problem)),
            Some((found, differences)) => {
                let remedy = "use the same input and settings to go on with it";
                Err(Failure::new(differ(&map, scans_in(&found), &differences), remedy).into())
            }
            None => Ok(None),
        });
        match found {
            Err(problem) if !self.resume => {
                tracing::warn!("{}", one_line(&problem));
                target.set_unfinished_aside()?;
                Ok(None)
            }
            other => other,
        }
    }

    /// What is in the directory of a run that did not end, and how that run differs from this one.
    fn look(&self, target: &mut Target, identity: &Identity) -> anyhow::Result<Option<(Checkpoint, Vec<String>)>> {
        let map = target.path().display().to_string();
        let found = target.take_checkpoint().map_err(|error| unusable(&map, error.to_string()))?;
        let Some(found) = found else {
            let remedy = "do without --resume to map from the beginning";
            return if self.resume { Err(Failure::new(format!("{map}: there is no run that did not end"), remedy).into()) } else { Ok(None) };
        };
        let (before, _) = Identity::split(&found.state).map_err(|problem| unusable(&map, problem))?;
        let differences = identity.differences(&before);
        Ok(Some((found, differences)))
    }
}

fn scans_in(found: &Checkpoint) -> usize {
    found.atlas.scan_count()
}

fn unusable(map: &str, problem: String) -> anyhow::Error {
    let remedy = format!("--restart maps from the beginning; `voxelastic repair {map}/unfinished` makes a map of what is whole");
    Failure::new(format!("cannot go on with the run that did not end: {problem}"), remedy).into()
}

fn differ(map: &str, scans: usize, differences: &[String]) -> String {
    format!("{map} has {scans} scans of a run that did not end, and that is another run: {}", differences.join("; "))
}

fn going_on(found: Checkpoint) -> Result<Unfinished, String> {
    let scans = scans_in(&found);
    let unfinished = unfinished(found)?;
    tracing::info!("going on with the run that did not end: {scans} scans are mapped (--restart maps from the beginning)");
    Ok(unfinished)
}

fn unfinished(found: Checkpoint) -> Result<Unfinished, String> {
    let (_, state) = Identity::split(&found.state)?;
    let RunState { input, jumps, skipped, came, log, origin, searches, loop_voxel_m, mapper } =
        postcard::from_bytes(state).map_err(|e| format!("its state: {e}"))?;
    let origin = Origin::new(origin).ok_or("its origin is no place")?;
    let records = found.records.iter().map(|bytes| Record::read(bytes)).collect::<Result<_, _>>()?;
    Ok(Unfinished {
        input: Some(input),
        jumps: jumps.into_owned(),
        skipped,
        came,
        log: log.whole(),
        origin,
        searches,
        loop_voxel_m,
        mapper,
        atlas: found.atlas,
        records,
    })
}

impl Unfinished {
    /// Motions of the lidar during sweeps that the run has found.
    pub fn motions(&mut self) -> impl Iterator<Item = (NodeId, Motion)> {
        self.records.iter_mut().filter_map(Record::take_motion)
    }

    /// Scans that were mapped.
    pub fn scans(&self) -> usize {
        self.atlas.scan_count()
    }

    /// Shows `corrector` all that the one of the run has seen. Clouds are read again where it looks for loop closures.
    fn bring_up(&mut self, corrector: &mut Corrector, clouds: &mut (dyn ScanSource + Send)) -> anyhow::Result<()> {
        if corrector.is_idle() {
            return Ok(());
        }
        let looks = self.searches.is_some();
        for mut record in std::mem::take(&mut self.records) {
            let kept = record.take_points();
            let cloud = match record.node().filter(|_| looks && kept.is_none()) {
                Some(node) => clouds.cloud(node).map_err(|problem| {
                    Failure::new(format!("the scan of node {node} cannot be read again: {problem}"), "--restart maps from the beginning")
                })?,
                None => kept.unwrap_or_default(),
            };
            let event: Event = record.event(cloud);
            // What could not be used then cannot be used now.
            let _ = corrector.take(event);
        }
        Ok(())
    }

    /// The session of the run, and `corrector` brought to where its was. Scans come in the order of the input, from where it was; `clouds` reads those before
    /// again.
    pub fn session(
        mut self,
        settings: &Settings,
        sensor: Option<BeamModel>,
        clouds: &mut (dyn ScanSource + Send),
        corrector: &mut Corrector,
        pool: rayon::ThreadPool,
    ) -> anyhow::Result<Session> {
        pool.install(|| self.bring_up(corrector, clouds))?;
        let Self { log, origin, mapper, atlas, .. } = self;
        let resumed = pool.install(|| Mapper::resume(settings.clone(), sensor, mapper, atlas, clouds));
        let mapper = resumed.map_err(|error| match error {
            ResumeError::Settings(error) => Failure::usage(error.to_string(), "see `voxelastic config`"),
            other => Failure::new(format!("cannot go on with the run that did not end: {other}"), "--restart maps from the beginning"),
        })?;
        Ok(Session::resumed(mapper, pool, log, origin))
    }

    /// The run as other scans go on with it, that come later.
    #[must_use]
    pub fn for_other_scans(self) -> Self {
        Self { mapper: self.mapper.for_other_scans(), ..self }
    }

    /// The node that came last, and a number for the next one.
    pub fn nodes(&self) -> (Option<NodeId>, NodeId) {
        (self.mapper.last_node(), self.mapper.next_node())
    }
}
