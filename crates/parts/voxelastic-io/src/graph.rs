//! The pose graph as files hold it: nodes with poses, and edges between them.

use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};

/// A pose graph: `g2o` reads and writes it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGraph {
    /// Nodes with their poses in the map frame, in the order of the file. Identifiers are unique.
    pub nodes: Vec<(NodeId, Pose)>,
    /// All edges, in the order of the file.
    pub edges: Vec<Edge>,
    /// Nodes that an optimiser must not move (`FIX`).
    pub fixed: Vec<NodeId>,
}

impl PoseGraph {
    /// Node identifiers in ascending order, which is the order in which SLAM systems create them.
    pub fn sorted_ids(&self) -> Vec<NodeId> {
        let mut ids: Vec<NodeId> = self.nodes.iter().map(|(id, _)| *id).collect();
        ids.sort_unstable();
        ids
    }

    /// Splits the edges into odometry edges and loop edges, in the order of the file.
    ///
    /// g2o does not say which is which. An edge between neighbours in the ascending order of identifiers, in either
    /// direction, is odometry; every other edge closes a loop.
    pub fn split_edges(&self) -> (Vec<&Edge>, Vec<&Edge>) {
        let ids = self.sorted_ids();
        self.edges.iter().partition(|e| {
            let (a, b) = (ids.binary_search(&e.from), ids.binary_search(&e.to));
            matches!((a, b), (Ok(a), Ok(b)) if a.abs_diff(b) == 1)
        })
    }
}
