//! Pose graph, assignment of nodes to submaps, and the fusions that closed loops lead to (paper Sec. IV-A).

use super::error::MapError;
use crate::atlas::cluster::{ClusterRule, Clustered, Fusion};
use crate::atlas::graph::{Agreement, EdgeOutcome, LinkKind, PoseGraph};
use crate::atlas::{NodeAssignments, NodeSet, SubmapId};
use crate::event::{Edge, NodeId};
use crate::settings::{Laps, Settings};
use std::collections::BTreeMap;

/// The pose graph and the clusters of its nodes.
#[derive(Debug)]
pub(super) struct Clusters {
    pub rule: ClusterRule,
    pub graph: PoseGraph,
    pub assignments: NodeAssignments,
    /// Groups of submaps whose fusion the size bound refused, each with the ends of a closed loop that connects them.
    pub size_limited: BTreeMap<Vec<SubmapId>, [NodeId; 2]>,
    /// Whether submaps are never fused.
    keep_apart: bool,
}

impl Clusters {
    /// An empty graph.
    pub fn new(settings: &Settings) -> Self {
        let distance = settings.loop_tolerance * f64::from(settings.voxel_size);
        let agreement = Agreement { distance, angle: settings.loop_angle_tolerance.to_radians() };
        let rule = ClusterRule { lambda_odom: settings.lambda_odom, lambda_cluster: settings.lambda_cluster };
        Self {
            rule,
            graph: PoseGraph::new(agreement).with_passes(rule.passes()),
            assignments: NodeAssignments::default(),
            size_limited: BTreeMap::new(),
            keep_apart: settings.laps == Laps::Apart,
        }
    }

    /// Adds an edge; returns whether it replaced an earlier one.
    pub fn add_edge(&mut self, kind: LinkKind, edge: &Edge) -> Result<bool, MapError> {
        Ok(self.graph.add_edge(kind, edge)? == EdgeOutcome::Replaced)
    }

    /// The fusions due to loops that closed since the last call (Sec. IV-A, IV-C), and those near them that the size bound refused
    /// earlier.
    pub fn fusions(&mut self) -> Vec<Fusion> {
        let closed = self.graph.take_closed();
        if closed.is_empty() || self.keep_apart {
            return Vec::new();
        }
        let near = if self.size_limited.is_empty() { Vec::new() } else { self.graph.within(closed.as_flattened(), self.rule.influence()) };
        let near: NodeSet = near.into_iter().map(|(node, _)| node).collect();
        let mut loops: Vec<[NodeId; 2]> = self.size_limited.extract_if(.., |_, ends| near.contains(&ends[0])).map(|(_, ends)| ends).collect();
        loops.extend(closed);
        let mut due = Vec::new();
        for ends in loops {
            let Clustered { fusions, remaining } = self.rule.cluster(&self.graph, &mut self.assignments, ends);
            due.extend(fusions);
            if remaining.len() > 1 {
                self.size_limited.insert(remaining, ends);
            }
        }
        due
    }

    /// Number of groups of submaps whose fusion the size bound refused.
    pub fn size_limited_groups(&self) -> usize {
        self.size_limited.len()
    }
}
