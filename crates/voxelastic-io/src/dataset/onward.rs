//! Where scans go on from after a correction.
//!
//! The poses of a folder with snapshots, or of a recording with corrections beside it, may be those of odometry, which knows of no
//! correction: a scan that comes after one then lies at the corrected pose of the scan before it and the odometry from there. Or they may
//! be what the SLAM system said as it went, with all corrections up to then in them. Which of the two it is shows at the scan after a
//! correction: its pose fits the motion since the scan before either from what was told of that scan or from its corrected pose.

use voxelastic::Pose;
use voxelastic::geometry::PoseExt;

/// Metres that a turn by one radian counts like.
const RADIAN_M: f64 = 5.0;

/// Corrects the poses of scans that come after corrections.
#[derive(Debug)]
pub(crate) struct Onward {
    /// From poses that are told to corrected ones.
    shift: Pose,
    /// What the last correction made of the poses told, until the next scan shows whether they have it in them already.
    pending: Option<Pose>,
    /// How far off the motion after corrections was, in all, if odometry tells the poses, and if they have the corrections in them.
    misfits: [f64; 2],
}

impl Onward {
    pub(crate) fn new() -> Self {
        Self { shift: Pose::identity(), pending: None, misfits: [0.0; 2] }
    }

    /// Takes note of a correction: what was told of the last scan that it is about, and its pose now.
    pub(crate) fn corrected(&mut self, told: &Pose, now: &Pose) {
        self.pending = Some(now * told.inverse());
    }

    /// Pose of the next scan, of which `told` is told, and `last` of the scan before it; `motion` is the way between the two as far as it
    /// is known otherwise.
    pub(crate) fn pose(&mut self, told: &Pose, last: &Pose, motion: Option<&Pose>) -> Pose {
        if let Some(correction) = self.pending.take() {
            if let Some(motion) = motion {
                let misfit = |from: &Pose| {
                    let way = from.inv_mul(told);
                    way.translation_distance(motion) + RADIAN_M * way.rotation_distance(motion)
                };
                self.misfits[0] += misfit(last);
                self.misfits[1] += misfit(&(correction * last));
            }
            self.shift = if self.misfits[0] <= self.misfits[1] { correction } else { Pose::identity() };
        }
        if self.shift == Pose::identity() {
            return *told;
        }
        let mut pose = self.shift * told;
        // A product of unit quaternions is one to rounding only.
        pose.rotation.renormalize();
        pose
    }
}
