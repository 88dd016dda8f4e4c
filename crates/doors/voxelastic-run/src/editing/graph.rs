//! The pose graph of a saved map, and what edits add to it.
//!
//! The manifest knows where corrections have put every scan, the log of the run what odometry and loops measured. Both together give edges that the poses as they are
//! agree with best, and that pull as hard as those that the run had: without an edit nothing moves, and what a wrong closure has bent springs back when it goes.

use crate::error::{Error, Result};
use crate::joining::pose_of;
use crate::map_files;
use std::collections::{BTreeMap, HashMap};
use voxelastic::Pose;
use voxelastic::atlas::SubmapId;
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::{MapStore, SessionEntry, SubmapEntry};
use voxelastic_report::RunLog;
use voxelastic_slam::graph::{HeldRotation, Hold, Options, Problem, optimise, optimise_held};

/// Poses that differ from what the edges say by more than this share of the path, and this many metres, came from elsewhere.
const FROM_ELSEWHERE: (f64, f64) = (0.01, 0.1);

/// The pose graph of a map while it is edited. Poses count from the map's origin.
#[derive(Clone, Debug)]
pub struct Graph {
    /// Odometry and loops. Their measurements are such that the poses before the edits agree with them best.
    edges: Vec<GraphEdge>,
    /// What edits know for certain.
    certain: Vec<Edge>,
    holds: Vec<Hold>,
    /// How far the poses are from what the edges say, at most, metres, and what that may be.
    apart: (f64, f64),
}

/// An edge of a run or of a session.
#[derive(Clone, Debug)]
struct GraphEdge {
    edge: Edge,
    is_loop: bool,
}

/// A scan of a map.
struct Node {
    node: NodeId,
    session: u32,
    submap: SubmapId,
    /// Where it was integrated, in the frame of its submap.
    t_submap_lidar: Pose,
    t_map_lidar: Pose,
}

/// The scans of a submap where the last correction put them, in its frame.
pub fn now(entry: &SubmapEntry) -> impl Iterator<Item = (NodeId, Pose)> {
    entry.scans.iter().enumerate().map(|(n, scan)| (scan.node, entry.corrected.get(n).unwrap_or(scan).t_submap_lidar))
}

/// The scans of submaps with their poses in the map, by node.
pub fn poses(entries: &[SubmapEntry]) -> BTreeMap<NodeId, Pose> {
    entries.iter().flat_map(|entry| now(entry).map(|(node, t)| (node, entry.t_map_submap * t))).collect()
}

impl Graph {
    /// Of a map without edits.
    ///
    /// # Errors
    /// When the graph cannot be solved, or the log of the run is damaged.
    pub fn of(store: &MapStore) -> Result<Self> {
        let manifest = store.manifest();
        let sessions = manifest.all_sessions();
        let mut nodes = Vec::new();
        for entry in &manifest.submaps {
            let session = sessions.iter().find(|session| session.has(entry.id)).map_or(0, |session| session.number);
            nodes.extend(entry.scans.iter().zip(now(entry)).map(|(scan, (node, t))| Node {
                node,
                session,
                submap: entry.id,
                t_submap_lidar: scan.t_submap_lidar,
                t_map_lidar: entry.t_map_submap * t,
            }));
        }
        nodes.sort_by_key(|node| node.node);
        nodes.dedup_by_key(|node| node.node);
        let log = map_files::read_run_log(store)?.unwrap_or_default();
        let logged = Logged::of(&log);
        let mut measured: Vec<GraphEdge> =
            nodes.windows(2).filter(|pair| pair[0].session == pair[1].session).map(|pair| odometry(&pair[0], &pair[1], &logged)).collect();
        measured.extend(loops(&log, &sessions, &poses(&manifest.submaps)).into_iter().map(|edge| GraphEdge { edge, is_loop: true }));
        settled(&nodes, measured)
    }

    /// Loop edges of the run and of sessions, by their scans: the closures that can be removed.
    pub fn closures(&self) -> Vec<[NodeId; 2]> {
        let own = self.edges.iter().filter(|edge| edge.is_loop).map(|edge| &edge.edge);
        own.chain(&self.certain).map(|edge| [edge.from, edge.to]).collect()
    }

    /// Removes the loop edges between two scans; returns how many there were.
    ///
    /// # Errors
    /// Where the poses do not follow from the edges, so that the poses of before the closure are not known.
    pub fn remove(&mut self, scans: [NodeId; 2]) -> Result<usize> {
        let is_it = |edge: &Edge| [edge.from, edge.to] == scans || [edge.to, edge.from] == scans;
        let before = self.edges.len() + self.certain.len();
        let is_of_run = self.edges.iter().any(|edge| edge.is_loop && is_it(&edge.edge));
        if is_of_run && self.apart.0 > self.apart.1 {
            let what = format!(
                "the poses of this map are up to {:.2} m from what its odometry and its loop edges say: they were corrected elsewhere, and without this closure nobody knows them",
                self.apart.0
            );
            return Err(Error::new(what, "remove it in the system that made the poses; or pin submaps where they belong"));
        }
        self.edges.retain(|edge| !(edge.is_loop && is_it(&edge.edge)));
        self.certain.retain(|edge| !is_it(edge));
        Ok(before - self.edges.len() - self.certain.len())
    }

