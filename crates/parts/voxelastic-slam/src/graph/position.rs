//! Pose graphs with measured positions: of a receiver's antenna or a control point, in a frame whose pose in that of the graph is found with the nodes.

use super::lie::log;
use super::solve::{self, Options, Problem, Solved, factors, iterate, key, pose_of, se3, words_of};
use crate::SlamError;
use factrs::containers::{DefaultSymbolHandler, Factor, FactorBuilder, Key};
use factrs::linalg::{Const, ForwardProp, Matrix3 as SolverMatrix3, Matrix6 as SolverMatrix6, Numeric, Vector3 as SolverVector3, VectorX};
use factrs::noise::GaussianNoise;
use factrs::optimizers::{BaseOptParams, LevenMarquardt, LevenParams, Optimizer};
use factrs::residuals::{PriorResidual, Residual2};
use factrs::robust::Huber;
use factrs::traits::Variable;
use factrs::variables::{MatrixLieGroup, SE3};
use nalgebra::{Matrix3, Point3, Vector3};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use voxelastic::Pose;
use voxelastic::atlas::graph::is_rigid;
use voxelastic::event::NodeId;

/// A position that was measured at a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPosition {
    /// The node.
    pub node: NodeId,
    /// What was measured, such as the antenna, in the frame of the node, metres.
    pub in_node: Vector3<f64>,
    /// Where it was measured to be, metres: the frame of the measurements.
    pub measured: Vector3<f64>,
    /// Its covariance, in that frame, square metres.
    pub covariance: Matrix3<f64>,
}

/// The outcome.
#[derive(Clone, Debug, PartialEq)]
pub struct Positioned {
    /// The nodes, in the frame of the graph; the first keeps its pose.
    pub solved: Solved,
    /// The frame of the graph in that of the measurements.
    pub t_measured_map: Pose,
    /// Of each position whether it was used: the others contradict all else.
    pub is_used: Vec<bool>,
    /// Measured less mapped of each position, metres, in the frame of the measurements.
    pub residuals: Vec<Vector3<f64>>,
    /// By how much residuals are larger than the standard deviations that were given, at least 1.
    pub spread: f64,
}

/// A position farther off than this is wrong, standard deviations: one of ten thousand right ones is.
const WRONG: f64 = 4.6;
/// The kernel while wrong ones are still among them (Huber 1964).
const HUBER: f64 = 1.345;
/// Ratio of the standard deviation to the median of the lengths of three normal numbers.
const OF_MEDIAN: f64 = 1.0 / 1.538;
/// Rounds of solving and sorting out.
const ROUNDS: usize = 6;
/// How surely the frame of the measurements is where the start has it, radians and metres: nothing that positions could contradict, but it holds what they leave free.
const START: (f64, f64) = (0.2, 1e3);

/// The measured position against the one of the node.
#[derive(Clone, Debug)]
struct PositionResidual {
    in_node: SolverVector3,
    measured: SolverVector3,
}

#[factrs::mark]
impl Residual2 for PositionResidual {
    type Differ = ForwardProp<Const<12>>;
    type V1 = SE3;
    type V2 = SE3;
    type DimIn = Const<12>;
    type DimOut = Const<3>;

    fn residual2<T: Numeric>(&self, t_measured_map: SE3<T>, t_map_node: SE3<T>) -> VectorX<T> {
        let (in_node, measured) = (self.in_node.map(T::from), self.measured.map(T::from));
        let there = t_measured_map.compose(&t_map_node).apply(in_node.as_view()) - measured;
        VectorX::from_iterator(3, there.iter().copied())
    }
}

