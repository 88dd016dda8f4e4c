//! A mapper with what comes before it: odometry for scans without poses, loop closures and corrections.

use voxelastic::Pose;
use voxelastic::event::{Event, Scan};
use voxelastic::mapper::ScanReport;
use voxelastic_io::{KeyframeFilter, Keyframing};
use voxelastic_slam::Corrector;
use voxelastic_slam::graph::{LiveOptimiser, Options};
use voxelastic_slam::loops::{LoopFinder, LoopSettings};
use voxelastic_slam::odometry::{OdometrySettings, Status};
use voxelastic_slam::slam::{RawScan, Slam};

/// What is looked for beside mapping.
#[derive(Clone, Copy, Debug)]
pub struct Corrections {
    /// Whether loop closures are found from the scans; none: only in scans without poses.
    pub loops: Option<bool>,
    /// Whether the pose graph is optimised after loop edges, also after those that are given.
    pub optimise: bool,
}

/// A scan that was integrated, and the lidar frame in the map frame at that time.
pub type Integrated = (ScanReport, Pose);

/// A mapper, and what finds poses and corrections.
pub struct Session {
    /// The mapper.
    pub mapper: voxelastic::Mapper,
    corrections: Corrections,
    corrector: Corrector,
    stage: Stage,
}

/// Where the poses of scans come from.
enum Stage {
    /// There was no scan yet.
    Empty,
    /// They are given.
    Given,
    /// They are estimated.
    Estimated(Box<(Slam, KeyframeFilter)>),
}

impl Session {
    /// A session with an empty map.
    pub fn new(mapper: voxelastic::Mapper, corrections: Corrections) -> Self {
        Self { mapper, corrections, corrector: Corrector::default(), stage: Stage::Empty }
    }

    /// Takes an event. A scan is reported.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn handle(&mut self, event: Event) -> Result<Option<Integrated>, String> {
        match self.stage {
            Stage::Empty => self.begin(Stage::Given),
            Stage::Given => {}
            Stage::Estimated(_) if matches!(event, Event::Scan(_)) => return Err(mixed("without poses", "has one")),
            Stage::Estimated(_) => {}
        }
        self.corrected(event)
    }

    /// Takes a scan without pose. It is reported, unless it is not the turn of one by `keyframing`, which is that of the first scan.
    ///
    /// # Errors
    /// Why it is refused: with those of the mapper, it fits nowhere.
    pub fn handle_raw(&mut self, scan: RawScan, keyframing: Keyframing) -> Result<Option<Integrated>, String> {
        if let Stage::Empty = self.stage {
            self.begin(Stage::Estimated(Box::new((Slam::new(OdometrySettings::default()), KeyframeFilter::new(keyframing)))));
        }
        let Stage::Estimated(estimation) = &mut self.stage else { return Err(mixed("with poses", "has none")) };
        let (slam, keyframes) = &mut **estimation;
        let time = scan.time;
        let step = slam.register(scan, |pose| keyframes.takes(pose, time));
        if let Status::Failed(failure) = step.report.status {
            return Err(format!("the scan has no pose: {failure}"));
        }
        let mut integrated = None;
        for event in step.events {
            integrated = self.corrected(event)?.or(integrated);
        }
        Ok(integrated)
    }

    /// The last corrections, then the completion of the map.
    ///
    /// # Errors
    /// Why the poses could not be corrected. The map is complete but for that.
    pub fn finish(&mut self) -> Result<(), String> {
        let last = self.corrector.finish().map_err(|e| e.to_string());
        let taken = last.and_then(|events| events.into_iter().try_for_each(|event| self.take(event).map(drop)));
        self.mapper.finish();
        taken
    }

    fn begin(&mut self, stage: Stage) {
        let is_raw = matches!(stage, Stage::Estimated(_));
        let finds_loops = self.corrections.loops.unwrap_or(is_raw);
        if self.corrections.optimise || finds_loops {
            let optimiser = LiveOptimiser::new(Options::default());
            self.corrector = Corrector::default().with_optimiser(if is_raw { optimiser.with_pieces() } else { optimiser });
        }
        if finds_loops {
            self.corrector = std::mem::take(&mut self.corrector).with_finder(LoopFinder::new(LoopSettings::default()));
        }
        self.stage = stage;
    }

    fn corrected(&mut self, event: Event) -> Result<Option<Integrated>, String> {
        let mut integrated = None;
        for event in self.corrector.take(event).map_err(|e| e.to_string())? {
            integrated = self.take(event)?.or(integrated);
        }
        Ok(integrated)
    }

    fn take(&mut self, event: Event) -> Result<Option<Integrated>, String> {
        let pose = if let Event::Scan(Scan { t_map_lidar, .. }) = &event { *t_map_lidar } else { Pose::identity() };
        let report = self.mapper.handle(event).map_err(|e| e.to_string())?;
        Ok(report.map(|report| (report, pose)))
    }
}

fn mixed(so_far: &str, this: &str) -> String {
    format!("the scans so far came {so_far}, and this one {this}: their frames may differ; use one mapper for each")
}
