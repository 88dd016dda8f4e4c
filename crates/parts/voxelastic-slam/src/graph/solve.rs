//! A whole graph at once: Levenberg-Marquardt by factrs, with a Huber kernel on loop edges.

use super::information::usable_information;
use crate::SlamError;
use factrs::containers::{DefaultSymbolHandler, Factor, FactorBuilder, Graph, Key, Values};
use factrs::linalg::{Matrix6 as SolverMatrix6, Vector3 as SolverVector3};
use factrs::noise::GaussianNoise;
use factrs::optimizers::{BaseOptParams, LevenMarquardt, LevenParams, OptError, Optimizer};
use factrs::residuals::{BetweenResidual, PriorResidual};
use factrs::robust::Huber;
use factrs::variables::{SE3, SO3};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::collections::{HashMap, HashSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use voxelastic::Pose;
use voxelastic::atlas::graph::is_rigid;
use voxelastic::event::{Edge, NodeId};

/// A pose graph to be optimised.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// Nodes with the poses to start from, in the map frame.
    pub nodes: &'a [(NodeId, Pose)],
    /// All edges. Those between nodes that follow each other in `nodes` are odometry, the others are loops.
    pub edges: &'a [Edge],
    /// Nodes that keep their poses; without any, the first node of every connected piece does.
    pub fixed: &'a [NodeId],
}

/// How to optimise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Loop edges count fully up to this many standard deviations, and less beyond (Huber); none for plain least squares.
    pub huber: Option<f64>,
    /// Most iterations.
    pub max_iterations: usize,
}

impl Default for Options {
    fn default() -> Self {
        // 95 % of the edges of a consistent graph are within 3.5: the root of the chi-square quantile for six degrees of freedom.
        Self { huber: Some(3.5), max_iterations: 100 }
    }
}

/// The outcome.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// The nodes, in the order of the problem, with their new poses.
    pub poses: Vec<(NodeId, Pose)>,
    /// Half the sum of squares of all whitened residuals (by the kernel, where there is one) at the start.
    pub cost_before: f64,
    /// The same at the end.
    pub cost: f64,
    /// Whether it stopped because nothing improved any more, and not at the limit of iterations.
    pub is_converged: bool,
    /// Edges whose information matrix was not positive definite: what it says of translation and of rotation was used, what couples
    /// the two was not.
    pub uncoupled: usize,
}

/// Sigmas of a node that keeps its pose: far below any edge's.
pub(super) const FIXED_SIGMA: f64 = 1e-4;

