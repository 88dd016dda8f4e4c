//! Raw scans, whose poses the odometry finds while they are mapped.

use crate::data::{DataArgs, HoldOut};
use crate::meshing;
use crate::odometry_log::{OdometryLog, OdometrySummary};
use crate::usage::PoolClock;
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
use voxelastic_io::{KeyframeFilter, Keyframing};
use voxelastic_slam::odometry::OdometrySettings;
use voxelastic_slam::slam::{RawScan, Slam};

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
        let pool = meshing::pool(threads)?;
        let clock = PoolClock::new(&pool);
        Ok(RawEvents {
            scans: self.scans.iter(),
            slam: Slam::new(self.settings.clone()),
            pool,
            clock,
            keyframes: KeyframeFilter::new(self.keyframing),
            hold_out: self.hold_out.clone(),
            selected: 0,
            left: self.most,
            motions: Arc::clone(&self.motions),
            log: OdometryLog::default(),
            ready: VecDeque::new(),
        })
    }

    pub(super) fn clouds(&self) -> Box<dyn ScanSource + Send> {
        Box::new(MovingClouds { clouds: self.scans.clouds(), motions: Arc::clone(&self.motions) })
    }
}

/// Iterator over the events of raw scans. Scans are registered when they are asked for, in a thread pool of their own.
pub struct RawEvents {
    scans: TimedScans,
    slam: Slam,
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
    ready: VecDeque<Event>,
}

impl RawEvents {
    pub(super) fn idle_step(&mut self) -> impl Fn() -> bool + Send + Sync + use<> {
        self.scans.idle_step()
    }

    pub(super) fn summary(&self) -> OdometrySummary {
        self.log.summary()
    }

    /// Registers a scan, and makes its events ready.
    fn take(&mut self, scan: TimedScan) -> Option<anyhow::Error> {
        let Self { slam, keyframes, hold_out, selected, .. } = self;
        let time = scan.time;
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
        let raw = RawScan { node: scan.node, time, cloud: scan.cloud };
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
        self.ready.extend(step.events);
        let problem = self.log.add(&step.report, cpu)?;
        let problem = format!("scan {}: {problem}", scan.name);
        if self.ready.is_empty() {
            return Some(anyhow::Error::msg(problem));
        }
        tracing::warn!("{problem}");
        None
    }
}

impl Iterator for RawEvents {
    type Item = anyhow::Result<Event>;

    fn next(&mut self) -> Option<anyhow::Result<Event>> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(Ok(event));
            }
            if self.left == 0 {
                return None;
            }
            match self.scans.next()? {
                Ok(scan) => {
                    if let Some(problem) = self.take(scan) {
                        return Some(Err(problem));
                    }
                }
                Err(problem) => return Some(Err(problem.into())),
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
