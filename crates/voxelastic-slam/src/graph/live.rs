//! Optimisation in a stream of events: odometry and loops in, corrected poses out.

use super::{Options, Problem, Solved, optimise};
use crate::SlamError;
use std::collections::{HashMap, HashSet};
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId};
use voxelastic::geometry::PoseExt;

/// A loop that the poses contradict by more than this is worth an optimisation of its own, metres.
const WORTH_DISTANCE: f64 = 0.05;
/// The same for its rotation, radians.
const WORTH_ANGLE: f64 = 0.01;

/// Corrects a stream of events: scans come out at the pose that is known best so far, and after loops a
/// [`PoseUpdate`](Event::PoseUpdate) moves all nodes.
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
    edges: Vec<Edge>,
    /// Pairs of neighbours in `nodes` that have a measured odometry edge.
    measured: HashSet<usize>,
    /// Whether neighbours without a measured edge are held together by their relative pose.
    bridges_gaps: bool,
    is_due: bool,
    is_stale: bool,
    runs: usize,
    last: Option<Solved>,
}

impl LiveOptimiser {
    /// An optimiser that has seen nothing.
    pub fn new(options: Options) -> Self {
        Self {
            options,
            nodes: Vec::new(),
            index_of: HashMap::new(),
            odometry: Vec::new(),
            last_came: None,
            edges: Vec::new(),
            measured: HashSet::new(),
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
    /// When the graph cannot be optimised. The loops that came since the last time are then given up; the event is lost, the stream can
    /// go on.
    pub fn handle(&mut self, event: Event) -> Result<Vec<Event>, SlamError> {
        match event {
            Event::Scan(mut scan) => {
                let mut out: Vec<Event> = if self.is_due { self.solve()?.into_iter().collect() } else { Vec::new() };
                if !self.index_of.contains_key(&scan.node) && voxelastic::atlas::graph::is_rigid(&scan.t_map_lidar) {
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
                }
                out.push(Event::Scan(scan));
                Ok(out)
            }
            Event::OdometryEdge(edge) => {
                if let Some((from, to)) = self.places(&edge).filter(|(from, to)| from.abs_diff(*to) == 1) {
                    self.measured.insert(from.min(to));
                }
                self.edges.push(edge.clone());
                Ok(vec![Event::OdometryEdge(edge)])
            }
            Event::LoopEdge(edge) => {
                self.is_stale = true;
                if let Some((from, to)) = self.places(&edge) {
                    let now = self.nodes[from].1.inv_mul(&self.nodes[to].1);
                    let is_off = now.translation_distance(&edge.t_from_to) > WORTH_DISTANCE || now.rotation_distance(&edge.t_from_to) > WORTH_ANGLE;
                    self.is_due |= is_off;
                }
                self.edges.push(edge.clone());
                Ok(vec![Event::LoopEdge(edge)])
            }
            Event::PoseUpdate(poses) => {
                for (node, pose) in &poses {
                    if let Some(&i) = self.index_of.get(node) {
                        self.nodes[i].1 = *pose;
                        if i + 1 == self.nodes.len() {
                            // The scans that follow come on top of this correction.
                            self.last_came = Some(*pose);
                        }
                    }
                }
                Ok(vec![Event::PoseUpdate(poses)])
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

    /// The outcome of the last optimisation.
    pub fn last(&self) -> Option<&Solved> {
        self.last.as_ref()
    }

    fn places(&self, edge: &Edge) -> Option<(usize, usize)> {
        Some((*self.index_of.get(&edge.from)?, *self.index_of.get(&edge.to)?))
    }

    fn solve(&mut self) -> Result<Option<Event>, SlamError> {
        (self.is_due, self.is_stale) = (false, false);
        let mut edges: Vec<Edge> = self.edges.iter().filter(|e| self.places(e).is_some()).cloned().collect();
        for i in (1..self.nodes.len()).filter(|i| self.bridges_gaps && !self.measured.contains(&(i - 1))) {
            let t_from_to = renormalised(self.odometry[i - 1].inv_mul(&self.odometry[i]));
            edges.push(Edge { from: self.nodes[i - 1].0, to: self.nodes[i].0, t_from_to, information: None });
        }
        let problem = Problem { nodes: &self.nodes, edges: &edges, fixed: &[] };
        let solved = optimise(&problem, &self.options)?;
        self.runs += 1;
        self.nodes.clone_from(&solved.poses);
        let update = Event::PoseUpdate(solved.poses.clone());
        self.last = Some(solved);
        Ok(Some(update))
    }
}

/// Products of many rotations drift off unit length.
fn renormalised(mut pose: Pose) -> Pose {
    pose.rotation.renormalize();
    pose
}
