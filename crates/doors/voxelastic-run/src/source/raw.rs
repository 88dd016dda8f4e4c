//! Raw scans, whose poses the odometry finds while they are mapped.

use super::HoldOut;
use crate::Result;
use crate::poses::{Motions, OdometrySetup, OdometryStage};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;
use voxelastic::motion::Motion;
use voxelastic::sensor::BeamModel;
use voxelastic_io::bag::KEYFRAME_DISTANCE_M;
use voxelastic_io::raw::{RawScans, TimedScans};
use voxelastic_io::{Keyframing, OpenOptions, ReadPosition};

/// Raw scans, and which of them to map.
pub struct RawSource {
    scans: RawScans,
    setup: OdometrySetup,
    motions: Motions,
}

impl RawSource {
    /// Opens the scans; poses in the data are not used.
    ///
    /// # Errors
    /// When there are none, or they cannot be read.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self> {
        let scans = voxelastic_io::raw::open(path, options)?;
        let usual = if scans.is_recording() { Keyframing::Metres(KEYFRAME_DISTANCE_M) } else { Keyframing::All };
        let setup = OdometrySetup { t_first_sensor: scans.t_first_sensor().to_vec(), ..OdometrySetup::new(options, usual) };
        Ok(Self { scans, setup, motions: Motions::default() })
    }

    pub(super) fn description(&self) -> String {
        let of = if self.setup.t_first_sensor.is_empty() { "" } else { " of the first sensor, which the others follow" };
        format!("{}\nscans taken: {}\nposes: by odometry{of}", self.scans.description(), self.setup.keyframing)
    }

    pub(super) fn scans(&self) -> Option<usize> {
        self.scans.count().filter(|_| self.setup.keyframing == Keyframing::All).map(|n| n.min(self.setup.most))
    }

    pub(super) fn interval_s(&self) -> Option<f64> {
        self.scans.interval_s()
    }

    pub(super) fn undistorted_sign(&self) -> Option<String> {
        self.scans.undistorted_sign()
    }

    pub(super) fn longest_pause_s(&self) -> Option<f64> {
        self.scans.longest_pause_s()
    }

    pub(super) fn sensor(&self) -> Option<BeamModel> {
        self.scans.sensor()
    }

    pub(super) fn setup(&self) -> &OdometrySetup {
        &self.setup
    }

    pub(super) fn limit(&mut self, most: usize) {
        self.setup.most = most;
    }

    pub(super) fn remove_held_out(&mut self, hold_out: HoldOut) -> Arc<AtomicUsize> {
        let count = Arc::default();
        self.setup.hold_out = Some((hold_out, Arc::clone(&count)));
        count
    }

    pub(super) fn fingerprint(&self) -> u64 {
        self.scans.fingerprint()
    }

    pub(super) fn know_motions(&self, motions: impl IntoIterator<Item = (NodeId, Motion)>) {
        self.motions.extend(motions);
    }

    pub(super) fn iter(&self, from: Option<&ReadPosition>) -> TimedScans {
        from.map_or_else(|| self.scans.iter(), |from| self.scans.iter_from(from))
    }

    pub(super) fn stage(&self, threads: usize) -> Result<OdometryStage> {
        OdometryStage::new(self.setup.clone(), self.motions.clone(), threads)
    }

    pub(super) fn clouds(&self) -> Box<dyn ScanSource + Send> {
        Box::new(MovingClouds { clouds: self.scans.clouds(), motions: self.motions.clone() })
    }
}

/// Reads clouds again, with the motion that the odometry found.
struct MovingClouds {
    clouds: Box<dyn ScanSource + Send>,
    motions: Motions,
}

impl ScanSource for MovingClouds {
    fn cloud(&mut self, node: NodeId) -> std::result::Result<Cloud, Box<dyn Error + Send + Sync>> {
        let mut cloud = self.clouds.cloud(node)?;
        cloud.motion = cloud.motion.or_else(|| self.motions.of(node));
        Ok(cloud)
    }
}
