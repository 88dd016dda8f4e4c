//! Poses of scans after a correction.
//!
//! Where a folder has snapshots, or a recording has corrections, there are two cases for the poses of later scans. If they are raw odometry,
//! which knows nothing of corrections, a scan's pose is the corrected pose of the previous scan composed with the odometry since then. If they
//! are the SLAM system's live estimates, they contain all corrections made so far and are used as they are. The first scan after a correction
//! decides: its pose agrees with the motion since the previous scan either from that scan's reported pose (odometry) or from its corrected
//! pose (live estimates).

use serde::{Deserialize, Serialize};
use voxelastic::Pose;
use voxelastic::geometry::PoseExt;
use voxelastic::geometry::stored::StoredPose;

/// Weight of a rotation in the misfit: a radian counts as this many metres.
const RADIAN_M: f64 = 5.0;

/// Carries corrections over to the poses of later scans.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Continuation {
    /// From reported poses to corrected ones.
    #[serde(with = "voxelastic::geometry::stored")]
    correction: Pose,
    /// The last correction, until the next scan shows whether reported poses contain it.
    pending: Option<StoredPose>,
    /// Total deviation from the expected motion at corrections: if reported poses are odometry, and if they contain the corrections.
    misfits: [f64; 2],
}

impl Default for Continuation {
    fn default() -> Self {
        Self::new()
    }
}

impl Continuation {
    pub(crate) fn new() -> Self {
        Self { correction: Pose::identity(), pending: None, misfits: [0.0; 2] }
    }

    /// Notes a correction by its last scan: the pose reported for it and its corrected pose.
    pub(crate) fn corrected(&mut self, reported: &Pose, corrected: &Pose) {
        self.pending = Some(StoredPose(corrected * reported.inverse()));
    }

    /// Pose of the next scan, from its reported pose and that of the previous scan. `motion` is an independent estimate of the motion
    /// between the two, if there is one.
    pub(crate) fn pose(&mut self, reported: &Pose, previous: &Pose, motion: Option<&Pose>) -> Pose {
        if let Some(StoredPose(correction)) = self.pending.take() {
            if let Some(motion) = motion {
                let misfit = |from: &Pose| {
                    let reported_motion = from.inv_mul(reported);
                    reported_motion.translation_distance(motion) + RADIAN_M * reported_motion.rotation_distance(motion)
                };
                self.misfits[0] += misfit(previous);
                self.misfits[1] += misfit(&(correction * previous));
            }
            self.correction = if self.misfits[0] <= self.misfits[1] { correction } else { Pose::identity() };
        }
        if self.correction == Pose::identity() {
            return *reported;
        }
        let mut pose = self.correction * reported;
        // The product of unit quaternions is a unit quaternion up to rounding only.
        pose.rotation.renormalize();
        pose
    }
}
