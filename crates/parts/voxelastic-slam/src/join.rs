//! Joins two maps, or two sessions: where the second lies in the first, from the surfaces that both have.
//!
//! The first keeps its poses; those of the second are corrected to it. So whatever is planned or marked in the first stays right, and the second can be taken
//! out again without a trace. Loop edges between places of both hold the second, its own relative poses keep its shape.

use crate::error::SlamError;
use crate::graph::{Options, Problem, optimise, symmetric, upper_triangle};
use crate::loops::{Closure, LoopSettings, PlaceBook, Verdict};
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::{Pose, PoseExt};

/// Places of the first that each place of the second is compared with: by what they look like, and by where they are.
const ALIKE: usize = 12;
const NEAREST: usize = 2;
/// A place of the second is registered to places of the first that are nearer than this share of their length.
const NEAR: f64 = 0.5;
/// Loop edges that must agree: one alone may be of places that only look alike.
const LEAST_EDGES: usize = 2;
/// Two closures agree if what they say differs by no more than this, in voxels, and by this share of the path between them.
const AGREEMENT: (f64, f64) = (4.0, 0.05);
/// Largest share of surfaces in space that the other saw to be free, of places that are registered from a guess: what their neighbours say counts, too.
const MOST_CONTRADICTION: f64 = 0.05;
/// A closure from a guess may move a place by so much, in voxels.
const MOST_CORRECTION: f64 = 10.0;
/// Edges that all others contradict by so many standard deviations are left out.
const CONTRADICTED: f64 = 6.0;
/// Edges at which the maps are compared, at most.
const MOST_COMPARED: usize = 6;
/// Recognised maps that differ more only look alike: 0.0 to 0.2 % of maps of the same place, also where one has drifted, 1.3 % of two storeys whose furniture differs.
const MOST_DIFFERENCE: f64 = 0.008;
/// Rounds in which more places are registered, from poses that those before have corrected.
const ROUNDS: usize = 5;
/// Standard deviations of what the second says of places that it passed more than once: voxels, and degrees.
const OWN_LOOP: (f64, f64) = (0.1, 0.2);

/// What is known of where the second lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// Nothing: places are recognised.
    Unknown,
    /// Probably here (second in first), as poses have one frame; places decide, and are recognised if it is elsewhere.
    Likely(Pose),
    /// About here (second in first), as somebody says.
    Given(Pose),
}

/// What told where the second lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FoundBy {
    /// The start.
    Start,
    /// Places that were recognised.
    Places,
}

/// Where the second lies in the first.
#[derive(Clone, Debug, PartialEq)]
pub struct Joined {
    /// What told it.
    pub by: FoundBy,
    /// Pose of the second's first node in the first, times the inverse of its own: where the frame of the second lies.
    pub t_first_second: Pose,
    /// The nodes of the second with their poses in the first.
    pub poses: Vec<(NodeId, Pose)>,
    /// Loop edges from nodes of the first to nodes of the second.
    pub edges: Vec<Edge>,
}

/// The outcome of [`join`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Attempt {
    /// None if the two share too few surfaces, or none, or if they only look alike.
    pub joined: Option<Joined>,
    /// Where they look alike and are not the same: in how many places, and the share of the surfaces of one that are in space that the other saw to be free, at the best
    /// quarter of these.
    pub alike: Option<(usize, f64)>,
    /// Closures that were tried.
    pub tried: Vec<Closure>,
}

impl Attempt {
    /// Number of closures tried that have this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.tried.iter().filter(|closure| closure.verdict == verdict).count()
    }
}

