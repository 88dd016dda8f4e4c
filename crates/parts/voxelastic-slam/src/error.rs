//! The error of this crate.

use voxelastic::event::NodeId;

/// Why a pose graph was not optimised.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SlamError {
    /// A node comes twice.
    #[error("node {node} comes twice; remove one of the two")]
    DuplicateNode {
        /// The node.
        node: NodeId,
    },
    /// An edge, or the list of fixed nodes, names a node that is not there.
    #[error("node {node} is named, but not there; add it with a pose or remove what names it")]
    UnknownNode {
        /// The node.
        node: NodeId,
    },
    /// An edge from a node to itself.
    #[error("an edge leads from node {node} to itself; remove it")]
    SelfEdge {
        /// The node.
        node: NodeId,
    },
    /// A pose that is no rigid transform.
    #[error("the pose of node {node} is not a rigid transform")]
    BadPose {
        /// The node.
        node: NodeId,
    },
    /// An edge whose transform is not rigid, or whose information is not that of any measurement.
    #[error("the edge from node {from} to node {to} cannot be used: {reason}")]
    BadEdge {
        /// Its first node.
        from: NodeId,
        /// Its second node.
        to: NodeId,
        /// What is wrong.
        reason: &'static str,
    },
    /// A vertical that is no direction, or has no standard deviation.
    #[error("the vertical at node {node} is no measurement: directions must not be zero, and the standard deviation must be positive")]
    BadVertical {
        /// The node.
        node: NodeId,
    },
    /// A position that is no measurement.
    #[error("the position at node {node} is no measurement: its numbers must be finite, and its covariance positive definite")]
    BadPosition {
        /// The node.
        node: NodeId,
    },
    /// More nodes than the solver can number.
    #[error("{nodes} nodes are more than the solver can number")]
    TooMany {
        /// How many there are.
        nodes: usize,
    },
    /// The solver gave up.
    #[error("the graph could not be solved: {reason}; look for edges that contradict each other or information that spans many orders of magnitude")]
    Failed {
        /// What it said.
        reason: String,
    },
}
