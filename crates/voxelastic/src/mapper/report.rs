//! What the mapper says about each event.

use crate::atlas::SubmapId;
use crate::event::NodeId;
use crate::integrate::{OccupancyStats, TsdfStats};
use crate::sensor::{Counts, SensorError};
use std::time::Duration;

/// What was done with a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanReport {
    /// The scan's node.
    pub node: NodeId,
    /// The submap that it was integrated into.
    pub submap: SubmapId,
    /// Whether that submap was started with this scan.
    pub is_new_submap: bool,
    /// What became of the scan's points.
    pub counts: Counts,
    /// Time for the range image and the local planes.
    pub prepare: Duration,
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
    /// The submap that the scan belongs to is not in the atlas any more.
    #[error("the scan of node {node} belongs to submap {submap}, which is not in the atlas")]
    LostSubmap {
        /// The node.
        node: NodeId,
        /// The missing submap.
        submap: SubmapId,
    },
}
