//! Optimisation in a stream of events: odometry and loops in, corrected poses out.

use super::incremental::{Correction, IncrementalGraph};
use super::information::usable_information;
use super::lie::renormalised;
use super::solve::Options;
use super::vertical::VerticalFactor;
use crate::SlamError;
use std::collections::HashMap;
use voxelastic::Pose;
use voxelastic::atlas::graph::is_rigid;
use voxelastic::event::{Edge, Event, NodeId};
use voxelastic::geometry::PoseExt;

/// A loop that the poses contradict by more than this is worth an optimisation of its own, metres.
const WORTH_DISTANCE: f64 = 0.05;
/// The same for its rotation, radians.
const WORTH_ANGLE: f64 = 0.01;

/// Corrects a stream of events: scans come out at the pose that is known best so far, and after loops a
/// [`PoseUpdate`](Event::PoseUpdate) moves all nodes.
///
/// A loop that contradicts all others, or the odometry, by tens of standard deviations is outvoted: it does not count as long as that is so.
///
/// A loop is optimised together with those of the same scan, when the next scan comes. One that agrees with the poses already waits for
/// the next that does not, or for the end: it would change next to nothing.
#[derive(Debug)]
pub struct LiveOptimiser {
    options: Options,
    nodes: Vec<(NodeId, Pose)>,
    index_of: HashMap<NodeId, usize>,
    /// Poses of the nodes by odometry alone.
    odometry: Vec<Pose>,
    /// Pose of the last node in the frame in which the next scan comes: as it came, or as somebody else has corrected it.
    last_came: Option<Pose>,
    graph: IncrementalGraph,
    /// Edges to nodes that have not come yet.
    waiting: Vec<(Kind, Edge)>,
    /// What holds a node to the one before: its number in the graph, and whether it was measured.
    odometry_edges: HashMap<usize, (usize, bool)>,
    /// Whether neighbours without a measured edge are held together by their relative pose.
    bridges_gaps: bool,
    is_due: bool,
    is_stale: bool,
    runs: usize,
    last: Option<Correction>,
}

/// How an edge was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Odometry,
    Loop,
}

impl LiveOptimiser {
    /// An optimiser without poses and edges.
    pub fn new(options: Options) -> Self {
        Self {
            options,
            nodes: Vec::new(),
            index_of: HashMap::new(),
            odometry: Vec::new(),
            last_came: None,
            graph: IncrementalGraph::default(),
            waiting: Vec::new(),
            odometry_edges: HashMap::new(),
            bridges_gaps: true,
            is_due: false,
            is_stale: false,
            runs: 0,
            last: None,
        }
    }

    /// Without an odometry edge, a scan begins a new piece that only loops join to the others: for odometry that says when it is lost. Otherwise
    /// the relative pose of the two scans takes the place of the edge.
    #[must_use]
    pub fn with_pieces(self) -> Self {
        Self { bridges_gaps: false, ..self }
    }

    /// Optimisations run so far.
    pub fn runs(&self) -> usize {
        self.runs
    }

    /// What becomes of an event: itself, corrected, after what it sets off. Edges to nodes that never came are passed on and not used.
    ///
    /// # Errors
    /// When the event is an edge that is no measurement, or the graph cannot be optimised. The event is then lost; the stream can go on, and
    /// the next loop is a reason to try again.
    pub fn handle(&mut self, event: Event) -> Result<Vec<Event>, SlamError> {
        match event {
            Event::Scan(mut scan) => {
                let mut out: Vec<Event> = if self.is_due { self.solve()?.into_iter().collect() } else { Vec::new() };
                if !self.index_of.contains_key(&scan.node) && is_rigid(&scan.t_map_lidar) {
                    let came = scan.t_map_lidar;
                    let mut odometry = came;
                    if let (Some(last_came), Some(last_odometry), Some((_, last))) = (&self.last_came, self.odometry.last(), self.nodes.last()) {
                        let motion = last_came.inv_mul(&came);
                        scan.t_map_lidar = renormalised(last * motion);
                        odometry = renormalised(last_odometry * motion);
                    }
                    self.index_of.insert(scan.node, self.nodes.len());
                    self.nodes.push((scan.node, scan.t_map_lidar));
                    self.odometry.push(odometry);
                    self.last_came = Some(came);
                    self.graph.add_node(scan.t_map_lidar);
                    for (kind, edge) in std::mem::take(&mut self.waiting) {
                        self.add(kind, edge)?;
                    }
                }
                out.push(Event::Scan(scan));
                Ok(out)
            }
            Event::OdometryEdge(edge) => {
                self.add(Kind::Odometry, edge.clone())?;
                Ok(vec![Event::OdometryEdge(edge)])
            }
            Event::LoopEdge(edge) => {
                self.add(Kind::Loop, edge.clone())?;
                Ok(vec![Event::LoopEdge(edge)])
            }
            Event::PoseUpdate(poses) => {
                for (node, pose) in &poses {
                    if let Some(&i) = self.index_of.get(node) {
                        self.nodes[i].1 = *pose;
                        self.graph.set_pose(i, *pose);
                        if i + 1 == self.nodes.len() {
                            // The scans that follow come on top of this correction.
                            self.last_came = Some(*pose);
                        }
                    }
                }
                Ok(vec![Event::PoseUpdate(poses)])
            }
            Event::Vertical(vertical) => {
                if let Some(&node) = self.index_of.get(&vertical.node) {
                    let factor = VerticalFactor::new(node, &vertical)?;
                    self.is_stale |= factor.deviation(&self.nodes[node].1.rotation) > 1.0;
                    self.graph.add_vertical(factor);
                }
                Ok(vec![Event::Vertical(vertical)])
            }
            other => Ok(vec![other]),
        }
    }

