//! The pose graph as far as mapping needs it (paper Sec. IV): nodes with current poses, links with lengths, distances along links.
//!
//! The paper measures "the distance travelled along the pose graph" because drift grows with it. Along the odometry chain that is the
//! path length. Where a loop closure connects two ends of a long path, their relative pose is as accurate as the shortest connection
//! between them, so distances here are shortest paths over odometry *and* closed loops. This matters in two places: a revisit is near the
//! root of the submap that it revisits, and a cluster extends over the loop edge from one traversal to the other.
//!
//! A loop edge is used only while it is *closed*, that is, while the current poses of its nodes agree with its measurement. Before the
//! SLAM system has corrected the poses the edge is open; an outlier that the robust kernel rejects stays open. Fusing along an open edge
//! would merge surfaces that are not the same.
//!
//! Where a place was passed often, the links of some passes [stand for those of the others](super::passes).

use super::node_map::{NodeMap, NodeSet};
use super::passes::{PassRule, Passes};
use crate::event::{Edge, NodeId};
use crate::geometry::stored::StoredPose;
use crate::geometry::{Pose, PoseExt};
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// Origin of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LinkKind {
    /// A measured odometry edge.
    Odometry,
    /// No odometry edge between consecutive scans is known (yet); the difference of their poses is used instead.
    Assumed,
    /// A loop edge of the SLAM system.
    Loop,
    /// A scan overlaps the surfaces of an older submap: its node is linked to the nearest node of that submap.
    Overlap,
}

impl LinkKind {
    /// Whether the link is used only while the poses agree with it.
    fn needs_agreement(self) -> bool {
        matches!(self, Self::Loop | Self::Overlap)
    }
}

/// Largest difference between the poses and a loop's measurement at which the loop counts as closed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// Metres.
    pub distance: f64,
    /// Radians.
    pub angle: f64,
}

/// What was done with an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EdgeOutcome {
    /// Added to the graph.
    Added,
    /// One of its nodes is unknown; the edge is stored until that node is added.
    Waiting,
    /// Replaces an earlier edge of the same kind between the same nodes.
    Replaced,
}

/// Why an edge was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EdgeError {
    /// Both ends are the same node.
    #[error("an edge from node {node} to itself is not a constraint")]
    SelfEdge {
        /// The node.
        node: NodeId,
    },
    /// The measured pose is not finite, or its quaternion does not have unit length.
    #[error("the edge from node {from} to node {to} is not a rigid transform: a number is not finite or the quaternion is not of unit length")]
    BadEdge {
        /// Its first node.
        from: NodeId,
        /// Its second node.
        to: NodeId,
    },
}

/// A link between two known nodes.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Link {
    from: NodeId,
    to: NodeId,
    kind: LinkKind,
    /// What the poses have to agree with, of links that need that.
    t_from_to: Option<Box<StoredPose>>,
    /// Metres.
    length: f64,
    /// Whether paths may use it: always for odometry, while the poses agree for loops.
    usable: bool,
    /// Whether it was closed once, and its place has it.
    noted: bool,
}

impl Link {
    fn joins(&self, a: NodeId, b: NodeId) -> bool {
        (self.from, self.to) == (a, b) || (self.from, self.to) == (b, a)
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Node {
    #[serde(with = "crate::geometry::stored")]
    t_map_lidar: Pose,
    /// Length of the path before it, through all nodes in the order in which they came, metres.
    path: f64,
    links: Vec<u32>,
}

/// Number of nodes and links by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct GraphCounts {
    /// Nodes.
    pub nodes: usize,
    /// Odometry edges between known nodes.
    pub odometry_edges: usize,
    /// Consecutive scans without an odometry edge.
    pub assumed_links: usize,
    /// Loop edges between known nodes.
    pub loop_edges: usize,
    /// Loop edges with which the current poses do not agree: not optimised yet, or outliers.
    pub open_loops: usize,
    /// Links found by overlap.
    pub overlap_links: usize,
    /// Of these and the loop edges, those that others stand for: their places were passed often.
    pub retired_links: usize,
    /// Edges stored until one of their nodes is added.
    pub waiting_edges: usize,
}

/// The pose graph. The order of everything it returns depends on the events alone.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseGraph {
    agreement: Agreement,
    nodes: NodeMap<Node>,
    links: Vec<Link>,
    /// Links that need agreement, in the order in which they came.
    loops: Vec<u32>,
    /// Edges by the unknown node that they wait for.
    waiting: HashMap<NodeId, Vec<(LinkKind, Edge)>>,
    /// Ends of loops that closed since the last call of `take_closed`.
    closed: Vec<[NodeId; 2]>,
    /// The node that came last.
    last: Option<NodeId>,
    /// Where links are retired.
    passes: Option<Passes>,
    /// Links that closed and are not noted in `passes` yet.
    to_note: Vec<u32>,
    /// Places in `links` of retired links.
    free: Vec<u32>,
    /// Retired loop edges, and retired links by overlap.
    retired: [usize; 2],
}

