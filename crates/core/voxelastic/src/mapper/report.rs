//! Reports about integrated scans, and counts over a run.

use crate::atlas::SubmapId;
use crate::event::NodeId;
use crate::integrate::{OccupancyStats, TsdfStats};
use crate::sensor::Counts;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How the submap of a scan was chosen (paper Sec. IV-A).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Assignment {
    /// The submap of its odometry predecessor: its root is near enough along the graph.
    Continue,
    /// Another submap whose root is near along the graph over closed loops.
    Revisit,
    /// A submap that contains nearly all of the scan.
    Overlap,
    /// A new submap with this scan as its root.
    NewSubmap,
}

/// Counts of submap assignments, fusions and corrections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ElasticCounts {
    /// Submaps started.
    pub submaps_started: usize,
    /// Scans assigned to an older submap over closed loops.
    pub revisits: usize,
    /// Scans assigned to an older submap by overlap.
    pub overlaps: usize,
    /// Submaps fused into others.
    pub fusions: usize,
    /// Fusions in progress or queued.
    pub fusions_due: usize,
    /// Groups of submaps whose fusion was refused by the size bound although a closed loop connects them. They are retried whenever a
    /// loop near them closes.
    pub size_limited_groups: usize,
    /// Submaps rebuilt from their scans.
    pub rebuilds: usize,
    /// Pose updates applied.
    pub pose_updates: usize,
    /// Poses of unknown nodes in these updates.
    pub unknown_poses: usize,
    /// Corrections of root poses.
    pub submap_moves: usize,
    /// Edges whose measurement replaced an earlier one.
    pub edges_replaced: usize,
    /// Finest voxels occupied by a single hit that conflict resolution freed.
    pub voxels_freed: usize,
    /// Points that were set aside because they are on something that moves.
    pub moving_points: usize,
    /// TSDF voxels removed because nothing is there before or after.
    pub voxels_removed: usize,
}

impl ElasticCounts {
    pub(super) fn count(&mut self, assignment: Assignment) {
        match assignment {
            Assignment::Continue => {}
            Assignment::Revisit => self.revisits += 1,
            Assignment::Overlap => self.overlaps += 1,
            Assignment::NewSubmap => self.submaps_started += 1,
        }
    }
}

/// Report about one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ScanReport {
    /// The scan's node.
    pub node: NodeId,
    /// The submap into which it was integrated.
    pub submap: SubmapId,
    /// Whether the scan started that submap.
    pub is_new_submap: bool,
    /// How that submap was chosen.
    pub assignment: Assignment,
    /// Number of usable points that were set aside because they are on something that moves; see [`Dynamic`](crate::settings::Dynamic).
    pub moving: usize,
    /// Number of points by what was done with them.
    pub counts: Counts,
    /// Wall time for the range image and the local planes.
    pub prepare: Duration,
    /// Wall time for the choice of the submap, clustering and this scan's share of a fusion in progress.
    pub elastic: Duration,
    /// Statistics of the TSDF, if the map has that field.
    pub tsdf: Option<TsdfStats>,
    /// Statistics of the occupancy field, if the map has that field.
    pub occupancy: Option<OccupancyStats>,
}