/// Finds the poses that agree best with all edges.
///
/// # Errors
/// [`SlamError`]: a problem that is none, or that the solver cannot solve.
pub fn optimise(problem: &Problem<'_>, options: &Options) -> Result<Solved, SlamError> {
    let index_of = check(problem)?;
    let values = start(problem);
    let (graph, uncoupled) = factors(problem, options, &index_of)?;
    let base = BaseOptParams { max_iterations: options.max_iterations, ..BaseOptParams::default() };
    let params = LevenParams { base, ..LevenParams::default() };
    let cost_before = graph.error(&values);
    let mut solver = LevenMarquardt::new(params, graph);
    // The library panics where a matrix cannot be factored; a graph from a file must not end the program.
    let outcome = catch_unwind(AssertUnwindSafe(|| iterate(&mut solver, values)));
    let (values, is_converged) = outcome.map_err(|panic| SlamError::Failed { reason: words_of(&*panic) })??;
    let cost = solver.error(&values);
    let poses = (problem.nodes.iter().enumerate())
        .map(|(i, (node, _))| {
            let pose = values.get_unchecked::<_, SE3>(key(i)).and_then(pose_of);
            pose.map(|pose| (*node, pose)).ok_or_else(|| SlamError::Failed { reason: format!("node {node} got no finite pose") })
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Solved { poses, cost_before, cost, is_converged, uncoupled })
}

/// Steps until nothing improves any more; whether that was so before the iterations ran out. The library's own loop loses what
/// earlier steps gained when a later one finds no improvement.
pub(super) fn iterate(solver: &mut LevenMarquardt, mut values: Values) -> Result<(Values, bool), SlamError> {
    let limits = solver.params().clone();
    let mut cost = solver.error(&values);
    solver.init(&values);
    for iteration in 1..=limits.max_iterations {
        if cost <= limits.error_tol {
            return Ok((values, true));
        }
        let better = match solver.step(values.clone(), iteration) {
            Ok((better, _)) => better,
            Err(OptError::FailedToStep) => return Ok((values, true)),
            Err(OptError::MaxIterations(_)) => break,
            Err(OptError::InvalidSystem) => return Err(SlamError::Failed { reason: "the system is singular".into() }),
        };
        let gain = cost - solver.error(&better);
        values = better;
        if gain >= 0.0 && (gain <= limits.error_tol_absolute || gain <= limits.error_tol_relative * cost) {
            return Ok((values, true));
        }
        cost -= gain;
    }
    Ok((values, false))
}

pub(super) fn words_of(panic: &(dyn std::any::Any + Send)) -> String {
    let words = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    words.unwrap_or("the solver panicked").to_owned()
}

/// Refuses what cannot be optimised; returns the place of each node.
pub(super) fn check(problem: &Problem<'_>) -> Result<HashMap<NodeId, usize>, SlamError> {
    let mut index_of = HashMap::new();
    for (i, (node, pose)) in problem.nodes.iter().enumerate() {
        if index_of.insert(*node, i).is_some() {
            return Err(SlamError::DuplicateNode { node: *node });
        }
        if !is_rigid(pose) {
            return Err(SlamError::BadPose { node: *node });
        }
    }
    if u32::try_from(problem.nodes.len()).is_err() {
        return Err(SlamError::TooMany { nodes: problem.nodes.len() });
    }
    let named = problem.edges.iter().flat_map(|e| [e.from, e.to]).chain(problem.fixed.iter().copied());
    if let Some(node) = named.into_iter().find(|n| !index_of.contains_key(n)) {
        return Err(SlamError::UnknownNode { node });
    }
    for edge in problem.edges {
        if edge.from == edge.to {
            return Err(SlamError::SelfEdge { node: edge.from });
        }
        if !is_rigid(&edge.t_from_to) {
            return Err(SlamError::BadEdge { from: edge.from, to: edge.to, reason: "its transform is not rigid" });
        }
    }
    Ok(index_of)
}

pub(super) fn key(index: usize) -> Key {
    DefaultSymbolHandler::sym_to_key('X', index as u32)
}

pub(super) fn start(problem: &Problem<'_>) -> Values {
    let mut values = Values::new();
    for (i, (_, pose)) in problem.nodes.iter().enumerate() {
        values.insert_unchecked(key(i), se3(pose));
    }
    values
}

/// All factors, and how many edges had to be uncoupled.
pub(super) fn factors(problem: &Problem<'_>, options: &Options, index_of: &HashMap<NodeId, usize>) -> Result<(Graph, usize), SlamError> {
    let mut graph = Graph::with_capacity(problem.edges.len() + 1);
    for i in anchors(problem, index_of) {
        let noise = GaussianNoise::<6>::from_scalar_sigma(FIXED_SIGMA);
        graph.add_factor(FactorBuilder::new1_unchecked(PriorResidual::new(se3(&problem.nodes[i].1)), key(i)).noise(noise).build());
    }
    let mut uncoupled = 0;
    for edge in problem.edges {
        let (noise, is_whole) = noise(edge)?;
        uncoupled += usize::from(!is_whole);
        graph.add_factor(factor(edge, noise, index_of[&edge.from], index_of[&edge.to], options));
    }
    Ok((graph, uncoupled))
}

pub(super) fn factor(edge: &Edge, noise: GaussianNoise<6>, from: usize, to: usize, options: &Options) -> Factor {
    let builder = FactorBuilder::new2_unchecked(BetweenResidual::new(se3(&edge.t_from_to)), key(from), key(to)).noise(noise);
    let is_loop = from.abs_diff(to) != 1;
    match options.huber.filter(|_| is_loop) {
        Some(k) => builder.robust(Huber::new(k)).build(),
        None => builder.build(),
    }
}

/// The noise of an edge, and whether its information was used whole.
pub(super) fn noise(edge: &Edge) -> Result<(GaussianNoise<6>, bool), SlamError> {
    let (information, is_whole) = usable_information(edge)?;
    let information = SolverMatrix6::from_fn(|i, j| information[(i, j)]);
    let refused = SlamError::BadEdge { from: edge.from, to: edge.to, reason: "its information matrix is not positive definite" };
    GaussianNoise::from_matrix_inf(information.as_view()).map(|noise| (noise, is_whole)).ok_or(refused)
}

/// The nodes that are held: the fixed ones, and the first of every piece of the graph that has none. Without them, a piece could float.
fn anchors(problem: &Problem<'_>, index_of: &HashMap<NodeId, usize>) -> Vec<usize> {
    let mut neighbours = vec![Vec::new(); problem.nodes.len()];
    for edge in problem.edges {
        let (a, b) = (index_of[&edge.from], index_of[&edge.to]);
        neighbours[a].push(b);
        neighbours[b].push(a);
    }
    let fixed: HashSet<usize> = problem.fixed.iter().map(|node| index_of[node]).collect();
    let mut anchors: Vec<usize> = fixed.iter().copied().collect();
    let mut is_seen = vec![false; problem.nodes.len()];
    for first in 0..problem.nodes.len() {
        if is_seen[first] {
            continue;
        }
        let (mut stack, mut has_anchor) = (vec![first], false);
        is_seen[first] = true;
        while let Some(i) = stack.pop() {
            has_anchor |= fixed.contains(&i);
            for &j in &neighbours[i] {
                if !std::mem::replace(&mut is_seen[j], true) {
                    stack.push(j);
                }
            }
        }
        if !has_anchor {
            anchors.push(first);
        }
    }
    anchors.sort_unstable();
    anchors
}

pub(super) fn se3(pose: &Pose) -> SE3 {
    let (q, t) = (pose.rotation.coords, pose.translation.vector);
    SE3::from_rot_trans(SO3::from_xyzw(q[0], q[1], q[2], q[3]), SolverVector3::new(t.x, t.y, t.z))
}

/// The pose, unless a number of it is not finite.
pub(super) fn pose_of(se3: &SE3) -> Option<Pose> {
    let (r, t) = (se3.rot(), se3.xyz());
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(r.w(), r.x(), r.y(), r.z()));
    let pose = Pose::from_parts(Translation3::new(t[0], t[1], t[2]), rotation);
    is_rigid(&pose).then_some(pose)
}
