//! The registered cloud list (paper Sec. IV) as a stream of events: one path for live and replayed input.

use crate::{Cloud, Pose};
use serde::{Deserialize, Serialize};

/// Identifier of a pose-graph node, as the SLAM system numbers it.
pub type NodeId = u64;

/// What a SLAM system reports to the mapper, in the order in which it happens.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Event {
    /// A node and the scan taken there.
    Scan(Scan),
    /// Two consecutive nodes, with their measured relative pose.
    OdometryEdge(Edge),
    /// Two nodes that observed the same place, with their measured relative pose.
    LoopEdge(Edge),
    /// Corrected poses of nodes already seen.
    PoseUpdate(Vec<(NodeId, Pose)>),
    /// Where up is at a node, by an inertial unit: for the optimiser of the pose graph; the mapper does not use it.
    Vertical(Vertical),
}

/// A node of the pose graph with its cloud.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Scan {
    /// The node's identifier.
    pub node: NodeId,
    /// Time stamp in seconds.
    pub time: f64,
    /// Pose of the lidar frame in the map frame when the scan was taken.
    #[serde(with = "crate::geometry::stored")]
    pub t_map_lidar: Pose,
    /// The points, in the lidar frame.
    pub cloud: Cloud,
}

/// A constraint of the pose graph between two nodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Edge {
    /// Node the constraint is expressed in.
    pub from: NodeId,
    /// Node whose pose is measured.
    pub to: NodeId,
    /// Pose of `to` in the frame of `from`.
    #[serde(with = "crate::geometry::stored")]
    pub t_from_to: Pose,
    /// Information matrix, upper triangle row by row, order x y z roll pitch yaw (as in g2o); absent when unknown.
    pub information: Option<[f64; 21]>,
}

/// The direction against gravity at a node, measured by an inertial unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vertical {
    /// The node.
    pub node: NodeId,
    /// The direction in the lidar frame of the node, a unit vector.
    pub up_lidar: [f64; 3],
    /// The direction in the map frame, a unit vector.
    pub up_map: [f64; 3],
    /// Standard deviation of the measured one, radians.
    pub sigma: f64,
}
