//! A run of the mapper: what comes goes through poses and corrections into a map that is kept.

mod begin;
mod complete;
mod follow;
mod following;
mod localise;
mod save;

pub use begin::Plan;
pub use following::Bent;
pub use save::SavedSession;

use crate::corrections::{ClosureSummary, Corrections};
use crate::input::Input;
use crate::keep::{CheckpointEvery, CheckpointSummary, Comes, Identity, Keeper, Stages, Target};
use crate::mapping::{Mapping, empty_mapper};
use crate::poses::{Jumps, MapFrame, OdometryStage, OdometrySummary, Outcome, PoseStage, PoseWatch, Relocalisation, StreamPosition, placed};
use crate::warning::{Code, Warnings};
use crate::{Error, Result};
use following::Following;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::{IdleTask, Mapper, ScanReport};
use voxelastic::sensor::BeamModel;
use voxelastic_io::store::MapDetails;
use voxelastic_io::{Origin, ReadPosition};
use voxelastic_slam::Corrector;
use voxelastic_slam::loops::LoopSettings;

/// Maps what comes, in one thread: what happens does not depend on when it happens.
///
/// Every door to this program is one of these: the command pulls inputs from a [`Source`](crate::Source), a live node takes them from a queue, Python hands them
/// over. So the same inputs and settings give the same map, bit for bit.
pub struct MappingRun {
    mapping: Mapping,
    poses: PoseStage,
    corrections: Corrections,
    corrector: Corrector,
    /// Whether it is known where poses come from, and so what corrects them.
    is_decided: bool,
    jumps: Jumps,
    position: StreamPosition,
    alignment: Alignment,
    sensor: Option<BeamModel>,
    kept: Option<Kept>,
    /// Compares poses with scans that others did not compare before.
    pose_watch: Option<PoseWatch>,
    /// Rebuilds what corrections bend, if scans are kept.
    following: Option<Following>,
    /// Scans that an earlier process had mapped.
    resumed: usize,
    warnings: Warnings,
}

/// Where what comes belongs in the map of an earlier process.
#[derive(Default)]
struct Alignment {
    /// Finds the first scans there.
    search: Option<Box<Relocalisation>>,
    /// The last node of before.
    last_node: Option<NodeId>,
    /// Where the frame of the poses that come lies in the map, if that is another one.
    t_map_frame: Option<Pose>,
}

/// Where a run is kept.
struct Kept {
    target: Target,
    identity: Identity,
    every: CheckpointEvery,
    comes: Comes,
    /// Once it is known what has to be kept.
    keeper: Option<Keeper>,
}

/// What became of an input.
#[derive(Debug, Default)]
pub struct Taken {
    /// Scans that were integrated, each with the lidar frame in the map frame at that time.
    pub integrated: Vec<(ScanReport, Pose)>,
    /// Why scans and events were refused.
    pub refused: Vec<String>,
}

/// Is told what happens to the map.
pub trait Observer {
    /// Before the mapper takes an event.
    fn before(&mut self, _event: &Event, _mapping: &Mapping) {}
    /// After the mapper has taken it.
    fn after(&mut self, _moment: &Moment<'_>) {}
    /// After a submap was rebuilt from its scans, as corrections had bent it.
    fn rebuilt(&mut self, _moment: &Moment<'_>) {}
    /// Another map has begun.
    fn restarted(&mut self) {}
}

impl Observer for () {}

/// The moment after an event.
pub struct Moment<'a> {
    /// The map.
    pub mapping: &'a Mapping,
    /// The last pose of the odometry: node, time and pose in its own frame.
    pub odometry_pose: Option<(NodeId, f64, Pose)>,
    /// What was added to the numbers of nodes.
    pub first_node: NodeId,
}

impl MappingRun {
    /// Takes what comes next. What cannot be used is refused, counted and said, and leaves the map unchanged.
    pub fn take(&mut self, input: Input, observer: &mut dyn Observer) -> Taken {
        let mut taken = Taken::default();
        self.position.note_input();
        if let Input::BadPose(problem) = input {
            self.warnings.add_repeated(Code::BadPose, format!("pose left out: {problem}"), "");
            return taken;
        }
        if let (Some(watch), Input::Event(Event::Scan(scan))) = (&mut self.pose_watch, &input) {
            watch.take(scan, &mut self.warnings);
        }
        let posed = self.poses.take(input, &mut self.warnings);
        self.decide();
        match posed {
            Ok(events) => events.into_iter().for_each(|event| self.arrange(event, observer, &mut taken)),
            Err(problem) => self.skip(problem, &mut taken),
        }
        taken
    }

