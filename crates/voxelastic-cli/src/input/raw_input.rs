//! Raw scans, whose poses the odometry finds while they are mapped.

use crate::data::{DataArgs, HoldOut};
use crate::meshing;
use crate::odometry_log::{OdometryLog, OdometrySummary};
use crate::usage::PoolClock;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::error::Error;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::ScanSource;
use voxelastic::motion::Motion;
use voxelastic::sensor::BeamModel;
use voxelastic::{Cloud, Pose};
use voxelastic_io::bag::KEYFRAME_DISTANCE_M;
use voxelastic_io::raw::{RawScans, TimedScan, TimedScans};
use voxelastic_io::{KeyframeFilter, Keyframing, OpenOptions, ReadPosition};
use voxelastic_slam::odometry::{OdometrySettings, Status};
use voxelastic_slam::slam::{RawScan, Slam, SlamState};

/// How the lidar moved during each sweep that was mapped.
type Motions = Arc<Mutex<HashMap<NodeId, Motion>>>;

/// Raw scans, and which of them to map.
pub struct RawInput {
    scans: RawScans,
    settings: OdometrySettings,
    keyframing: Keyframing,
    most: usize,
    hold_out: Option<(HoldOut, Arc<AtomicUsize>)>,
    motions: Motions,
}

impl RawInput {
    /// Opens the scans; poses in the data are not used.
    pub fn open(data: &DataArgs) -> voxelastic_io::Result<Self> {
        let options = data.options(false);
        let scans = voxelastic_io::raw::open(data.path(), &options)?;
        let mut settings = OdometrySettings::default();
        settings.deskew = options.deskew;
        let usual = if scans.is_recording() { Keyframing::Metres(KEYFRAME_DISTANCE_M) } else { Keyframing::All };
        let keyframing = options.keyframing.unwrap_or(usual);
        Ok(Self { scans, settings, keyframing, most: usize::MAX, hold_out: None, motions: Motions::default() })
    }

    pub(super) fn description(&self) -> String {
        let of = if self.scans.t_first_sensor().is_empty() { "" } else { " of the first sensor, which the others follow" };
        format!("{}\nscans taken: {}\nposes: by odometry{of}", self.scans.description(), self.keyframing)
    }

    pub(super) fn scans(&self) -> Option<usize> {
        self.scans.count().filter(|_| self.keyframing == Keyframing::All).map(|n| n.min(self.most))
    }

    pub(super) fn sensor(&self) -> Option<BeamModel> {
        self.scans.sensor()
    }

    pub(super) fn limit(&mut self, most: usize) {
        self.most = most;
    }

    pub(super) fn remove_held_out(&mut self, hold_out: HoldOut) -> Arc<AtomicUsize> {
        let count = Arc::default();
        self.hold_out = Some((hold_out, Arc::clone(&count)));
        count
    }

    pub(super) fn events(&self, threads: usize) -> anyhow::Result<RawEvents> {
        Ok(RawEvents { scans: self.scans.iter(), stage: self.stage(threads)?, ready: VecDeque::new() })
    }

    /// The events after those of an earlier process.
    pub(super) fn events_from(&self, threads: usize, position: &ReadPosition, state: Option<StageState>) -> anyhow::Result<RawEvents> {
        let mut stage = self.stage(threads)?;
        if let Some(state) = state {
            stage.resume(state);
        }
        Ok(RawEvents { scans: self.scans.iter_from(position), stage, ready: VecDeque::new() })
    }

    pub(super) fn fingerprint(&self) -> u64 {
        self.scans.fingerprint()
    }

    pub(super) fn know_motions(&self, motions: impl IntoIterator<Item = (NodeId, Motion)>) {
        self.motions.lock().unwrap_or_else(PoisonError::into_inner).extend(motions);
    }

    /// The raw scans, or those from a position on.
    pub(super) fn raw_scans(&self, from: Option<&ReadPosition>) -> TimedScans {
        from.map_or_else(|| self.scans.iter(), |from| self.scans.iter_from(from))
    }

    /// The stage that registers raw scans in order.
    pub(super) fn stage(&self, threads: usize) -> anyhow::Result<OdometryStage> {
        let stage = OdometryStage::new(self.settings.clone(), self.scans.t_first_sensor(), self.keyframing, threads)?;
        let selection = ScanSelection { hold_out: self.hold_out.clone(), left: self.most, ..stage.selection };
        Ok(OdometryStage { selection, motions: Arc::clone(&self.motions), ..stage })
    }

    pub(super) fn clouds(&self) -> Box<dyn ScanSource + Send> {
        Box::new(MovingClouds { clouds: self.scans.clouds(), motions: Arc::clone(&self.motions) })
    }
}

