//! Registration of one place to another, and what it must look like to be believed.

use super::align::{align, settings};
use super::overlap::Guess;
use super::place::{Place, free_voxel, levels, surfels};
use crate::free_space::contradiction;
use crate::graph::{adjoint, upper_triangle};
use crate::registration::{Registration, register};
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};
use voxelastic::event::NodeId;
use voxelastic::geometry::{Pose, PoseExt};

/// Scans on either side of the nearest pair that are registered once more: so few that the odometry within them hardly counts.
const AROUND: usize = 2;
/// The second registration may move the first one by so many voxels.
const MOST_REFINEMENT: f64 = 3.0;

/// How well a place fits on another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Node of the first place that is nearest to a node of the second, and that node.
    pub nodes: (NodeId, NodeId),
    /// Pose of the second of these nodes in the frame of the first.
    #[serde(with = "voxelastic::geometry::stored")]
    pub t_first_second: Pose,
    /// Share of the second place's surfaces that have one of the first within reach.
    pub overlap: f64,
    /// Mean weight of the surfaces, 1 where all lie on each other.
    pub score: f64,
    /// Robust mean distance of the surfaces, metres.
    pub spread: f64,
    /// Directions along which the surfaces hold nothing.
    pub degenerate: usize,
    /// Share of the surfaces of one place that lie in space that the other saw to be free: the larger of the two ways. `None` if that was not
    /// looked at, or if too little of the one is where the other saw anything.
    pub contradiction: Option<f64>,
    /// Information of the pose by its registration, in the frame of the second node (x y z roll pitch yaw; upper triangle row by row), inverse square
    /// metres and radians.
    pub information: Option<[f64; 21]>,
}

/// Registers `second` to `first` from a guess: as wholes, then the scans around the two nodes that are nearest to each other.
///
/// The free space is compared only if the surfaces fit as `least` says: overlap and score.
pub(crate) fn fit(first: &Place, second: &Place, guess: &Guess, voxel: f64, least: (f64, f64)) -> Option<Fit> {
    let whole = align(first, &surfels(&second.scans, voxel), guess, voxel)?;
    let Registration { t_map_lidar: t, overlap, score, spread, .. } = whole;
    let (i, j) = nearest_scans(first, second, &t)?;
    let unrefined = Fit {
        nodes: (first.scans[i].node, second.scans[j].node),
        t_first_second: t,
        overlap,
        score,
        spread,
        degenerate: whole.degenerate.len(),
        contradiction: None,
        information: None,
    };
    if overlap < least.0 || score < least.1 {
        return Some(unrefined);
    }
    let (points, map) = (surfels(second.scans_around(j, AROUND), voxel), levels(first.scans_around(i, AROUND), voxel));
    let near = register(&points, &t, &map, 0.5 * voxel, &settings(voxel))?;
    if near.t_map_lidar.translation_distance(&t) > MOST_REFINEMENT * voxel {
        return None;
    }
    let (a, b) = (&first.scans[i], &second.scans[j]);
    Some(Fit {
        t_first_second: a.t_anchor_lidar.inv_mul(&(near.t_map_lidar * b.t_anchor_lidar)),
        degenerate: near.degenerate.len(),
        contradiction: contradiction(&first.views(), &second.views(), &t, free_voxel(voxel)),
        information: Some(upper_triangle(&moved(&near.information(&points, &map), &b.t_anchor_lidar))),
        ..unrefined
    })
}

/// Information of a pose, for another frame on the same body that has this pose in the first.
fn moved(information: &Matrix6<f64>, t_first_second: &Pose) -> Matrix6<f64> {
    let adjoint = adjoint(t_first_second);
    adjoint.transpose() * information * adjoint
}

/// The scan of each place that is nearest to one of the other.
fn nearest_scans(first: &Place, second: &Place, t_first_second: &Pose) -> Option<(usize, usize)> {
    let there: Vec<Pose> = second.scans.iter().map(|scan| t_first_second * scan.t_anchor_lidar).collect();
    let pairs = first
        .scans
        .iter()
        .enumerate()
        .flat_map(|(i, a)| there.iter().enumerate().map(move |(j, b)| (a.t_anchor_lidar.translation_distance(b), i, j)));
    pairs.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i, j)| (i, j))
}
