//! Where scans go on from after a correction.
//!
//! The pose file of a folder with snapshots may be that of odometry, which knows of no correction: a scan that comes after one then lies at
//! the corrected pose of the scan before it and the odometry from there. Or it may hold what the SLAM system said as it went, with all
//! corrections up to then in it. Which of the two it is shows at the scan after a snapshot: its pose fits the motion since the scan before
//! either from that scan's pose in the file or from its corrected one.

use super::ScanEntry;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseExt;

/// Metres that a turn by one radian counts like.
const RADIAN_M: f64 = 5.0;

/// Corrects the poses of scans that come after corrections.
#[derive(Debug)]
pub(super) struct Onward {
    /// From poses of the file to corrected ones.
    shift: Pose,
    /// What the last correction made of the file's poses, until the next scan shows whether the file has it already.
    pending: Option<Pose>,
    /// How far off the motion after corrections was, in all, if the file is that of odometry, and if it has the corrections in it.
    misfits: [f64; 2],
}

impl Onward {
    pub(super) fn new() -> Self {
        Self { shift: Pose::identity(), pending: None, misfits: [0.0; 2] }
    }

    /// Takes note of corrected poses; `seen` are the scans so far, of which the last one that is corrected counts.
    pub(super) fn corrected(&mut self, poses: &[(NodeId, Pose)], seen: &[ScanEntry]) {
        let find = |scan: &ScanEntry| poses.iter().rev().find(|(node, _)| *node == scan.node).map(|(_, pose)| pose * scan.t_map_lidar.inverse());
        self.pending = seen.iter().rev().find_map(find).or(self.pending);
    }

    /// Pose of the next scan, of which the file says `told`. `last` is what the file says of the scan before it, `motion` the way between
    /// the two as far as it is known otherwise.
    pub(super) fn pose(&mut self, told: &Pose, last: &Pose, motion: Option<&Pose>) -> Pose {
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