impl PoseGraph {
    /// An empty graph, of which no link is retired.
    pub fn new(agreement: Agreement) -> Self {
        Self {
            agreement,
            nodes: NodeMap::default(),
            links: Vec::new(),
            loops: Vec::new(),
            waiting: HashMap::new(),
            closed: Vec::new(),
            last: None,
            passes: None,
            to_note: Vec::new(),
            free: Vec::new(),
            retired: [0; 2],
        }
    }

    /// The same graph, in which places that are passed often keep the links of [some passes](super::passes) only.
    #[must_use]
    pub fn with_passes(self, rule: PassRule) -> Self {
        Self { passes: Some(Passes::new(rule)), ..self }
    }

    /// Whether `node` is in the graph.
    pub fn contains(&self, node: NodeId) -> bool {
        self.nodes.contains_key(&node)
    }

    /// A number above those of all nodes, also of those that edges wait for.
    pub fn next_node(&self) -> NodeId {
        let waiting = self.waiting.values().flatten().flat_map(|(_, edge)| [edge.from, edge.to]);
        self.nodes.keys().copied().chain(waiting).max().map_or(0, |last| last.saturating_add(1))
    }

    /// Current pose of the lidar at `node` in the map frame.
    pub fn pose(&self, node: NodeId) -> Option<&Pose> {
        self.nodes.get(&node).map(|n| &n.t_map_lidar)
    }

    /// Adds a node, or moves an existing one; edges that waited for it become links.
    pub fn add_node(&mut self, node: NodeId, t_map_lidar: &Pose) {
        match self.nodes.get_mut(&node) {
            Some(known) => known.t_map_lidar = *t_map_lidar,
            None => {
                let last = self.last.replace(node).and_then(|last| self.nodes.get(&last));
                let path = last.map_or(0.0, |last| last.path + last.t_map_lidar.translation_distance(t_map_lidar));
                self.nodes.insert(node, Node { t_map_lidar: *t_map_lidar, path, links: Vec::new() });
                for (kind, edge) in self.waiting.remove(&node).unwrap_or_default() {
                    self.link_or_wait(kind, edge);
                }
            }
        }
    }

    /// Adds the difference of the poses of `last` and `node` in place of a missing odometry edge, unless `node` has an odometry edge to
    /// a known node.
    pub fn assume_odometry(&mut self, last: NodeId, node: NodeId) {
        let (Some(a), Some(b)) = (self.nodes.get(&last), self.nodes.get(&node)) else { return };
        let has_odometry = b.links.iter().any(|&l| self.links[l as usize].kind == LinkKind::Odometry);
        if last != node && !has_odometry {
            let t_from_to = a.t_map_lidar.inv_mul(&b.t_map_lidar);
            self.link_or_wait(LinkKind::Assumed, Edge { from: last, to: node, t_from_to, information: None });
        }
    }

    /// Adds a measured edge; its nodes may be added later.
    ///
    /// # Errors
    /// [`EdgeError`]; the graph is unchanged.
    pub fn add_edge(&mut self, kind: LinkKind, edge: &Edge) -> Result<EdgeOutcome, EdgeError> {
        let &Edge { from, to, .. } = edge;
        if from == to {
            return Err(EdgeError::SelfEdge { node: from });
        }
        if !is_rigid(&edge.t_from_to) {
            return Err(EdgeError::BadEdge { from, to });
        }
        Ok(self.link_or_wait(kind, edge.clone()))
    }

