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

use crate::event::{Edge, NodeId};
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
    #[serde(with = "crate::geometry::stored")]
    t_from_to: Pose,
    /// Metres.
    length: f64,
    /// Whether paths may use it: always for odometry, while the poses agree for loops.
    usable: bool,
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
    /// Edges stored until one of their nodes is added.
    pub waiting_edges: usize,
}

/// The pose graph. The order of everything it returns depends on the events alone.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseGraph {
    agreement: Agreement,
    nodes: HashMap<NodeId, Node>,
    links: Vec<Link>,
    /// Links that need agreement, in the order in which they came.
    loops: Vec<u32>,
    /// Edges by the unknown node that they wait for.
    waiting: HashMap<NodeId, Vec<(LinkKind, Edge)>>,
    /// Ends of loops that closed since the last call of `take_closed`.
    closed: Vec<[NodeId; 2]>,
}

impl PoseGraph {
    /// An empty graph.
    pub fn new(agreement: Agreement) -> Self {
        Self { agreement, nodes: HashMap::new(), links: Vec::new(), loops: Vec::new(), waiting: HashMap::new(), closed: Vec::new() }
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
                self.nodes.insert(node, Node { t_map_lidar: *t_map_lidar, links: Vec::new() });
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
        let known = self.nodes.get(&from).and_then(|n| n.links.iter().copied().find(|&l| self.replaces(kind, from, to, l)));
        let (index, outcome) = match known {
            Some(index) => (index, EdgeOutcome::Replaced),
            None => {
                let index = self.links.len() as u32;
                self.links.push(Link { from, to, kind, t_from_to, length, usable: false });
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
        let usable = self.links[index as usize].usable;
        self.links[index as usize] = Link { from, to, kind, t_from_to, length, usable };
        if kind == LinkKind::Odometry {
            self.drop_assumed(to, index);
        }
        self.refresh(index);
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
        }
        self.links[index as usize].usable = usable;
    }

    fn agrees(&self, link: &Link) -> bool {
        let (Some(from), Some(to)) = (self.pose(link.from), self.pose(link.to)) else { return false };
        let now = from.inv_mul(to);
        now.translation_distance(&link.t_from_to) <= self.agreement.distance && now.rotation_distance(&link.t_from_to) <= self.agreement.angle
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
        let mut visited: HashMap<NodeId, ()> = HashMap::new();
        let mut reached = Vec::new();
        while let Some(Reverse((bits, node))) = heap.pop() {
            if visited.insert(node, ()).is_some() {
                continue;
            }
            // Bit patterns of non-negative floats order like the floats.
            let distance = f64::from_bits(bits);
            reached.push((node, distance));
            for link in self.nodes[&node].links.iter().map(|&l| &self.links[l as usize]).filter(|l| may_use(l)) {
                let other = if link.from == node { link.to } else { link.from };
                let further = distance + link.length;
                if further <= limit && !visited.contains_key(&other) {
                    heap.push(Reverse((further.to_bits(), other)));
                }
            }
        }
        reached
    }

    /// Number of nodes and links by kind.
    pub fn counts(&self) -> GraphCounts {
        let mut counts = GraphCounts { nodes: self.nodes.len(), waiting_edges: self.waiting.values().map(Vec::len).sum(), ..GraphCounts::default() };
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
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    const AGREEMENT: Agreement = Agreement { distance: 0.2, angle: 0.05 };

    fn at(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    fn edge(from: NodeId, to: NodeId, length: f64) -> Edge {
        Edge { from, to, t_from_to: at(length), information: None }
    }

    #[test]
    fn edges_may_precede_their_nodes_and_odometry_replaces_assumed_links() {
        let mut graph = PoseGraph::new(AGREEMENT);
        assert_eq!(graph.add_edge(LinkKind::Odometry, &edge(0, 1, 2.0)), Ok(EdgeOutcome::Waiting));
        assert_eq!(graph.add_edge(LinkKind::Loop, &edge(2, 0, -5.0)), Ok(EdgeOutcome::Waiting));
        assert_eq!(graph.next_node(), 3);
        graph.add_node(0, &at(0.0));
        graph.add_node(1, &at(2.5));
        graph.assume_odometry(0, 1);
        assert_eq!(graph.within(&[0], 10.0), [(0, 0.0), (1, 2.0)], "the measured edge is used");
        graph.add_node(2, &at(5.0));
        graph.assume_odometry(1, 2);
        assert_eq!(graph.take_closed(), [[2, 0]], "the loop closes when its second node is added");
        assert_eq!(graph.within(&[0], 10.0), [(0, 0.0), (1, 2.0), (2, 4.5)]);
        assert_eq!(graph.add_edge(LinkKind::Odometry, &edge(1, 2, 2.0)), Ok(EdgeOutcome::Added));
        assert_eq!(graph.within(&[0], 10.0), [(0, 0.0), (1, 2.0), (2, 4.0)]);
        assert_eq!(graph.add_edge(LinkKind::Odometry, &edge(1, 2, 1.0)), Ok(EdgeOutcome::Replaced));
        let expected = GraphCounts { nodes: 3, odometry_edges: 2, loop_edges: 1, ..GraphCounts::default() };
        assert_eq!(graph.counts(), expected);
    }

    #[test]
    fn a_loop_opens_and_closes_with_the_poses() {
        let mut graph = PoseGraph::new(AGREEMENT);
        (0..3).for_each(|i| graph.add_node(i, &at(10.0 * i as f64)));
        assert_eq!(graph.add_edge(LinkKind::Loop, &edge(0, 2, 0.1)), Ok(EdgeOutcome::Added));
        assert!(graph.take_closed().is_empty() && graph.within(&[0], 5.0).len() == 1, "off by 20 m");
        assert_eq!(graph.update_poses(&[(2, at(0.2)), (77, at(0.0))]), 1);
        graph.refresh_loops();
        assert_eq!((graph.take_closed(), graph.within(&[0], 5.0)), (vec![[0, 2]], vec![(0, 0.0), (2, 0.1)]));
        assert_eq!(graph.within_pass(0, 5.0), [(0, 0.0)], "a loop is another pass");
        graph.update_poses(&[(2, at(0.5))]);
        graph.refresh_loops();
        assert!(graph.within(&[0], 5.0).len() == 1 && graph.counts().open_loops == 1);
    }

    #[test]
    fn invalid_edges_are_refused_and_unknown_starts_are_ignored() {
        let mut graph = PoseGraph::new(AGREEMENT);
        graph.add_node(3, &at(0.0));
        assert_eq!(graph.add_edge(LinkKind::Loop, &edge(3, 3, 0.0)), Err(EdgeError::SelfEdge { node: 3 }));
        assert_eq!(graph.add_edge(LinkKind::Loop, &edge(3, 4, f64::NAN)), Err(EdgeError::BadEdge { from: 3, to: 4 }));
        assert!(graph.within(&[9], 100.0).is_empty() && graph.counts().waiting_edges == 0);
    }

    proptest! {
        #[test]
        fn distances_equal_floyd_warshall(links in prop::collection::vec((0u64..12, 0u64..12, 0.0f64..5.0), 0..30), limit in 0.0f64..15.0) {
            let mut graph = PoseGraph::new(AGREEMENT);
            (0..12).for_each(|i| graph.add_node(i, &at(0.0)));
            let mut slow = [[f64::INFINITY; 12]; 12];
            (0..12).for_each(|i| slow[i][i] = 0.0);
            for &(a, b, length) in links.iter().filter(|(a, b, _)| a != b) {
                let t = Pose::from(Vector3::new(length, 0.0, 0.0));
                if graph.add_edge(LinkKind::Odometry, &Edge { from: a, to: b, t_from_to: t, information: None }) == Ok(EdgeOutcome::Added) {
                    for (i, j) in [(a, b), (b, a)] {
                        slow[i as usize][j as usize] = length;
                    }
                } else {
                    for (i, j) in [(a, b), (b, a)] {
                        slow[i as usize][j as usize] = length; // a repeated edge replaces the first
                    }
                }
            }
            for k in 0..12 {
                for i in 0..12 {
                    for j in 0..12 {
                        slow[i][j] = slow[i][j].min(slow[i][k] + slow[k][j]);
                    }
                }
            }
            let reached = graph.within(&[4], limit);
            prop_assert!(reached.windows(2).all(|w| w[0].1 <= w[1].1));
            for j in 0..12u64 {
                let fast = reached.iter().find(|r| r.0 == j).map(|r| r.1);
                let exact = slow[4][j as usize];
                if (exact - limit).abs() > 1e-9 {
                    prop_assert_eq!(fast.is_some(), exact <= limit);
                    prop_assert!(fast.is_none_or(|d| (d - exact).abs() < 1e-9));
                }
            }
        }
    }
}