    /// After the last input: passes the scans that wait, and the last corrections, to the mapper.
    pub fn finish(&mut self, observer: &mut dyn Observer) {
        let mut taken = Taken::default();
        self.pose_watch.iter_mut().for_each(|watch| watch.finish(&mut self.warnings));
        let waiting = self.poses.finish(&mut self.warnings);
        waiting.into_iter().for_each(|event| self.arrange(event, observer, &mut taken));
        match self.corrected(Corrector::finish) {
            Ok(events) => events.into_iter().for_each(|event| {
                if let Err(problem) = self.tell(event, observer, &mut taken) {
                    self.warnings.add(Code::NoLastCorrection, format!("the last correction is missing: {}", problem.one_line()), "");
                }
            }),
            Err(problem) => self.warnings.add(Code::NoLastCorrection, format!("the last correction is missing: {}", problem.one_line()), ""),
        }
    }

    /// Inputs are those of this data from here on. Returns how many of them an earlier process has taken, which are to be left out.
    ///
    /// # Errors
    /// When the run goes on with one that had taken inputs of other data.
    pub fn begin_data(&mut self, data: u64) -> Result<u64> {
        let words = "the run that is gone on with had taken scans of other data, or its files were changed since";
        self.position.begin_data(data).ok_or_else(|| Error::usage(words, "map to another place, or begin anew"))
    }

    /// Sets the sensor's own tables of beams before the first scan.
    ///
    /// # Errors
    /// When scans were mapped without them by an earlier process.
    pub fn set_sensor_model(&mut self, model: BeamModel) -> Result<()> {
        if self.sensor.is_some() || self.mapping.mapper().sensor().is_some() && self.resumed == 0 {
            return Ok(());
        }
        if self.resumed > 0 {
            return Err(Error::usage("a run with the sensor's own tables of beams cannot be gone on with here", "begin anew"));
        }
        self.mapping.set_sensor_model(model.clone());
        self.sensor = Some(model);
        Ok(())
    }

    /// Notes where the reading of a recording was after the last input.
    pub fn note_position(&mut self, position: Option<ReadPosition>) {
        self.position.note(position);
    }

    /// Notes that a scan came, after so many that were left out.
    pub fn note_scan(&mut self, left_out: usize) {
        self.position.note_scan(left_out);
    }

    /// Writes a checkpoint if one is due; while scans wait only if it cannot wait itself.
    pub fn keep(&mut self, scans_wait: bool) {
        self.with_keeper(|keeper, target, stages, warnings| keeper.keep(target, stages, scans_wait, warnings));
    }

    /// Writes a checkpoint, unless the run has no state now from which it could go on.
    pub fn keep_now(&mut self) {
        self.with_keeper(|keeper, target, stages, warnings| keeper.keep_now(target, stages, warnings));
    }