    fn link_or_wait(&mut self, kind: LinkKind, edge: Edge) -> EdgeOutcome {
        let Edge { from, to, t_from_to, .. } = edge;
        if let Some(&missing) = [from, to].iter().find(|n| !self.contains(**n)) {
            self.waiting.entry(missing).or_default().push((kind, edge));
            return EdgeOutcome::Waiting;
        }
        let length = t_from_to.translation.vector.norm();
        let t_from_to = kind.needs_agreement().then(|| Box::new(StoredPose(t_from_to)));
        let known = self.nodes.get(&from).and_then(|n| n.links.iter().copied().find(|&l| self.replaces(kind, from, to, l)));
        let (index, outcome) = match known {
            Some(index) => (index, EdgeOutcome::Replaced),
            None => {
                let link = Link { from, to, kind, t_from_to: None, length, usable: false, noted: false };
                let index = self.free.pop().unwrap_or(self.links.len() as u32);
                match self.links.get_mut(index as usize) {
                    Some(free) => *free = link,
                    None => self.links.push(link),
                }
                for node in [from, to] {
                    if let Some(node) = self.nodes.get_mut(&node) {
                        node.links.push(index);
                    }
                }
                if kind.needs_agreement() {
                    self.loops.push(index);
                }
                (index, EdgeOutcome::Added)
            }
        };
        let was_assumed = self.links[index as usize].kind == LinkKind::Assumed && kind != LinkKind::Assumed;
        let Link { usable, noted, .. } = self.links[index as usize];
        self.links[index as usize] = Link { from, to, kind, t_from_to, length, usable, noted };
        if kind == LinkKind::Odometry {
            self.drop_assumed(to, index);
        }
        self.refresh(index);
        self.retire();
        if was_assumed { EdgeOutcome::Added } else { outcome }
    }

    /// Whether a new edge replaces `link`: one of the same kind, or an assumed one that odometry replaces.
    fn replaces(&self, kind: LinkKind, from: NodeId, to: NodeId, link: u32) -> bool {
        let link = &self.links[link as usize];
        link.joins(from, to) && (link.kind == kind || (kind == LinkKind::Odometry && link.kind == LinkKind::Assumed))
    }

    /// Removes assumed links to a node whose odometry is known.
    fn drop_assumed(&mut self, to: NodeId, odometry: u32) {
        let Some(node) = self.nodes.get(&to) else { return };
        let assumed: Vec<u32> = node.links.iter().copied().filter(|&l| l != odometry).filter(|&l| self.is_assumed_to(l, to)).collect();
        for link in assumed {
            let Link { from, to, .. } = self.links[link as usize];
            self.links[link as usize].usable = false;
            for node in [from, to] {
                if let Some(node) = self.nodes.get_mut(&node) {
                    node.links.retain(|&l| l != link);
                }
            }
        }
    }

    fn is_assumed_to(&self, link: u32, node: NodeId) -> bool {
        let link = &self.links[link as usize];
        link.kind == LinkKind::Assumed && link.to == node
    }

    /// Updates whether a link is usable, and records a loop that closes.
    fn refresh(&mut self, index: u32) {
        let link = &self.links[index as usize];
        let usable = !link.kind.needs_agreement() || self.agrees(link);
        if usable && !link.usable && link.kind.needs_agreement() {
            self.closed.push([link.from, link.to]);
            if !link.noted {
                self.to_note.push(index);
            }
        }
        self.links[index as usize].usable = usable;
    }

    /// Takes links out of the graph for which others stand, now that some have closed.
    fn retire(&mut self) {
        let Some(passes) = &mut self.passes else { return self.to_note.clear() };
        for index in std::mem::take(&mut self.to_note) {
            let link = &mut self.links[index as usize];
            link.noted = true;
            let (Some(from), Some(to)) = (self.nodes.get(&link.from), self.nodes.get(&link.to)) else { continue };
            let (older, newer) = if from.path <= to.path { (from, to) } else { (to, from) };
            for retired in passes.note(index, older.t_map_lidar.translation.vector.into(), newer.path) {
                let Link { from, to, kind, .. } = self.links[retired as usize];
                self.retired[usize::from(kind == LinkKind::Overlap)] += 1;
                self.loops.retain(|link| *link != retired);
                self.links[retired as usize].kind = LinkKind::Assumed;
                self.links[retired as usize].usable = false;
                self.links[retired as usize].t_from_to = None;
                self.free.push(retired);
                for node in [from, to] {
                    if let Some(node) = self.nodes.get_mut(&node) {
                        node.links.retain(|link| *link != retired);
                    }
                }
            }
        }
    }

    /// Whether links were retired: then nodes of earlier passes may be connected with none of those near them.
    pub fn has_retired(&self) -> bool {
        self.retired != [0; 2]
    }

    fn agrees(&self, link: &Link) -> bool {
        let (Some(from), Some(to)) = (self.pose(link.from), self.pose(link.to)) else { return false };
        let Some(StoredPose(t_from_to)) = link.t_from_to.as_deref() else { return false };
        let now = from.inv_mul(to);
        now.translation_distance(t_from_to) <= self.agreement.distance && now.rotation_distance(t_from_to) <= self.agreement.angle
    }