    /// Adds what is known for certain.
    pub fn add(&mut self, edges: &[Edge]) {
        self.certain.extend(edges.iter().cloned());
    }

    /// Holds a node. What was held of it before gives way.
    pub fn hold(&mut self, hold: Hold) {
        match self.holds.iter_mut().find(|other| other.node == hold.node) {
            Some(other) => {
                other.position = std::array::from_fn(|k| hold.position[k].or(other.position[k]));
                other.rotation = if hold.rotation == HeldRotation::Free { other.rotation } else { hold.rotation };
            }
            None => self.holds.push(hold),
        }
    }

    /// Makes the edges between two groups of nodes what the poses say now, and moves what is held with them: a part of the map was moved as a whole by `change`.
    pub fn moved(&mut self, is_moved: impl Fn(NodeId) -> bool, poses: &BTreeMap<NodeId, Pose>, change: &Pose) {
        let across = |edge: &Edge| is_moved(edge.from) != is_moved(edge.to);
        for edge in self.edges.iter_mut().map(|edge| &mut edge.edge).chain(&mut self.certain).filter(|edge| across(edge)) {
            if let (Some(from), Some(to)) = (poses.get(&edge.from), poses.get(&edge.to)) {
                edge.t_from_to = from.inv_mul(to);
            }
        }
        for hold in self.holds.iter_mut().filter(|hold| is_moved(hold.node)) {
            let full = hold.position.iter().flatten().count() == 3;
            let now = poses.get(&hold.node).map(|pose| pose.translation.vector);
            if let Some(now) = now.filter(|_| !full) {
                hold.position = std::array::from_fn(|k| hold.position[k].map(|_| now[k]));
            } else if let [Some(x), Some(y), Some(z)] = hold.position {
                hold.position = <[f64; 3]>::from((change * nalgebra::Point3::new(x, y, z)).coords).map(Some);
            }
            if let HeldRotation::All(rotation) = hold.rotation {
                hold.rotation = HeldRotation::All(change.rotation * rotation);
            }
        }
    }

    /// The poses that agree best with all that is known, from those of now. `submap_of` says which submap a scan is of.
    ///
    /// # Errors
    /// When the graph cannot be solved.
    pub fn solve(&self, poses: &BTreeMap<NodeId, Pose>, submap_of: &HashMap<NodeId, SubmapId>) -> Result<Vec<(NodeId, Pose)>> {
        let nodes: Vec<(NodeId, Pose)> = poses.iter().map(|(node, pose)| (*node, *pose)).collect();
        let edges: Vec<Edge> = self.edges.iter().map(|edge| edge.edge.clone()).collect();
        let mut holds = self.holds.clone();
        for first in firsts(poses, edges.iter().chain(&self.certain)) {
            let is_near = |hold: &&mut Hold| submap_of.get(&hold.node) == submap_of.get(&first);
            // Where nobody holds the first scan, or what moves with it, it stays. Where somebody does, the rest of its pose stays.
            match holds.iter_mut().find(is_near) {
                Some(hold) => {
                    if let Some(pose) = poses.get(&hold.node) {
                        *hold = Hold::at(hold.node, &hold.wanted(pose));
                    }
                }
                None => holds.extend(poses.get(&first).map(|pose| Hold::at(first, pose))),
            }
        }
        Ok(optimise_held(&nodes, &edges, &self.certain, &holds, &Options::default())?.poses)
    }
}

/// Loop edges of a run and of sessions whose scans are in the map at these poses.
pub fn loops(log: &RunLog, sessions: &[SessionEntry], poses: &BTreeMap<NodeId, Pose>) -> Vec<Edge> {
    let of_run = log.loops.iter().filter_map(|edge| {
        // Older logs do not have what was measured; the poses agree with it.
        let now = || Some(poses.get(&edge.from)?.inv_mul(poses.get(&edge.to)?));
        let t_from_to = edge.measured.and_then(pose_of).or_else(now)?;
        Some(Edge { from: edge.from, to: edge.to, t_from_to, information: edge.information })
    });
    let of_sessions = sessions.iter().flat_map(|session| &session.loop_edges).map(|edge| Edge {
        from: edge.from,
        to: edge.to,
        t_from_to: edge.t_from_to,
        information: <[f64; 21]>::try_from(edge.information.as_slice()).ok(),
    });
    let is_there = |edge: &Edge| poses.contains_key(&edge.from) && poses.contains_key(&edge.to) && edge.from != edge.to;
    of_run.chain(of_sessions).filter(is_there).collect()
}