    fn with_keeper(&mut self, work: impl FnOnce(&mut Keeper, &mut Target, &Stages<'_>, &mut Warnings)) {
        let Self { mapping, poses, corrector, jumps, position, alignment, kept, warnings, .. } = self;
        let Some(Kept { target, keeper: Some(keeper), .. }) = kept else { return };
        let position = alignment.search.is_none().then_some(&*position);
        work(keeper, target, &Stages { mapping, poses, position, corrector, jumps }, warnings);
    }

    /// Maps an event where it belongs in the map of before, once that is known.
    fn arrange(&mut self, event: Event, observer: &mut dyn Observer, taken: &mut Taken) {
        let Some(search) = &mut self.alignment.search else {
            let event = match &self.alignment.t_map_frame {
                Some(t_map_frame) => placed(event, t_map_frame),
                None => event,
            };
            return self.map(event, observer, taken);
        };
        let Some(found) = search.take(event, &self.mapping) else { return };
        self.alignment.search = None;
        let held = match found {
            Outcome::InFrame(held) => held,
            Outcome::InMap(found) => {
                let MapFrame { t_map_frame, edge, held } = *found;
                self.alignment.t_map_frame = Some(t_map_frame);
                // From here on poses come in the frame of the map, corrected as it is.
                let last = self.alignment.last_node.and_then(|node| Some((node, self.mapping.mapper().pose(node)?)));
                last.into_iter().for_each(|last| self.map(Event::PoseUpdate(vec![last]), observer, taken));
                edge.into_iter().for_each(|edge| self.map(Event::LoopEdge(edge), observer, taken));
                held.into_iter().map(|event| placed(event, &t_map_frame)).collect()
            }
            Outcome::NotFound(why, held) => {
                self.warnings.add(Code::NotInMap, format!("the scans are not where the map of before is, so a new one begins: {why}"), "");
                if let Err(problem) = self.set_aside().and_then(|()| self.restart(observer)) {
                    return self.skip(problem.one_line(), taken);
                }
                held
            }
        };
        held.into_iter().for_each(|event| self.map(event, observer, taken));
    }

    fn map(&mut self, event: Event, observer: &mut dyn Observer, taken: &mut Taken) {
        let record = self.keeper().and_then(|keeper| keeper.record_of(&event));
        let corrected = self.corrected(|corrector| corrector.take(event));
        if let Some(Kept { keeper: Some(keeper), .. }) = &mut self.kept {
            keeper.add(record, &self.corrector);
        }
        match corrected {
            Ok(events) => events.into_iter().for_each(|event| {
                if let Err(problem) = self.jumps.check(&event).and_then(|()| self.tell(event, observer, taken)) {
                    self.skip(problem.one_line(), taken);
                }
            }),
            Err(problem) => self.skip(problem.one_line(), taken),
        }
    }

    /// Passes an event to the mapper, and says so.
    fn tell(&mut self, event: Event, observer: &mut dyn Observer, taken: &mut Taken) -> Result<()> {
        observer.before(&event, &self.mapping);
        self.note_for_following(&event);
        let pose = if let Event::Scan(scan) = &event { scan.t_map_lidar } else { Pose::identity() };
        taken.integrated.extend(self.mapping.take(event)?.map(|report| (report, pose)));
        observer.after(&self.moment());
        Ok(())
    }

    /// The moment, as an observer is told it.
    pub fn moment(&self) -> Moment<'_> {
        Moment { mapping: &self.mapping, odometry_pose: self.poses.odometry_pose(), first_node: self.poses.first_node() }
    }

    /// Does a step of the corrector in the mapper's threads. The time of an optimisation goes into the log.
    fn corrected<T: Send>(&mut self, step: impl FnOnce(&mut Corrector) -> std::result::Result<T, voxelastic_slam::SlamError> + Send) -> Result<T> {
        let corrector = &mut self.corrector;
        let result = self.mapping.pool().install(|| step(corrector));
        if let Some(took) = self.corrector.take_optimisation_time() {
            self.mapping.optimised(took);
        }
        Ok(result?)
    }

    fn skip(&mut self, problem: String, taken: &mut Taken) {
        self.warnings.add(Code::ScanSkipped, format!("scan skipped: {problem}"), "");
        taken.refused.push(problem);
    }

    /// Makes a map of its own of what an earlier process has kept.
    fn set_aside(&mut self) -> Result<()> {
        let Self { kept, warnings, .. } = self;
        kept.as_mut().map_or(Ok(()), |kept| kept.target.set_unfinished_aside(warnings))
    }

    /// Drops the map and begins a new one.
    ///
    /// # Errors
    /// None, unless settings have become wrong.
    pub fn restart(&mut self, observer: &mut dyn Observer) -> Result<()> {
        let mapper = empty_mapper(self.mapping.mapper().settings(), self.sensor.clone())?;
        self.begin_anew(mapper, None, observer);
        self.poses.go_on(self.poses.first_node(), None);
        Ok(())
    }

    fn begin_anew(&mut self, mapper: Mapper, log: Option<voxelastic_report::RunLog>, observer: &mut dyn Observer) {
        self.mapping.restart(mapper, log, &mut self.warnings);
        self.corrector = self.corrections.corrector(self.poses.is_raw() == Some(true), None, LoopSettings::default());
        (self.jumps, self.alignment) = (Jumps::default(), Alignment::default());
        if let Some(keeper) = self.keeper() {
            keeper.restart();
        }
        self.following.iter_mut().for_each(Following::clear);
        observer.restarted();
    }

    fn keeper(&mut self) -> Option<&mut Keeper> {
        self.kept.as_mut().and_then(|kept| kept.keeper.as_mut())
    }

    /// Gives up what is kept of the map so far, as another one begins.
    pub fn discard_checkpoints(&mut self) {
        if let Some(kept) = &mut self.kept {
            kept.target.discard_checkpoints();
        }
    }