/// Registers raw scans, in a thread pool of its own.
pub struct OdometryStage {
    slam: Slam,
    settings: OdometrySettings,
    /// Pose of each further sensor in the frame of the first.
    t_first_sensor: Vec<Pose>,
    pool: rayon::ThreadPool,
    clock: PoolClock,
    selection: ScanSelection,
    motions: Motions,
    log: OdometryLog,
}

/// Which scans are taken.
struct ScanSelection {
    keyframing: Keyframing,
    /// By sensor.
    chosen: BTreeMap<u16, Chosen>,
    hold_out: Option<(HoldOut, Arc<AtomicUsize>)>,
    /// Scans that may still be taken.
    left: usize,
}

impl ScanSelection {
    /// Whether the next scan of a sensor is taken, by its pose in the map frame and its time in seconds.
    fn takes(&mut self, sensor: u16, pose: &Pose, time: f64) -> bool {
        let keyframing = self.keyframing;
        let Chosen { keyframes, selected } =
            self.chosen.entry(sensor).or_insert_with(|| Chosen { keyframes: KeyframeFilter::new(keyframing), selected: 0 });
        if self.left == 0 || !keyframes.takes(pose, time) {
            return false;
        }
        let index = *selected;
        *selected += 1;
        match &self.hold_out {
            Some((hold_out, count)) if hold_out.holds_out(index) => {
                count.fetch_add(1, Ordering::Relaxed);
                false
            }
            _ => {
                self.left -= 1;
                true
            }
        }
    }
}

/// Which scans of a sensor are taken.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Chosen {
    keyframes: KeyframeFilter,
    /// Keyframes seen.
    selected: usize,
}

/// What an [`OdometryStage`] knows between two scans.
#[derive(Serialize, Deserialize)]
pub struct StageState {
    slam: SlamState,
    chosen: BTreeMap<u16, Chosen>,
    held_out: usize,
    left: usize,
    log: OdometryLog,
}

impl OdometryStage {
    fn new(settings: OdometrySettings, t_first_sensor: &[Pose], keyframing: Keyframing, threads: usize) -> anyhow::Result<Self> {
        let pool = meshing::pool(threads)?;
        let clock = PoolClock::new(&pool);
        Ok(Self {
            slam: Slam::new(settings.clone()).with_sensors(t_first_sensor.to_vec()),
            settings,
            t_first_sensor: t_first_sensor.to_vec(),
            pool,
            clock,
            selection: ScanSelection { keyframing, chosen: BTreeMap::new(), hold_out: None, left: usize::MAX },
            motions: Motions::default(),
            log: OdometryLog::default(),
        })
    }

    /// The stage for scans that come as those of a recording do, with its usual keyframes.
    ///
    /// # Errors
    /// When its threads cannot be started.
    pub fn of_recording(options: &OpenOptions, threads: usize) -> anyhow::Result<Self> {
        let mut settings = OdometrySettings::default();
        settings.deskew = options.deskew;
        Self::new(settings, &[], options.keyframing.unwrap_or(Keyframing::Metres(KEYFRAME_DISTANCE_M)), threads)
    }

    /// What it knows; none while scans of further sensors wait for their poses.
    pub fn state(&self) -> Option<StageState> {
        Some(StageState {
            slam: self.slam.state()?,
            chosen: self.selection.chosen.clone(),
            held_out: self.selection.hold_out.as_ref().map_or(0, |(_, count)| count.load(Ordering::Relaxed)),
            left: self.selection.left,
            log: self.log.clone(),
        })
    }

    /// Goes on with what the stage of another process knew, and the scans after those that it has seen.
    pub fn resume(&mut self, state: StageState) {
        self.slam = Slam::resume(self.settings.clone(), self.t_first_sensor.clone(), state.slam);
        if let Some((_, count)) = &self.selection.hold_out {
            count.store(state.held_out, Ordering::Relaxed);
        }
        (self.selection.chosen, self.selection.left, self.log) = (state.chosen, state.left, state.log);
    }

    /// Goes on with the figures of another process, from scans of another time.
    pub fn resume_log(&mut self, state: StageState) {
        self.log = state.log;
    }

    /// The figures so far.
    pub fn summary(&self) -> OdometrySummary {
        self.log.summary()
    }

    /// Whether as many scans were taken as may be.
    pub fn is_full(&self) -> bool {
        self.selection.left == 0
    }

