//! Which node belongs to which submap.

use super::SubmapId;
use super::node_map::NodeMap;
use crate::event::NodeId;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};

/// The nodes of every submap as clustering decided; queued fusions count as done.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct NodeAssignments {
    submap_of: NodeMap<SubmapId>,
    nodes: BTreeMap<SubmapId, Vec<NodeId>>,
    /// By target and source of a fusion that was refused, a node of the source that was too far from the root of the target: as long as it is, no other
    /// needs to be looked at. Nothing depends on what is here but time.
    #[serde(skip)]
    out_of_reach: HashMap<(SubmapId, SubmapId), NodeId>,
}

impl NodeAssignments {
    /// The submap of `node`.
    pub fn submap_of(&self, node: NodeId) -> Option<SubmapId> {
        self.submap_of.get(&node).copied()
    }

    /// The node whose pose is the submap's root pose: the first one.
    pub fn root(&self, submap: SubmapId) -> Option<NodeId> {
        self.nodes.get(&submap).and_then(|n| n.first()).copied()
    }

    /// All nodes of a submap, its root first.
    pub fn nodes(&self, submap: SubmapId) -> &[NodeId] {
        self.nodes.get(&submap).map_or(&[], Vec::as_slice)
    }

    /// The submaps that have nodes, in ascending order.
    pub fn submaps(&self) -> impl Iterator<Item = SubmapId> {
        self.nodes.keys().copied()
    }

    /// Assigns `node` to `submap`; the first node of a submap is its root.
    pub fn add(&mut self, node: NodeId, submap: SubmapId) {
        if self.submap_of.insert(node, submap).is_none() {
            self.nodes.entry(submap).or_default().push(node);
        }
    }

    /// A node of `source` for which its fusion into `target` was refused last.
    pub(super) fn out_of_reach(&self, target: SubmapId, source: SubmapId) -> Option<NodeId> {
        self.out_of_reach.get(&(target, source)).copied()
    }

    /// Remembers a node of `source` for which its fusion into `target` was refused.
    pub(super) fn set_out_of_reach(&mut self, target: SubmapId, source: SubmapId, node: NodeId) {
        self.out_of_reach.insert((target, source), node);
    }

    /// Moves all nodes of `source` to `target`.
    pub fn merge(&mut self, source: SubmapId, target: SubmapId) {
        if source == target {
            return;
        }
        self.out_of_reach.retain(|(a, b), _| ![*a, *b].contains(&source));
        for node in self.nodes.remove(&source).unwrap_or_default() {
            self.submap_of.insert(node, target);
            self.nodes.entry(target).or_default().push(node);
        }
    }
}