/// Finds the poses that agree best with all edges and positions, from `t_measured_map`, the frame of the graph in that of the measurements. Positions that contradict
/// all others are sorted out, and taken in again if they fit after all. Where positions fit worse than their standard deviations say, all of these are taken for larger.
///
/// # Errors
/// As [`optimise`](super::optimise); a position whose covariance is none.
pub fn optimise_with_positions(
    problem: &Problem<'_>,
    positions: &[MeasuredPosition],
    t_measured_map: &Pose,
    options: &Options,
) -> Result<Positioned, SlamError> {
    let index_of = solve::check(problem)?;
    let whiteners = check(positions, &index_of, t_measured_map)?;
    let frame: Key = DefaultSymbolHandler::sym_to_key('E', 0);
    let (mut is_used, mut spread) = (vec![true; positions.len()], 1.0f64);
    let mut start = (problem.nodes.to_vec(), *t_measured_map);
    let mut first_cost = None;
    let mut round = 0;
    loop {
        round += 1;
        let here = Problem { nodes: &start.0, ..*problem };
        let (mut graph, uncoupled) = factors(&here, options, &index_of)?;
        let is_first = round == 1;
        for ((position, whitener), _) in positions.iter().zip(&whiteners).zip(&is_used).filter(|(_, used)| **used) {
            graph.add_factor(factor(position, &(whitener / (spread * spread)), frame, key(index_of[&position.node]), is_first)?);
        }
        graph.add_factor(FactorBuilder::new1_unchecked(PriorResidual::new(se3(&start.1)), frame).noise(prior()?).build());
        let mut values = solve::start(&here);
        values.insert_unchecked(frame, se3(&start.1));
        let base = BaseOptParams { max_iterations: options.max_iterations, ..BaseOptParams::default() };
        let cost_before = *first_cost.get_or_insert(graph.error(&values));
        let mut solver = LevenMarquardt::new(LevenParams { base, ..LevenParams::default() }, graph);
        let outcome = catch_unwind(AssertUnwindSafe(|| iterate(&mut solver, values)));
        let (values, is_converged) = outcome.map_err(|panic| SlamError::Failed { reason: words_of(&*panic) })??;
        let lost = |node: &dyn std::fmt::Display| SlamError::Failed { reason: format!("{node} got no finite pose") };
        let pose = |at: Key| values.get_unchecked::<_, SE3>(at).and_then(pose_of);
        let found = (problem.nodes.iter().enumerate()).map(|(i, (node, _))| Ok((*node, pose(key(i)).ok_or_else(|| lost(node))?)));
        let poses: Vec<(NodeId, Pose)> = found.collect::<Result<_, SlamError>>()?;
        let t_measured_map = pose(frame).ok_or_else(|| lost(&"the frame of the positions"))?;
        let residual = |p: &MeasuredPosition| p.measured - (t_measured_map * poses[index_of[&p.node]].1 * Point3::from(p.in_node)).coords;
        let residuals: Vec<Vector3<f64>> = positions.iter().map(residual).collect();
        let deviations: Vec<f64> = residuals.iter().zip(&whiteners).map(|(r, w)| r.dot(&(w * r)).max(0.0).sqrt()).collect();
        let (now, larger) = sort_out(&deviations, spread);
        let is_same = now == is_used && (larger / spread - 1.0).abs() < 0.05;
        if (is_same && !is_first) || round == ROUNDS {
            let cost = solver.error(&values);
            let solved = Solved { poses, cost_before, cost, is_converged, uncoupled };
            return Ok(Positioned { solved, t_measured_map, is_used, residuals, spread });
        }
        (is_used, spread, start) = (now, larger, (poses, t_measured_map));
    }
}

/// Which positions fit, and by how much residuals are larger than they should be.
fn sort_out(deviations: &[f64], spread: f64) -> (Vec<bool>, f64) {
    let mut sorted = deviations.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).map_or(1.0, |median| median * OF_MEDIAN);
    // The poses follow the positions, so that residuals say when these are worse than was thought, and never when they are better.
    let larger = median.max(spread).max(1.0);
    (deviations.iter().map(|d| *d <= WRONG * larger).collect(), larger)
}

/// The information matrices; refuses positions that are none.
fn check(positions: &[MeasuredPosition], index_of: &HashMap<NodeId, usize>, frame: &Pose) -> Result<Vec<Matrix3<f64>>, SlamError> {
    if !is_rigid(frame) {
        return Err(SlamError::Failed { reason: "the frame of the positions is not a rigid transform".into() });
    }
    let information = |p: &MeasuredPosition| {
        if !index_of.contains_key(&p.node) {
            return Err(SlamError::UnknownNode { node: p.node });
        }
        let is_finite = p.measured.iter().chain(&p.in_node).all(|c| c.is_finite());
        let inverse = p.covariance.cholesky().filter(|_| is_finite).map(|c| c.inverse());
        inverse.ok_or(SlamError::BadPosition { node: p.node })
    };
    positions.iter().map(information).collect()
}

fn factor(position: &MeasuredPosition, information: &Matrix3<f64>, frame: Key, node: Key, is_robust: bool) -> Result<Factor, SlamError> {
    let vector = |v: &Vector3<f64>| SolverVector3::new(v.x, v.y, v.z);
    let residual = PositionResidual { in_node: vector(&position.in_node), measured: vector(&position.measured) };
    let matrix = SolverMatrix3::from_fn(|i, j| information[(i, j)]);
    let noise = GaussianNoise::<3>::from_matrix_inf(matrix.as_view()).ok_or(SlamError::BadPosition { node: position.node })?;
    let builder = FactorBuilder::new2_unchecked(residual, frame, node).noise(noise);
    Ok(if is_robust { builder.robust(Huber::new(HUBER)).build() } else { builder.build() })
}

fn prior() -> Result<GaussianNoise<6>, SlamError> {
    let sigma = |k: usize| if k < 3 { START.0 } else { START.1 };
    let matrix = SolverMatrix6::from_fn(|i, j| if i == j { 1.0 / (sigma(i) * sigma(i)) } else { 0.0 });
    GaussianNoise::from_matrix_inf(matrix.as_view()).ok_or_else(|| SlamError::Failed { reason: "no prior of the frame".into() })
}

/// How far the nodes moved relative to each other, at most, metres: the largest change of a pose in the frame of the first.
pub fn largest_bend(before: &[(NodeId, Pose)], after: &[(NodeId, Pose)]) -> f64 {
    let Some(((_, first), (_, now))) = before.first().zip(after.first()) else { return 0.0 };
    let change = now * first.inverse();
    before.iter().zip(after).map(|((_, a), (_, b))| log(&((change * a).inverse() * b)).fixed_rows::<3>(3).norm()).fold(0.0, f64::max)
}
