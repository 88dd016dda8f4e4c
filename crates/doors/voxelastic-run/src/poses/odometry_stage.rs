//! The odometry of a run: raw scans in, scans with poses out.

use super::odometry_log::{OdometryLog, OdometrySummary};
use crate::source::HoldOut;
use crate::usage::PoolClock;
use crate::warning::{Code, Warnings};
use crate::{Result, threads};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::Pose;
use voxelastic::event::{Event, NodeId};
use voxelastic::geometry::stored::StoredPose;
use voxelastic::motion::Motion;
use voxelastic_io::bag::KEYFRAME_DISTANCE_M;
use voxelastic_io::{KeyframeFilter, Keyframing, OpenOptions, PointTimes};
use voxelastic_slam::odometry::{OdometrySettings, Status};
use voxelastic_slam::slam::{RawScan, Slam, SlamState};

/// How raw scans are registered, and which of them are mapped.
#[derive(Clone, Debug)]
pub struct OdometrySetup {
    /// Of the registration.
    pub settings: OdometrySettings,
    /// Pose of each further sensor in the frame of the first.
    pub t_first_sensor: Vec<Pose>,
    /// Which scans are mapped.
    pub keyframing: Keyframing,
    /// No more scans than that are mapped.
    pub most: usize,
    /// Scans that are not mapped, and how many of them there were.
    pub hold_out: Option<(HoldOut, Arc<AtomicUsize>)>,
}

impl OdometrySetup {
    /// As the options say, with `usual` keyframes if they say nothing of these.
    pub fn new(options: &OpenOptions, usual: Keyframing) -> Self {
        let mut settings = OdometrySettings::default();
        settings.deskew = options.point_times != PointTimes::Undistorted;
        Self { settings, t_first_sensor: Vec::new(), keyframing: options.keyframing.unwrap_or(usual), most: usize::MAX, hold_out: None }
    }

    /// For scans that come as those of a recording do, with its usual keyframes.
    pub fn of_recording(options: &OpenOptions) -> Self {
        Self::new(options, Keyframing::Metres(KEYFRAME_DISTANCE_M))
    }
}

/// How the lidar moved during each sweep that was mapped, for those who read the clouds again.
#[derive(Clone, Debug, Default)]
pub struct Motions(Arc<Mutex<HashMap<NodeId, Motion>>>);

impl Motions {
    /// Adds some.
    pub fn extend(&self, motions: impl IntoIterator<Item = (NodeId, Motion)>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(motions);
    }

    /// That during the sweep of a node.
    pub fn of(&self, node: NodeId) -> Option<Motion> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&node).cloned()
    }
}

/// Registers raw scans, in a thread pool of its own.
pub struct OdometryStage {
    slam: Slam,
    setup: OdometrySetup,
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
    deskew: bool,
    t_first_sensor: Vec<StoredPose>,
    keyframing: Keyframing,
    chosen: BTreeMap<u16, Chosen>,
    held_out: usize,
    left: usize,
    log: OdometryLog,
}

impl OdometryStage {
    /// A stage with `threads` threads, 0 for all cores, that tells `motions` how the lidar moved.
    ///
    /// # Errors
    /// When its threads cannot be started.
    pub fn new(setup: OdometrySetup, motions: Motions, threads: usize) -> Result<Self> {
        let pool = threads::pool(threads)?;
        let clock = PoolClock::new(&pool);
        let selection = ScanSelection { keyframing: setup.keyframing, chosen: BTreeMap::new(), hold_out: setup.hold_out.clone(), left: setup.most };
        let slam = Slam::new(setup.settings.clone()).with_sensors(setup.t_first_sensor.clone());
        Ok(Self { slam, setup, pool, clock, selection, motions, log: OdometryLog::default() })
    }

    /// What it knows; none while scans of further sensors wait for their poses.
    pub fn state(&self) -> Option<StageState> {
        Some(StageState {
            slam: self.slam.state()?,
            deskew: self.setup.settings.deskew,
            t_first_sensor: self.setup.t_first_sensor.iter().copied().map(StoredPose).collect(),
            keyframing: self.setup.keyframing,
            chosen: self.selection.chosen.clone(),
            held_out: self.selection.hold_out.as_ref().map_or(0, |(_, count)| count.load(Ordering::Relaxed)),
            left: self.selection.left,
            log: self.log.clone(),
        })
    }

    /// Goes on with what the stage of another process knew, and the scans after those that it has seen.
    pub fn resume(&mut self, state: StageState) {
        // A program that pushes scans has not said yet what they are.
        self.setup.settings.deskew = state.deskew;
        self.setup.t_first_sensor = state.t_first_sensor.iter().map(|pose| pose.0).collect();
        (self.setup.keyframing, self.selection.keyframing) = (state.keyframing, state.keyframing);
        self.slam = Slam::resume(self.setup.settings.clone(), self.setup.t_first_sensor.clone(), state.slam);
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
    pub fn take(&mut self, raw: RawScan, name: &str, warnings: &mut Warnings) -> std::result::Result<Vec<Event>, String> {
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
            step.events.extend(self.followed(warnings));
        }
        self.note_motions(&step.events);
        match self.log.add(node, &step.report, cpu, warnings).map(|problem| format!("scan {name}: {problem}")) {
            Some(problem) if matches!(step.report.status, Status::First) => {
                warnings.add(Code::NewPiece, problem, "");
                Ok(step.events)
            }
            Some(problem) if step.events.is_empty() => Err(problem),
            Some(problem) => {
                warnings.add(Code::NotRegistered, problem, "");
                Ok(step.events)
            }
            None => Ok(step.events),
        }
    }

    /// The last scans of further sensors, after all scans have come.
    pub fn finish(&mut self, warnings: &mut Warnings) -> Vec<Event> {
        let events = self.followed(warnings);
        warn_without_pose(&self.slam.finish().without_pose, warnings);
        self.note_motions(&events);
        events
    }

    /// Events of scans of further sensors whose poses are known now.
    fn followed(&mut self, warnings: &mut Warnings) -> Vec<Event> {
        let Self { slam, selection, .. } = self;
        let followed = slam.followed(|sensor, pose, time| selection.takes(sensor, pose, time));
        warn_without_pose(&followed.without_pose, warnings);
        followed.events
    }

    /// Keeps how the lidars moved, for those who read the clouds again.
    fn note_motions(&self, events: &[Event]) {
        for event in events {
            if let Event::Scan(scan) = event
                && let Some(motion) = &scan.cloud.motion
            {
                self.motions.extend([(scan.node, motion.clone())]);
            }
        }
    }
}

/// Says which scans of further sensors have no pose.
fn warn_without_pose(nodes: &[NodeId], warnings: &mut Warnings) {
    if let Some(first) = nodes.first() {
        let text = format!("{} scans of further sensors have no pose, the first is node {first}", nodes.len());
        warnings.add(Code::NoPoseOfFurtherSensor, text, "those of the first sensor around their times are missing");
    }
}