    /// The last correction, if loops came since the one before. To be called when the stream ends.
    ///
    /// # Errors
    /// When the graph cannot be optimised.
    pub fn finish(&mut self) -> Result<Option<Event>, SlamError> {
        if self.is_stale { self.solve() } else { Ok(None) }
    }

    /// The nodes with the poses that are known best so far: optimised, or by odometry from there.
    pub fn poses(&self) -> &[(NodeId, Pose)] {
        &self.nodes
    }

    /// Loop edges, by their nodes, that did not count in the last optimisation, as all others contradict them by tens of standard deviations.
    pub fn outvoted(&self) -> Vec<(NodeId, NodeId)> {
        self.graph.outvoted().map(|number| self.graph.nodes_of(number)).map(|(from, to)| (self.nodes[from].0, self.nodes[to].0)).collect()
    }

    /// What the last optimisation did.
    pub fn last(&self) -> Option<&Correction> {
        self.last.as_ref()
    }

    fn places(&self, edge: &Edge) -> Option<(usize, usize)> {
        Some((*self.index_of.get(&edge.from)?, *self.index_of.get(&edge.to)?))
    }

    /// Adds an edge to the graph, or lets it wait for its nodes.
    fn add(&mut self, kind: Kind, edge: Edge) -> Result<(), SlamError> {
        if edge.from == edge.to {
            return Err(SlamError::SelfEdge { node: edge.from });
        }
        if !is_rigid(&edge.t_from_to) {
            return Err(SlamError::BadEdge { from: edge.from, to: edge.to, reason: "its transform is not rigid" });
        }
        usable_information(&edge)?;
        let Some((from, to)) = self.places(&edge) else {
            self.waiting.push((kind, edge));
            return Ok(());
        };
        if kind == Kind::Loop {
            let now = self.nodes[from].1.inv_mul(&self.nodes[to].1);
            self.is_stale = true;
            self.is_due |= now.translation_distance(&edge.t_from_to) > WORTH_DISTANCE || now.rotation_distance(&edge.t_from_to) > WORTH_ANGLE;
        }
        let later = from.max(to);
        let holds_neighbours = kind == Kind::Odometry && from.abs_diff(to) == 1;
        match self.odometry_edges.get(&later).copied().filter(|_| holds_neighbours) {
            Some((number, false)) => {
                self.graph.replace_edge(number, (from, to), &edge, &self.options)?;
                self.odometry_edges.insert(later, (number, true));
            }
            _ => {
                let number = self.graph.add_edge((from, to), &edge, &self.options)?;
                if holds_neighbours {
                    self.odometry_edges.insert(later, (number, true));
                }
            }
        }
        Ok(())
    }

    /// Holds neighbours without a measured edge together by their relative pose.
    fn bridge_gaps(&mut self) -> Result<(), SlamError> {
        for i in 1..self.nodes.len() {
            if !self.odometry_edges.contains_key(&i) {
                let t_from_to = renormalised(self.odometry[i - 1].inv_mul(&self.odometry[i]));
                let edge = Edge { from: self.nodes[i - 1].0, to: self.nodes[i].0, t_from_to, information: None };
                let number = self.graph.add_edge((i - 1, i), &edge, &self.options)?;
                self.odometry_edges.insert(i, (number, false));
            }
        }
        Ok(())
    }

    fn solve(&mut self) -> Result<Option<Event>, SlamError> {
        (self.is_due, self.is_stale) = (false, false);
        if self.bridges_gaps {
            self.bridge_gaps()?;
        }
        self.last = Some(self.graph.solve(&self.options)?);
        self.runs += 1;
        self.nodes.iter_mut().zip(self.graph.poses()).for_each(|(node, pose)| node.1 = *pose);
        Ok(Some(Event::PoseUpdate(self.nodes.clone())))
    }
}