    /// Sets the poses of known nodes and returns how many of `poses` belong to unknown ones. Call [`refresh_loops`](Self::refresh_loops)
    /// afterwards.
    pub fn update_poses(&mut self, poses: &[(NodeId, Pose)]) -> usize {
        let mut unknown = 0;
        for (node, pose) in poses {
            match self.nodes.get_mut(node) {
                Some(known) => known.t_map_lidar = *pose,
                None => unknown += 1,
            }
        }
        unknown
    }

    /// Updates for every loop edge whether the current poses agree with it.
    pub fn refresh_loops(&mut self) {
        for i in 0..self.loops.len() {
            self.refresh(self.loops[i]);
        }
        self.retire();
    }

    /// Ends of the loops that closed since the last call, in that order.
    pub fn take_closed(&mut self) -> Vec<[NodeId; 2]> {
        std::mem::take(&mut self.closed)
    }

    /// Nodes linked to `node` by odometry, measured or assumed.
    pub fn odometry_neighbours(&self, node: NodeId) -> impl Iterator<Item = NodeId> {
        let links = self.nodes.get(&node).map_or(&[][..], |n| &n.links);
        links.iter().map(|&l| &self.links[l as usize]).filter(|l| !l.kind.needs_agreement()).map(move |l| if l.from == node { l.to } else { l.from })
    }

    /// All nodes within `limit` metres of any of `starts` along the graph with their distances, nearest first, ties by node. Unknown
    /// starts are ignored.
    pub fn within(&self, starts: &[NodeId], limit: f64) -> Vec<(NodeId, f64)> {
        self.search(starts, limit, |link| link.usable)
    }

    /// Whether any loop or overlap link is closed.
    pub fn has_loops(&self) -> bool {
        self.loops.iter().any(|&link| self.links[link as usize].usable)
    }

    /// As [`within`](Self::within) along odometry only: the nodes of the same pass.
    pub fn within_pass(&self, node: NodeId, limit: f64) -> Vec<(NodeId, f64)> {
        self.search(&[node], limit, |link| link.usable && !link.kind.needs_agreement())
    }

    fn search(&self, starts: &[NodeId], limit: f64, may_use: impl Fn(&Link) -> bool) -> Vec<(NodeId, f64)> {
        let mut heap: BinaryHeap<Reverse<(u64, NodeId)>> = starts.iter().filter(|n| self.contains(**n)).map(|&n| Reverse((0, n))).collect();
        let mut visited = NodeSet::default();
        let mut reached = Vec::new();
        while let Some(Reverse((bits, node))) = heap.pop() {
            if !visited.insert(node) {
                continue;
            }
            // Bit patterns of non-negative floats order like the floats.
            let distance = f64::from_bits(bits);
            reached.push((node, distance));
            for link in self.nodes[&node].links.iter().map(|&l| &self.links[l as usize]).filter(|l| may_use(l)) {
                let other = if link.from == node { link.to } else { link.from };
                let further = distance + link.length;
                if further <= limit && !visited.contains(&other) {
                    heap.push(Reverse((further.to_bits(), other)));
                }
            }
        }
        reached
    }

    /// Number of nodes and links by kind.
    pub fn counts(&self) -> GraphCounts {
        let [loop_edges, overlap_links] = self.retired;
        let (nodes, waiting_edges) = (self.nodes.len(), self.waiting.values().map(Vec::len).sum());
        let mut counts =
            GraphCounts { nodes, waiting_edges, loop_edges, overlap_links, retired_links: loop_edges + overlap_links, ..GraphCounts::default() };
        for link in &self.links {
            match link.kind {
                LinkKind::Odometry => counts.odometry_edges += 1,
                LinkKind::Assumed => counts.assumed_links += usize::from(link.usable),
                LinkKind::Loop => {
                    counts.loop_edges += 1;
                    counts.open_loops += usize::from(!link.usable);
                }
                LinkKind::Overlap => counts.overlap_links += 1,
            }
        }
        counts
    }
}

/// Whether all components are finite and the quaternion has unit length.
pub fn is_rigid(pose: &Pose) -> bool {
    let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
    numbers.clone().all(|c| c.is_finite()) && (pose.rotation.coords.norm() - 1.0).abs() < 1e-6
}

#[cfg(test)]
mod tests;