/// Finds where `second` lies in `first`. `path` has all nodes of the second, in the order of its scans, in its own frame; no node may be in both.
///
/// # Errors
/// When the pose graph cannot be optimised.
pub fn join(first: &PlaceBook, second: &PlaceBook, path: &[(NodeId, Pose)], start: Start, settings: &LoopSettings) -> Result<Attempt, SlamError> {
    let mut join = Join {
        first,
        second,
        path,
        settings,
        fixed: first.nodes().collect(),
        own: own_loops(path, second.voxel_size(), settings),
        tried: Vec::new(),
    };
    let mut joined = None;
    if let Start::Likely(t) | Start::Given(t) = start {
        joined = join.extend(t, Vec::new(), FoundBy::Start)?;
    }
    let is_settled = joined.is_some() && (matches!(start, Start::Given(_)) || join.accepted() * 2 >= join.tried.len());
    if !is_settled && !matches!(start, Start::Given(_)) {
        let found = join.recognise()?;
        let edges = |joined: &Option<Joined>| joined.as_ref().map_or(0, |joined| joined.edges.len());
        // What agrees more often is right.
        joined = if edges(&found) > edges(&joined) { found } else { joined };
    }
    // Poses in one frame are evidence of their own; places that were recognised are not.
    let recognised = joined.as_ref().filter(|joined| joined.by == FoundBy::Places);
    let alike =
        recognised.and_then(|joined| Some((joined.edges.len(), join.difference(&joined.edges)?))).filter(|(_, share)| *share > MOST_DIFFERENCE);
    Ok(Attempt { joined: joined.filter(|_| alike.is_none()), alike, tried: join.tried })
}

struct Join<'a> {
    first: &'a PlaceBook,
    second: &'a PlaceBook,
    path: &'a [(NodeId, Pose)],
    settings: &'a LoopSettings,
    /// Poses of the first's nodes.
    fixed: BTreeMap<NodeId, Pose>,
    own: Vec<Edge>,
    tried: Vec<Closure>,
}

