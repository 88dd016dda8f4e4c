//! Raw scans, whose poses the odometry finds while they are mapped.

use crate::data::{DataArgs, HoldOut};
use crate::meshing;
use crate::odometry_log::{OdometryLog, OdometrySummary};
use crate::usage::PoolClock;
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, VecDeque};
use std::error::Error;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::Cloud;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::ScanSource;
use voxelastic::motion::Motion;
use voxelastic::sensor::BeamModel;
use voxelastic_io::bag::KEYFRAME_DISTANCE_M;
use voxelastic_io::raw::{RawScans, TimedScan, TimedScans};
use voxelastic_io::{KeyframeFilter, Keyframing, OpenOptions, ReadPosition};
use voxelastic_slam::odometry::OdometrySettings;
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
        format!("{}\nscans taken: {}\nposes: by odometry", self.scans.description(), self.keyframing)
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
        let stage = OdometryStage::new(self.settings.clone(), self.keyframing, threads)?;
        Ok(OdometryStage { hold_out: self.hold_out.clone(), left: self.most, motions: Arc::clone(&self.motions), ..stage })
    }

    pub(super) fn clouds(&self) -> Box<dyn ScanSource + Send> {
        Box::new(MovingClouds { clouds: self.scans.clouds(), motions: Arc::clone(&self.motions) })
    }
}

/// Registers raw scans, in a thread pool of its own.
pub struct OdometryStage {
    slam: Slam,
    settings: OdometrySettings,
    pool: rayon::ThreadPool,
    clock: PoolClock,
    keyframes: KeyframeFilter,
    hold_out: Option<(HoldOut, Arc<AtomicUsize>)>,
    /// Keyframes seen.
    selected: usize,
    /// Scans that may still be taken.
    left: usize,
    motions: Motions,
    log: OdometryLog,
}

/// What an [`OdometryStage`] knows between two scans.
#[derive(Serialize, Deserialize)]
pub struct StageState {
    slam: SlamState,
    keyframes: KeyframeFilter,
    held_out: usize,
    selected: usize,
    left: usize,
    log: OdometryLog,
}

impl OdometryStage {
    fn new(settings: OdometrySettings, keyframing: Keyframing, threads: usize) -> anyhow::Result<Self> {
        let pool = meshing::pool(threads)?;
        let clock = PoolClock::new(&pool);
        Ok(Self {
            slam: Slam::new(settings.clone()),
            settings,
            pool,
            clock,
            keyframes: KeyframeFilter::new(keyframing),
            hold_out: None,
            selected: 0,
            left: usize::MAX,
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
        Self::new(settings, options.keyframing.unwrap_or(Keyframing::Metres(KEYFRAME_DISTANCE_M)), threads)
    }

    /// What it knows.
    pub fn state(&self) -> StageState {
        StageState {
            slam: self.slam.state(),
            keyframes: self.keyframes,
            held_out: self.hold_out.as_ref().map_or(0, |(_, count)| count.load(Ordering::Relaxed)),
            selected: self.selected,
            left: self.left,
            log: self.log.clone(),
        }
    }

    /// Goes on with what the stage of another process knew, and the scans after those that it has seen.
    pub fn resume(&mut self, state: StageState) {
        self.slam = Slam::resume(self.settings.clone(), state.slam);
        if let Some((_, count)) = &self.hold_out {
            count.store(state.held_out, Ordering::Relaxed);
        }
        (self.keyframes, self.selected, self.left, self.log) = (state.keyframes, state.selected, state.left, state.log);
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
        self.left == 0
    }

    /// Registers a scan, which messages call `name`. Returns its events.
    ///
    /// # Errors
    /// A scan that could not be registered.
    pub fn take(&mut self, raw: RawScan, name: &str) -> Result<Vec<Event>, String> {
        let Self { slam, keyframes, hold_out, selected, .. } = self;
        let (node, time) = (raw.node, raw.time);
        let takes = |pose: &voxelastic::Pose| {
            if !keyframes.takes(pose, time) {
                return false;
            }
            let index = *selected;
            *selected += 1;
            match hold_out {
                Some((hold_out, count)) if hold_out.holds_out(index) => {
                    count.fetch_add(1, Ordering::Relaxed);
                    false
                }
                _ => true,
            }
        };
        let before = self.clock.now();
        let step = self.pool.install(|| slam.register(raw, takes));
        let cpu = before.zip(self.clock.now()).map(|(before, after)| after.saturating_sub(before));
        for event in &step.events {
            if let Event::Scan(scan) = event {
                self.left -= 1;
                if let Some(motion) = &scan.cloud.motion {
                    self.motions.lock().unwrap_or_else(PoisonError::into_inner).insert(scan.node, motion.clone());
                }
            }
        }
        match self.log.add(node, &step.report, cpu).map(|problem| format!("scan {name}: {problem}")) {
            Some(problem) if step.events.is_empty() => Err(problem),
            Some(problem) => {
                tracing::warn!("{problem}");
                Ok(step.events)
            }
            None => Ok(step.events),
        }
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
        self.ready.is_empty().then(|| (self.scans.read_position(), self.stage.state()))
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
            let scan = match self.scans.next()? {
                Ok(scan) => raw_scan(scan),
                Err(problem) => return Some(Err(problem.into())),
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