    /// Registers a scan, which messages call `name`. Returns its events, and those of scans of further sensors that waited for its pose.
    ///
    /// # Errors
    /// A scan that could not be registered.
    pub fn take(&mut self, raw: RawScan, name: &str) -> Result<Vec<Event>, String> {
        if raw.cloud.sensor > 0 {
            self.slam.follow(raw);
            return Ok(Vec::new());
        }
        let Self { slam, selection, .. } = self;
        let (node, time) = (raw.node, raw.time);
        let before = self.clock.now();
        let mut step = self.pool.install(|| slam.register(raw, |pose| selection.takes(0, pose, time)));
        let cpu = before.zip(self.clock.now()).map(|(before, after)| after.saturating_sub(before));
        // A scan that failed says nothing new of the others, and is said by itself.
        if !matches!(step.report.status, Status::Failed(_)) {
            step.events.extend(self.followed());
        }
        self.note_motions(&step.events);
        match self.log.add(node, &step.report, cpu).map(|problem| format!("scan {name}: {problem}")) {
            Some(problem) if step.events.is_empty() => Err(problem),
            Some(problem) => {
                tracing::warn!("{problem}");
                Ok(step.events)
            }
            None => Ok(step.events),
        }
    }

    /// The last scans of further sensors, after all scans have come.
    pub fn finish(&mut self) -> Vec<Event> {
        let events = self.followed();
        warn_without_pose(&self.slam.finish().without_pose);
        self.note_motions(&events);
        events
    }

    /// Events of scans of further sensors whose poses are known now.
    fn followed(&mut self) -> Vec<Event> {
        let Self { slam, selection, .. } = self;
        let followed = slam.followed(|sensor, pose, time| selection.takes(sensor, pose, time));
        warn_without_pose(&followed.without_pose);
        followed.events
    }

    /// Keeps how the lidars moved, for those who read the clouds again.
    fn note_motions(&self, events: &[Event]) {
        for event in events {
            if let Event::Scan(scan) = event
                && let Some(motion) = &scan.cloud.motion
            {
                self.motions.lock().unwrap_or_else(PoisonError::into_inner).insert(scan.node, motion.clone());
            }
        }
    }
}

/// Says which scans of further sensors have no pose.
fn warn_without_pose(nodes: &[NodeId]) {
    if let Some(first) = nodes.first() {
        let count = nodes.len();
        tracing::warn!(
            "{count} scans of further sensors have no pose, the first is node {first}: those of the first sensor around their times are missing"
        );
    }
}

/// A raw scan of the data, for the odometry.
pub(super) fn raw_scan(scan: TimedScan) -> (RawScan, String) {
    (RawScan { node: scan.node, time: scan.time, cloud: scan.cloud, imu: scan.imu }, scan.name)
}

/// Iterator over the events of raw scans. Scans are registered when they are asked for.
pub struct RawEvents {
    scans: TimedScans,
    stage: OdometryStage,
    ready: VecDeque<Event>,
}

impl RawEvents {
    pub(super) fn idle_step(&mut self) -> impl Fn() -> bool + Send + Sync + use<> {
        self.scans.idle_step()
    }

    pub(super) fn summary(&self) -> OdometrySummary {
        self.stage.summary()
    }

    /// Where it is; none between the events of one scan.
    pub(super) fn state(&self) -> Option<(ReadPosition, StageState)> {
        self.ready.is_empty().then(|| Some((self.scans.read_position(), self.stage.state()?)))?
    }

    /// Drops the next scan; false if there is none.
    pub(super) fn skip_scan(&mut self) -> bool {
        self.scans.next().is_some()
    }
}

impl Iterator for RawEvents {
    type Item = anyhow::Result<Event>;

    fn next(&mut self) -> Option<anyhow::Result<Event>> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(Ok(event));
            }
            if self.stage.is_full() {
                return None;
            }
            let scan = match self.scans.next() {
                Some(Ok(scan)) => raw_scan(scan),
                Some(Err(problem)) => return Some(Err(problem.into())),
                None => {
                    self.ready.extend(self.stage.finish());
                    return self.ready.pop_front().map(Ok);
                }
            };
            match self.stage.take(scan.0, &scan.1) {
                Ok(events) => self.ready.extend(events),
                Err(problem) => return Some(Err(anyhow::Error::msg(problem))),
            }
        }
    }
}

/// Reads clouds again, with the motion that the odometry found.
struct MovingClouds {
    clouds: Box<dyn ScanSource + Send>,
    motions: Motions,
}

impl ScanSource for MovingClouds {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        let mut cloud = self.clouds.cloud(node)?;
        cloud.motion = cloud.motion.or_else(|| self.motions.lock().unwrap_or_else(PoisonError::into_inner).get(&node).cloned());
        Ok(cloud)
    }
}