impl Join<'_> {
    fn voxel(&self) -> f64 {
        self.first.voxel_size()
    }

    fn accepted(&self) -> usize {
        self.tried.iter().filter(|closure| closure.verdict == Verdict::Accepted).count()
    }

    /// From places that look alike.
    fn recognise(&mut self) -> Result<Option<Joined>, SlamError> {
        let pairs = self.first.descriptors().alike(&self.second.descriptors(), ALIKE);
        let tried = self.first.verify(self.second, &pairs, self.settings);
        let edges: Vec<Edge> = tried.iter().filter(|c| c.verdict == Verdict::Accepted).filter_map(|c| self.first.edge(c)).collect();
        self.tried.extend(tried);
        match self.consensus(&edges) {
            Some((t_first_second, agreeing)) => {
                let agreeing = agreeing.par_iter().map(|edge| self.first.fine_edge(self.second, edge)).collect();
                self.extend(t_first_second, agreeing, FoundBy::Places)
            }
            None => Ok(None),
        }
    }

    /// The most edges that agree, and the frame of the second in the first by one of them.
    fn consensus(&self, edges: &[Edge]) -> Option<(Pose, Vec<Edge>)> {
        let mut travelled = 0.0;
        let along = |k: usize| if k == 0 { 0.0 } else { self.path[k].1.translation_distance(&self.path[k - 1].1) };
        let places: HashMap<NodeId, (Pose, f64)> = (0..self.path.len())
            .map(|k| {
                travelled += along(k);
                (self.path[k].0, (self.path[k].1, travelled))
            })
            .collect();
        let claim = |edge: &Edge| {
            let (own, travelled) = *places.get(&edge.to)?;
            Some((edge.clone(), *self.fixed.get(&edge.from)? * edge.t_from_to * own.inverse(), own, travelled))
        };
        let claims: Vec<(Edge, Pose, Pose, f64)> = edges.iter().filter_map(claim).collect();
        let agree = |a: &(Edge, Pose, Pose, f64), b: &(Edge, Pose, Pose, f64)| {
            let apart = (a.1 * a.2).translation_distance(&(b.1 * a.2)).max((a.1 * b.2).translation_distance(&(b.1 * b.2)));
            apart <= AGREEMENT.0 * self.voxel() + AGREEMENT.1 * (a.3 - b.3).abs()
        };
        let groups = claims.iter().map(|one| (one.1, claims.iter().filter(|other| agree(one, other)).map(|c| c.0.clone()).collect::<Vec<_>>()));
        // The first of the largest.
        groups.filter(|(_, group)| self.is_enough(group)).reduce(|best, next| if next.1.len() > best.1.len() { next } else { best })
    }

    /// Whether edges are of places enough, each with another node of the second if that has more than one place.
    fn is_enough(&self, edges: &[Edge]) -> bool {
        let ends: BTreeSet<NodeId> = edges.iter().map(|e| if self.second.len() > 1 { e.to } else { e.from }).collect();
        ends.len() >= LEAST_EDGES.min(self.first.len().max(self.second.len()))
    }

    /// Registers all places of the second that are near places of the first, from where `edges` put them, and corrects the poses.
    fn extend(&mut self, t_first_second: Pose, mut edges: Vec<Edge>, by: FoundBy) -> Result<Option<Joined>, SlamError> {
        let mut poses: Vec<(NodeId, Pose)> = self.path.iter().map(|(node, pose)| (*node, t_first_second * pose)).collect();
        let mut done: BTreeSet<usize> = BTreeSet::new();
        for _ in 0..ROUNDS {
            if !edges.is_empty() {
                poses = self.corrected(&poses, &mut edges)?;
            }
            let now: HashMap<NodeId, Pose> = poses.iter().copied().collect();
            let guesses = self.guesses(&now, &done);
            let settings = LoopSettings { most_contradiction: MOST_CONTRADICTION, ..self.settings.clone() };
            let mut closures = self.first.verify_guesses(self.second, &guesses, &settings);
            for closure in &mut closures {
                self.limit(closure, &now);
            }
            let accepted = guesses.par_iter().zip(&closures).filter(|(_, closure)| closure.verdict == Verdict::Accepted);
            let edge =
                |((_, b, _), closure): (&(usize, usize, Pose), &Closure)| Some((*b, self.first.fine_edge(self.second, &self.first.edge(closure)?)));
            let found: Vec<(usize, Edge)> = accepted.filter_map(edge).collect();
            self.tried.extend(closures);
            if found.is_empty() {
                break;
            }
            for (place, edge) in found {
                done.insert(place);
                edges.retain(|known| (known.from, known.to) != (edge.from, edge.to));
                edges.push(edge);
            }
        }
        if !edges.is_empty() {
            poses = self.corrected(&poses, &mut edges)?;
        }
        if !self.is_enough(&edges) {
            return Ok(None);
        }
        let t_first_second = poses.first().zip(self.path.first()).map_or(t_first_second, |(now, own)| now.1 * own.1.inverse());
        Ok(Some(Joined { by, t_first_second, poses, edges }))
    }

    /// How much the maps differ where edges lay them on each other, and best: one that drifted does not lie well everywhere.
    fn difference(&self, edges: &[Edge]) -> Option<f64> {
        let some = edges.iter().step_by(edges.len().div_ceil(MOST_COMPARED).max(1)).collect::<Vec<_>>();
        let mut all: Vec<f64> = some.par_iter().filter_map(|edge| self.first.difference(self.second, edge)).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 4).copied()
    }

    /// Of each place of the second that is not `done`, the nearest ones of the first, with how it would lie there.
    fn guesses(&self, now: &HashMap<NodeId, Pose>, done: &BTreeSet<usize>) -> Vec<(usize, usize, Pose)> {
        let reach = NEAR * self.settings.place_length * self.voxel();
        let anchors: Vec<Pose> = self.first.anchors().map(|(_, pose)| pose).collect();
        let left = self.second.anchors().enumerate().filter(|(b, _)| !done.contains(b));
        left.filter_map(|(b, (node, _))| Some((b, now.get(&node)?)))
            .flat_map(|(b, pose)| {
                let mut near: Vec<(f64, usize)> =
                    anchors.iter().map(|a| a.translation_distance(pose)).zip(0..).filter(|(far, _)| *far < reach).collect();
                near.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
                let guess = |(_, a): (f64, usize)| (a, b, anchors[a].inv_mul(pose));
                near.into_iter().take(NEAREST).map(guess).collect::<Vec<_>>()
            })
            .collect()
    }

    /// Refuses a closure that moves its place farther than a guess can be wrong.
    fn limit(&self, closure: &mut Closure, now: &HashMap<NodeId, Pose>) {
        let (Some(a), Some(b), Some(fit)) = (self.fixed.get(&closure.from), now.get(&closure.to), closure.fit) else { return };
        closure.correction_m = (a * fit.t_first_second).translation_distance(b);
        if closure.verdict == Verdict::Accepted && closure.correction_m > MOST_CORRECTION * self.voxel() {
            closure.verdict = Verdict::BeyondDrift;
        }
    }

    /// The poses that agree best with the edges and with the second's own shape. Edges that are contradicted are dropped.
    fn corrected(&self, poses: &[(NodeId, Pose)], edges: &mut Vec<Edge>) -> Result<Vec<(NodeId, Pose)>, SlamError> {
        let mut own = self.own.clone();
        let poses = self.optimised(poses, edges, &own)?;
        let by_node: HashMap<NodeId, Pose> = poses.iter().copied().chain(self.fixed.iter().map(|(node, pose)| (*node, *pose))).collect();
        let before = edges.len() + own.len();
        let agrees = |edge: &Edge| deviations(edge, &by_node).is_some_and(|sigmas| sigmas <= CONTRADICTED);
        edges.retain(agrees);
        own.retain(agrees);
        if edges.len() + own.len() == before || edges.is_empty() { Ok(poses) } else { self.optimised(&poses, edges, &own) }
    }

    fn optimised(&self, poses: &[(NodeId, Pose)], edges: &[Edge], own: &[Edge]) -> Result<Vec<(NodeId, Pose)>, SlamError> {
        let ends: BTreeSet<NodeId> = edges.iter().map(|edge| edge.from).collect();
        let fixed: Vec<NodeId> = ends.into_iter().collect();
        let mut nodes: Vec<(NodeId, Pose)> = fixed.iter().filter_map(|node| Some((*node, *self.fixed.get(node)?))).collect();
        nodes.extend(poses);
        let chain = self.path.windows(2).map(|pair| relative(&pair[0], &pair[1], None));
        let edges: Vec<Edge> = chain.chain(own.iter().cloned()).chain(edges.iter().cloned()).collect();
        let solved = optimise(&Problem { nodes: &nodes, edges: &edges, fixed: &fixed }, &Options::default())?;
        Ok(solved.poses[fixed.len()..].to_vec())
    }
}

