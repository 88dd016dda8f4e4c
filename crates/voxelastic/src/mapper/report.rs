//! What the mapper says about each event.

use crate::atlas::SubmapId;
use crate::atlas::graph::EdgeError;
use crate::event::NodeId;
use crate::integrate::{OccupancyStats, TsdfStats};
use crate::sensor::{Counts, SensorError};
use std::time::Duration;

/// Why a scan went into the submap that it went into (paper Sec. IV-A).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placed {
    /// The submap of its odometry predecessor, whose root is near enough along the graph.
    Onward,
    /// Another submap whose root is near along the graph, over loops that are closed.
    Revisit,
    /// A submap that knows nearly all of it already.
    Overlap,
    /// A submap that begins with it.
    NewSubmap,
}

/// What the elastic part did so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ElasticCounts {
    /// Submaps started.
    pub submaps_started: usize,
    /// Scans that went into an older submap over closed loops.
    pub revisits: usize,
    /// Scans that went into an older submap because it knew them already.
    pub overlaps: usize,
    /// Submaps fused into others.
    pub fusions: usize,
    /// Fusions under way or waiting.
    pub fusions_due: usize,
    /// Groups of submaps that closed loops join and that stay apart, because together they would be larger than the bound. They are tried
    /// again whenever a loop near them closes.
    pub groups_apart: usize,
    /// Submaps rebuilt from their scans.
    pub rebuilds: usize,
    /// Pose updates taken.
    pub pose_updates: usize,
    /// Poses in them that were of nodes never seen.
    pub unknown_poses: usize,
    /// Root poses that were corrected.
    pub submap_moves: usize,
    /// Edges whose measurement replaced an earlier one.
    pub edges_replaced: usize,
    /// Finest voxels that a single scan had called occupied and other submaps knew to be free.
    pub voxels_freed: usize,
}

impl ElasticCounts {
    pub(super) fn note(&mut self, placed: Placed) {
        match placed {
            Placed::Onward => {}
            Placed::Revisit => self.revisits += 1,
            Placed::Overlap => self.overlaps += 1,
            Placed::NewSubmap => self.submaps_started += 1,
        }
    }
}

/// What was done with a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanReport {
    /// The scan's node.
    pub node: NodeId,
    /// The submap that it was integrated into.
    pub submap: SubmapId,
    /// Whether that submap was started with this scan.
    pub is_new_submap: bool,
    /// Why it was that submap.
    pub placed: Placed,
    /// What became of the scan's points.
    pub counts: Counts,
    /// Time for the range image and the local planes.
    pub prepare: Duration,
    /// Time for the elastic part: the choice of the submap, clustering, and this scan's share of a fusion under way.
    pub elastic: Duration,
    /// The TSDF's part, if the map has that field.
    pub tsdf: Option<TsdfStats>,
    /// The occupancy's part, if the map has that field.
    pub occupancy: Option<OccupancyStats>,
}

/// Why an event was refused. The map is as it was before.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// The node has a scan already.
    #[error("node {node} comes twice; each node has one scan")]
    DuplicateNode {
        /// The node.
        node: NodeId,
    },
    /// The pose has a number that is not finite, or its quaternion is not of unit length.
    #[error("the pose of node {node} is not a rigid transform: a number is not finite or the quaternion is not of unit length")]
    BadPose {
        /// The node.
        node: NodeId,
    },
    /// No point of the cloud can be used.
    #[error(
        "the scan of node {node} has no usable return: {} are no return, {} too near, {} beyond the maximum range, {} outside of the sensor's view",
        counts.no_return, counts.too_near, counts.beyond_max, counts.outside
    )]
    NoReturns {
        /// The node.
        node: NodeId,
        /// What became of its points.
        counts: Counts,
    },
    /// The sensor could not be recognised, or its name is unknown.
    #[error("node {node}: {source}")]
    Sensor {
        /// The node whose scan was looked at.
        node: NodeId,
        /// What is wrong.
        source: SensorError,
    },
    /// The edge cannot be part of a pose graph.
    #[error(transparent)]
    Edge(#[from] EdgeError),
    /// The submap that the scan belongs to is not in the atlas any more.
    #[error("the scan of node {node} belongs to submap {submap}, which is not in the atlas")]
    LostSubmap {
        /// The node.
        node: NodeId,
        /// The missing submap.
        submap: SubmapId,
    },
}
