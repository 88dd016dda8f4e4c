//! Errors of the poses of a map.

use super::truth::Truth;
use anyhow::Context;
use serde::Serialize;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::NodeId;
use voxelastic_eval::trajectory::{Ate, Delta, Fit, Rpe, ate, by_id, rpe};

/// Path length for relative errors, metres.
const STEP_M: f64 = 10.0;

/// Errors of poses.
#[derive(Debug, Serialize)]
pub struct TrajectoryErrors {
    /// Absolute, after the best rigid alignment.
    pub ate: Ate,
    /// Absolute without alignment, if map and truth have one frame: for a simulated world.
    pub ate_in_place: Option<Ate>,
    /// Relative, over 10 m of path; `null` for a shorter path.
    pub rpe: Option<Rpe>,
}

/// Compares the poses of the scans in a map with the true ones, node by node. None if fewer than three scans have a true pose.
pub fn compare(atlas: &Atlas, truth: &Truth) -> anyhow::Result<Option<TrajectoryErrors>> {
    if truth.poses.is_empty() {
        return Ok(None);
    }
    let pairs = by_id(&truth.poses, &poses(atlas));
    if pairs.len() < 3 {
        tracing::warn!("only {} scans of the map have a true pose: the trajectory is not evaluated", pairs.len());
        return Ok(None);
    }
    let in_place = truth.simulation.is_some().then(|| ate(&pairs, Fit::None)).transpose();
    Ok(Some(TrajectoryErrors {
        ate: ate(&pairs, Fit::Rigid).context("cannot compare the trajectories")?,
        ate_in_place: in_place.context("cannot compare the trajectories")?,
        rpe: rpe(&pairs, Delta::Metres(STEP_M)).ok(),
    }))
}

/// Poses of the lidar in the map frame, by node.
fn poses(atlas: &Atlas) -> Vec<(NodeId, Pose)> {
    let of_submap = |s: &voxelastic::atlas::Submap| {
        let t_map_submap = s.t_map_submap();
        s.scans().iter().map(move |scan| (scan.node, t_map_submap * scan.t_submap_lidar)).collect::<Vec<_>>()
    };
    let mut poses: Vec<(NodeId, Pose)> = atlas.submaps().iter().flat_map(of_submap).collect();
    poses.sort_by_key(|(node, _)| *node);
    poses
}