    /// Goes on in a saved map, in which the scans that come are found first. The map so far is dropped; if the other one cannot be used, nothing changes.
    ///
    /// # Errors
    /// Settings that do not fit the map.
    pub fn go_on_in(&mut self, map: SavedMap, observer: &mut dyn Observer) -> Result<()> {
        let SavedMap { atlas, origin, log } = map;
        let settings = self.mapping.mapper().settings().clone();
        let mapper = self.mapping.pool().install(|| Mapper::in_saved(settings, self.sensor.clone(), atlas))?;
        let (first_node, last_node) = (mapper.next_node(), mapper.last_node());
        self.discard_checkpoints();
        self.begin_anew(mapper, log, observer);
        self.poses.go_on(first_node, Some(origin));
        let has_frame = self.poses.is_raw() != Some(true);
        let search = Some(Box::new(Relocalisation::new(&self.mapping, has_frame)));
        self.alignment = Alignment { search, last_node, t_map_frame: None };
        Ok(())
    }

    /// Sets work for threads that would be idle during a scan, if there is more than one.
    pub fn set_idle_task(&mut self, task: impl FnOnce() -> IdleTask) {
        self.mapping.set_idle_task(task);
    }

    /// Compares the poses that come with the scans now and then: for poses that nobody has compared before.
    pub fn watch_poses(&mut self) {
        self.pose_watch = Some(PoseWatch::default());
    }

    /// Leaves coordinates as they are, because others know their frame: the map has no origin of its own.
    pub fn keep_frame(&mut self) {
        self.poses.keep_frame();
    }

    /// The map, without the run; it is completed first.
    pub fn into_atlas(self) -> Atlas {
        self.mapping.into_atlas()
    }

    /// The mapper, its threads, and the log.
    pub fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// The same, to be changed.
    pub fn mapping_mut(&mut self) -> &mut Mapping {
        &mut self.mapping
    }

    /// Scans integrated so far.
    pub fn scans(&self) -> usize {
        self.mapping.scans()
    }

    /// Of these, scans that an earlier process had integrated.
    pub fn scans_resumed(&self) -> usize {
        self.resumed
    }

    /// Scans and events that could not be used.
    pub fn skipped(&self) -> usize {
        self.warnings.count(Code::ScanSkipped)
    }

    /// Scans whose place in the map of before is not found yet.
    pub fn scans_waiting(&self) -> usize {
        self.alignment.search.as_ref().map_or(0, |search| search.scans())
    }

    /// The node that came last.
    pub fn last_node(&self) -> Option<NodeId> {
        self.mapping.mapper().last_node()
    }

    /// Whether as many scans were taken as may be.
    pub fn is_full(&self) -> bool {
        self.poses.is_full()
    }

    /// How far it is in what comes.
    pub fn position(&self) -> &StreamPosition {
        &self.position
    }

    /// What it has said.
    pub fn warnings(&self) -> &Warnings {
        &self.warnings
    }

    /// The same, to be taken, and to be added to.
    pub fn warnings_mut(&mut self) -> &mut Warnings {
        &mut self.warnings
    }

    /// The origin of the map: what is to be added to its coordinates.
    pub fn origin(&self) -> Origin {
        self.poses.origin()
    }

    /// Whether poses are estimated; none before the first scan has decided.
    pub fn is_raw(&self) -> Option<bool> {
        self.poses.is_raw()
    }

    /// How the map is made, to be stored with it.
    pub fn details(&self) -> MapDetails {
        crate::keep::details(&self.mapping, &self.poses)
    }

    /// Figures of the odometry, if there is one.
    pub fn odometry(&self) -> Option<OdometrySummary> {
        self.poses.odometry().map(OdometryStage::summary)
    }

    /// Loop closures that were tried, if they are looked for.
    pub fn closures(&self) -> Option<ClosureSummary> {
        self.corrector.closures().map(ClosureSummary::of)
    }

    /// Checkpoints that were written.
    pub fn checkpoints(&self) -> CheckpointSummary {
        self.kept.as_ref().and_then(|kept| kept.keeper.as_ref()).map(Keeper::summary).unwrap_or_default()
    }

    /// Where the map is kept.
    pub fn target(&self) -> Option<&Target> {
        self.kept.as_ref().map(|kept| &kept.target)
    }
}

/// A saved map in which a run goes on.
pub struct SavedMap {
    /// Its submaps.
    pub atlas: Atlas,
    /// Where their coordinates count from.
    pub origin: Origin,
    /// The log of the run that made it, if it is of the same scans.
    pub log: Option<voxelastic_report::RunLog>,
}