/// The first node of every connected piece of a graph.
fn firsts<'a>(poses: &BTreeMap<NodeId, Pose>, edges: impl Iterator<Item = &'a Edge>) -> Vec<NodeId> {
    fn root(above: &mut HashMap<NodeId, NodeId>, mut node: NodeId) -> NodeId {
        while let Some(next) = above.get(&node).copied().filter(|next| *next != node) {
            let over = above.get(&next).copied().unwrap_or(next);
            above.insert(node, over);
            node = over;
        }
        node
    }
    let mut above: HashMap<NodeId, NodeId> = poses.keys().map(|node| (*node, *node)).collect();
    for edge in edges {
        let (a, b) = (root(&mut above, edge.from), root(&mut above, edge.to));
        // The smaller number is the root.
        above.insert(a.max(b), a.min(b));
    }
    poses.keys().copied().filter(|node| root(&mut above, *node) == *node).collect()
}

/// What the log of a run has of odometry.
struct Logged {
    /// Place in the log, and pose when it came.
    scans: HashMap<NodeId, (usize, Pose)>,
    /// Corrections: before which scan of the log, and the newest scan with its pose then.
    corrections: Vec<(usize, Option<(NodeId, Pose)>)>,
}

impl Logged {
    fn of(log: &RunLog) -> Self {
        let pose = |k: usize| {
            let ([x, y, z], [qx, qy, qz, qw]) = (*log.scans.position.get(k)?, *log.scans.orientation.get(k)?);
            pose_of([x, y, z, qx, qy, qz, qw])
        };
        let scans = log.scans.node.iter().enumerate().filter_map(|(k, node)| Some((*node, (k, pose(k)?)))).collect();
        let newest = |newest: Option<(NodeId, [f64; 7])>| newest.and_then(|(node, numbers)| Some((node, pose_of(numbers)?)));
        Self { scans, corrections: log.corrections.iter().map(|c| (c.after, newest(c.newest))).collect() }
    }

    /// What odometry measured between two scans that followed each other; none where the log does not know.
    fn between(&self, a: NodeId, b: NodeId) -> Option<Pose> {
        let ((first, t_map_a), (second, t_map_b)) = (self.scans.get(&a)?, self.scans.get(&b)?);
        let mut between = self.corrections.iter().filter(|(before, _)| *before > *first && *before <= *second);
        match between.next_back() {
            None => Some(t_map_a.inv_mul(t_map_b)),
            Some((_, Some((newest, pose)))) if *newest == a => Some(pose.inv_mul(t_map_b)),
            Some(_) => None,
        }
    }
}

/// What odometry measured between neighbours.
fn odometry(a: &Node, b: &Node, logged: &Logged) -> GraphEdge {
    let as_integrated = || (a.submap == b.submap).then(|| a.t_submap_lidar.inv_mul(&b.t_submap_lidar));
    let t_from_to = logged.between(a.node, b.node).or_else(as_integrated).unwrap_or_else(|| a.t_map_lidar.inv_mul(&b.t_map_lidar));
    GraphEdge { edge: Edge { from: a.node, to: b.node, t_from_to, information: None }, is_loop: false }
}

/// The graph whose edges the poses of the nodes agree with best: residuals, and so tensions, are those of what was measured.
fn settled(nodes: &[Node], mut measured: Vec<GraphEdge>) -> Result<Graph> {
    let poses: Vec<(NodeId, Pose)> = nodes.iter().map(|node| (node.node, node.t_map_lidar)).collect();
    let edges: Vec<Edge> = measured.iter().map(|edge| edge.edge.clone()).collect();
    let solved =
        if edges.is_empty() { poses.clone() } else { optimise(&Problem { nodes: &poses, edges: &edges, fixed: &[] }, &Options::default())?.poses };
    let by_edges: HashMap<NodeId, Pose> = solved.into_iter().collect();
    let in_map: HashMap<NodeId, Pose> = poses.iter().copied().collect();
    for GraphEdge { edge, .. } in &mut measured {
        let (Some(x), Some(y)) = (in_map.get(&edge.from).zip(in_map.get(&edge.to)), by_edges.get(&edge.from).zip(by_edges.get(&edge.to))) else {
            continue;
        };
        let residual = y.1.inv_mul(&(y.0 * edge.t_from_to));
        let mut t_from_to = x.0.inv_mul(&(x.1 * residual));
        t_from_to.rotation.renormalize();
        edge.t_from_to = t_from_to;
    }
    let length: f64 = poses.windows(2).map(|pair| pair[0].1.translation_distance(&pair[1].1)).sum();
    let apart = poses.iter().filter_map(|(node, pose)| Some(by_edges.get(node)?.translation_distance(pose))).fold(0.0, f64::max);
    let apart = (apart, FROM_ELSEWHERE.0 * length + FROM_ELSEWHERE.1);
    Ok(Graph { edges: measured, certain: Vec::new(), holds: Vec::new(), apart })
}
