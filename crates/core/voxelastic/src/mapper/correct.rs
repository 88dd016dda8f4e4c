//! Pose corrections (paper Sec. IV-D): root poses follow the graph, and nothing else moves. Where scans are inside of submaps is noted, for surfaces.

use crate::atlas::graph::PoseGraph;
use crate::atlas::{Atlas, Submap, SubmapId, SubmapScan};
use crate::geometry::{Pose, PoseExt};

/// Largest difference between the poses at which a submap's scans were integrated and their current poses, both relative to the root.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Deformation {
    /// The submap.
    pub submap: SubmapId,
    /// Largest displacement of a scan relative to the root, metres.
    pub distance: f64,
    /// Largest rotation of a scan relative to the root, radians.
    pub angle: f64,
}

/// Sets the pose of each submap whose root node moved by more than `distance` metres or `angle` radians; returns their number.
pub(super) fn move_submaps(atlas: &mut Atlas, graph: &PoseGraph, distance: f64, angle: f64) -> usize {
    let mut moved = 0;
    for submap in atlas.submaps_mut() {
        let Some(pose) = submap.root_node().and_then(|root| graph.pose(root)) else { continue };
        if pose.translation_distance(&submap.t_map_submap) > distance || pose.rotation_distance(&submap.t_map_submap) > angle {
            submap.t_map_submap = *pose;
            moved += 1;
        }
    }
    moved
}

/// Turning a scan matters at this distance, metres.
const FAR: f64 = 10.0;

/// Tells each submap where its scans are now, if one of them moved by more than a quarter of a voxel since it was told.
pub(super) fn correct_scans(atlas: &mut Atlas, graph: &PoseGraph) {
    let tolerance = 0.25 * f64::from(atlas.voxel_size());
    for submap in atlas.submaps_mut() {
        let now = |scan: &SubmapScan| graph.pose(scan.node).map_or(scan.t_submap_lidar, |pose| submap.t_map_submap.inv_mul(pose));
        let corrected: Vec<Pose> = submap.scans.iter().map(now).collect();
        let has_moved = corrected.iter().zip(&submap.scans).enumerate().any(|(n, (pose, scan))| {
            let known = submap.corrected.get(n).unwrap_or(&scan.t_submap_lidar);
            pose.translation_distance(known) > tolerance || pose.rotation_distance(known) * FAR > tolerance
        });
        if has_moved {
            submap.corrected = corrected;
        }
    }
}

/// Every submap's deformation under the current poses, by submap.
pub(super) fn deformations(atlas: &Atlas, graph: &PoseGraph) -> Vec<Deformation> {
    let of_submap = |submap: &Submap| {
        let root = graph.pose(submap.root_node()?)?;
        let mut largest = Deformation { submap: submap.id, distance: 0.0, angle: 0.0 };
        for scan in &submap.scans {
            let Some(pose) = graph.pose(scan.node) else { continue };
            let t_submap_lidar = root.inv_mul(pose);
            largest.distance = largest.distance.max(t_submap_lidar.translation_distance(&scan.t_submap_lidar));
            largest.angle = largest.angle.max(t_submap_lidar.rotation_distance(&scan.t_submap_lidar));
        }
        Some(largest)
    };
    atlas.submaps().iter().filter_map(of_submap).collect()
}
