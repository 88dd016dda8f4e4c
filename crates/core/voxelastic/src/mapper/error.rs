//! Errors of the mapper.

use crate::atlas::SubmapId;
use crate::atlas::graph::EdgeError;
use crate::event::NodeId;
use crate::sensor::{Counts, SensorError};

/// Why an event was refused. The map is unchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// The node has a scan already.
    #[error("node {node} has a scan already; each node has one scan")]
    DuplicateNode {
        /// The node.
        node: NodeId,
    },
    /// The pose is not finite, or its quaternion does not have unit length.
    #[error("the pose of node {node} is not a rigid transform: a number is not finite or the quaternion is not of unit length")]
    BadPose {
        /// The node.
        node: NodeId,
    },
    /// The cloud has no usable point.
    #[error(
        "the scan of node {node} has no usable return: {} are no return, {} too near, {} beyond the maximum range, {} outside of the sensor's view",
        counts.no_return, counts.too_near, counts.beyond_max, counts.outside
    )]
    NoReturns {
        /// The node.
        node: NodeId,
        /// Number of points by why they were dropped.
        counts: Counts,
    },
    /// The sensor is unknown or could not be recognised.
    #[error("the sensor of the scan of node {node}: {reason}")]
    Sensor {
        /// The node of the scan.
        node: NodeId,
        /// The cause. It is part of the message, and therefore not a `source` of this error.
        reason: SensorError,
    },
    /// The edge is not valid.
    #[error(transparent)]
    Edge(#[from] EdgeError),
    /// The submap to which the scan is assigned is not in the atlas.
    #[error("the scan of node {node} is assigned to submap {submap}, which is not in the atlas")]
    LostSubmap {
        /// The node.
        node: NodeId,
        /// The missing submap.
        submap: SubmapId,
    },
}