/// The edge between two nodes that their poses say.
fn relative(a: &(NodeId, Pose), b: &(NodeId, Pose), information: Option<[f64; 21]>) -> Edge {
    Edge { from: a.0, to: b.0, t_from_to: a.1.inv_mul(&b.1), information }
}

/// Edges between nodes of places that a path passes more than once: its map has them on each other, and is to keep that.
fn own_loops(path: &[(NodeId, Pose)], voxel: f64, settings: &LoopSettings) -> Vec<Edge> {
    let length = settings.place_length * voxel;
    let (position, angle) = ((OWN_LOOP.0 * voxel).powi(-2), OWN_LOOP.1.to_radians().powi(-2));
    let information = upper_triangle(&Matrix6::from_diagonal(&Vector6::new(position, position, position, angle, angle, angle)));
    let (mut edges, mut travelled, mut due): (Vec<Edge>, Vec<f64>, f64) = (Vec::new(), Vec::new(), 0.0);
    for (k, node) in path.iter().enumerate() {
        let so_far = travelled.last().map_or(0.0, |before| before + path[k - 1].1.translation_distance(&node.1));
        travelled.push(so_far);
        if so_far < due {
            continue;
        }
        due = so_far + 0.5 * length;
        let earlier = (0..k).take_while(|j| so_far - travelled[*j] > 1.5 * length).map(|j| (path[j].1.translation_distance(&node.1), j));
        let nearest = earlier.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(far, _)| *far < 0.25 * length);
        edges.extend(nearest.map(|(_, j)| relative(&path[j], node, Some(information))));
    }
    edges
}

/// How far an edge is from what poses say, standard deviations; none if one of its nodes or its information is not known.
fn deviations(edge: &Edge, poses: &HashMap<NodeId, Pose>) -> Option<f64> {
    let now = poses.get(&edge.from)?.inv_mul(poses.get(&edge.to)?);
    let off = edge.t_from_to.inv_mul(&now);
    let (t, r) = (off.translation.vector, off.rotation.scaled_axis());
    let residual = Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z);
    let information = symmetric(&edge.information?);
    Some((residual.transpose() * information * residual)[0].max(0.0).sqrt())
}
