//! Pose corrections (paper Sec. IV-D): root poses follow the graph, and nothing else moves.

use super::{MapError, Mapper};
use crate::atlas::SubmapId;
use crate::event::NodeId;
use crate::geometry::{Pose, PoseExt};

/// How far a submap's scans, where they were integrated, are from where the current poses put them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deformation {
    /// The submap.
    pub submap: SubmapId,
    /// Largest displacement of a scan against the root, metres.
    pub distance: f64,
    /// Largest turn of a scan against the root, radians.
    pub angle: f64,
}

impl Mapper {
    /// Takes corrected poses of nodes. Nodes never seen are counted and left alone.
    pub(super) fn update_poses(&mut self, poses: &[(NodeId, Pose)]) -> Result<(), MapError> {
        if let Some((node, _)) = poses.iter().find(|(_, pose)| !crate::atlas::graph::is_rigid(pose)) {
            return Err(MapError::BadPose { node: *node });
        }
        self.counts.pose_updates += 1;
        self.counts.unknown_poses += self.graph.update_poses(poses);
        self.graph.refresh_loops();
        self.move_submaps();
        self.cluster();
        Ok(())
    }

    /// Moves the submaps whose root was corrected by more than the thresholds.
    fn move_submaps(&mut self) {
        let (distance, angle) = (self.settings.update_distance, self.settings.update_angle.to_radians());
        for submap in self.atlas.submaps_mut() {
            let Some(pose) = submap.root_node().and_then(|root| self.graph.pose(root)) else { continue };
            let is_moved = pose.translation_distance(&submap.t_map_submap) > distance || pose.rotation_distance(&submap.t_map_submap) > angle;
            if is_moved {
                submap.t_map_submap = *pose;
                self.counts.submap_moves += 1;
            }
        }
    }

    /// Every submap's deformation under the current poses, by submap.
    pub fn deformations(&self) -> Vec<Deformation> {
        let of_submap = |submap: &crate::atlas::Submap| {
            let root = self.graph.pose(submap.root_node()?)?;
            let mut worst = Deformation { submap: submap.id, distance: 0.0, angle: 0.0 };
            for scan in &submap.scans {
                let Some(pose) = self.graph.pose(scan.node) else { continue };
                let now = root.inv_mul(pose);
                worst.distance = worst.distance.max(now.translation_distance(&scan.t_submap_lidar));
                worst.angle = worst.angle.max(now.rotation_distance(&scan.t_submap_lidar));
            }
            Some(worst)
        };
        self.atlas.submaps().iter().filter_map(of_submap).collect()
    }

    /// Submaps that corrections bent inside by more than `deform_tolerance` or `update_angle`: rigid as they are, they cannot follow.
    pub fn deformed(&self) -> Vec<Deformation> {
        let distance = self.settings.deform_tolerance * f64::from(self.settings.voxel);
        let angle = self.settings.update_angle.to_radians();
        self.deformations().into_iter().filter(|d| d.distance > distance || d.angle > angle).collect()
    }
}
