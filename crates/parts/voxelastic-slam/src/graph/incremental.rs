//! A graph that grows: Gauss-Newton from the last solution, with what the last one has left.
//!
//! Between one closure and the next, hardly anything changes. How an edge bends with the poses of its nodes depends on its residual alone, so an
//! edge keeps its linearisation until its residual has moved, wherever the map has moved to. A factored matrix is kept as long as steps with
//! it shrink quickly. Residuals and gradients are always those of the present poses, so that the end is the minimum, whatever was kept.

use super::between::{Between, Evaluation};
use super::block_cholesky::{Structure, System};
use super::information::usable_information;
use super::lie::{exp, log, renormalised};
use super::solve::{FIXED_SIGMA, Options};
use super::vertical::VerticalFactor;
use crate::SlamError;
use nalgebra::{Matrix6, Vector6};
use voxelastic::Pose;
use voxelastic::event::Edge;

/// It ends when no node moves by more than this: metres, radians.
const STEP: (f64, f64) = (1e-4, 1e-5);
/// And when the cost falls by less than this share.
const GAIN: f64 = 1e-9;
/// A factored matrix is used again if steps shrink to this share.
const SHRINKS: f64 = 0.25;
/// Damping after a step that made things worse, relative to the diagonal; and the damping with which it gives up.
const DAMPING: (f64, f64) = (1e-6, 1e5);

/// A loop that is contradicted by this many times the deviation up to which it counts fully is outvoted.
const OUTVOTED: f64 = 15.0;

/// What an optimisation did.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Correction {
    /// Half the sum of squares of all whitened residuals (by the kernel, where there is one) at the start.
    pub cost_before: f64,
    /// The same at the end.
    pub cost: f64,
    /// Whether it stopped because nothing improved any more, and not at the limit of iterations.
    pub is_converged: bool,
    /// Steps taken or tried.
    pub iterations: usize,
    /// Times a matrix was factored.
    pub factorisations: usize,
    /// Edges that were linearised, over all iterations.
    pub linearised: usize,
}

/// A pose graph to which nodes and edges are added.
#[derive(Debug, Default)]
pub(super) struct IncrementalGraph {
    poses: Vec<Pose>,
    edges: Vec<Between>,
    verticals: Vec<VerticalFactor>,
    system: Option<System>,
}

/// All edges at some poses.
struct State {
    evaluations: Vec<Evaluation>,
    gradient: Vec<Vector6<f64>>,
    cost: f64,
}

impl IncrementalGraph {
    pub(super) fn add_node(&mut self, pose: Pose) {
        self.poses.push(pose);
        self.system = None;
    }

    /// Sets the pose from which the next solution starts.
    pub(super) fn set_pose(&mut self, node: usize, pose: Pose) {
        self.poses[node] = pose;
    }

    /// Adds an edge between two different nodes and returns its number. Edges between nodes that follow each other are odometry, the others are
    /// loops.
    pub(super) fn add_edge(&mut self, nodes: (usize, usize), edge: &Edge, options: &Options) -> Result<usize, SlamError> {
        self.edges.push(between(nodes, edge, options)?);
        self.system = None;
        Ok(self.edges.len() - 1)
    }

    /// Holds the roll and the pitch of a node.
    pub(super) fn add_vertical(&mut self, factor: VerticalFactor) {
        self.verticals.push(factor);
    }

    /// Puts an edge between the same nodes in the place of another.
    pub(super) fn replace_edge(&mut self, number: usize, nodes: (usize, usize), edge: &Edge, options: &Options) -> Result<(), SlamError> {
        self.edges[number] = between(nodes, edge, options)?;
        Ok(())
    }

    /// The nodes of an edge.
    pub(super) fn nodes_of(&self, number: usize) -> (usize, usize) {
        self.edges[number].nodes
    }

    pub(super) fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Numbers of the edges that do not count, as the others contradict them.
    pub(super) fn outvoted(&self) -> impl Iterator<Item = usize> {
        self.edges.iter().enumerate().filter(|(_, e)| e.is_outvoted).map(|(number, _)| number)
    }

    /// Moves the poses to the minimum. The first node of every piece keeps its own. Loops that the others contradict there are left out, the
    /// worst first, until none is left; a loop that was left out and is no longer contradicted counts again.
    pub(super) fn solve(&mut self, options: &Options) -> Result<Correction, SlamError> {
        let poses = &self.poses;
        let contradiction = |e: &Between| e.contradiction(&poses[e.nodes.0], &poses[e.nodes.1]);
        self.edges.iter_mut().for_each(|e| e.is_outvoted &= contradiction(e).is_some_and(|c| c > OUTVOTED));
        let mut done = self.minimise(options)?;
        while let Some(worst) = self.most_contradicted() {
            self.edges[worst].is_outvoted = true;
            let next = self.minimise(options)?;
            done = Correction {
                cost_before: done.cost_before,
                iterations: done.iterations + next.iterations,
                factorisations: done.factorisations + next.factorisations,
                linearised: done.linearised + next.linearised,
                ..next
            };
        }
        Ok(done)
    }

    /// The loop that the others contradict most, if that is beyond doubt.
    fn most_contradicted(&self) -> Option<usize> {
        let contradiction = |e: &Between| e.contradiction(&self.poses[e.nodes.0], &self.poses[e.nodes.1]);
        let counting = self.edges.iter().enumerate().filter(|(_, e)| !e.is_outvoted);
        let contradicted = counting.filter_map(|(number, e)| contradiction(e).filter(|c| *c > OUTVOTED).map(|c| (c, number)));
        contradicted.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, number)| number)
    }

    fn minimise(&mut self, options: &Options) -> Result<Correction, SlamError> {
        let anchors: Vec<(usize, Pose)> = self.firsts_of_pieces().into_iter().map(|i| (i, self.poses[i])).collect();
        let mut state = self.evaluate(&self.poses, &anchors);
        let mut done = Correction { cost_before: state.cost, cost: 0.0, is_converged: false, iterations: 0, factorisations: 0, linearised: 0 };
        let (mut is_factored, mut is_fresh, mut damping, mut last_size) = (false, false, 0.0, f64::INFINITY);
        while done.iterations < options.max_iterations {
            if !is_factored {
                done.linearised += self.assemble(&state, &anchors, is_fresh)?;
                done.factorisations += 1;
                is_factored = self.system.as_mut().is_some_and(|system| system.factorise(damping));
                if !is_factored {
                    damping = more(damping)?;
                    continue;
                }
                (is_fresh, last_size) = (true, f64::INFINITY);
            }
            done.iterations += 1;
            let step = self.system.as_mut().map(|system| system.solve(&state.gradient)).unwrap_or_default();
            let trial: Vec<Pose> = self.poses.iter().zip(&step).map(|(pose, step)| renormalised(pose * exp(&-step))).collect();
            let after = self.evaluate(&trial, &anchors);
            let size = size(&step);
            let is_small = size <= 1.0;
            if after.cost.is_nan() || after.cost > state.cost {
                if is_small && is_fresh {
                    done.is_converged = true;
                    break;
                }
                if is_fresh {
                    match more(damping) {
                        Ok(next) => damping = next,
                        Err(_) => break,
                    }
                }
                (is_factored, is_fresh) = (false, true);
                continue;
            }
            let gain = state.cost - after.cost;
            (self.poses, state) = (trial, after);
            if is_small || gain <= GAIN * state.cost {
                done.is_converged = true;
                break;
            }
            is_fresh = false;
            is_factored = damping == 0.0 && size <= SHRINKS * last_size;
            damping = if damping > 10.0 * DAMPING.0 { 0.1 * damping } else { 0.0 };
            last_size = size;
        }
        done.cost = state.cost;
        Ok(done)
    }

    fn firsts_of_pieces(&self) -> Vec<usize> {
        fn first(parent: &mut [usize], mut node: usize) -> usize {
            while parent[node] != node {
                parent[node] = parent[parent[node]];
                node = parent[node];
            }
            node
        }
        let mut parent: Vec<usize> = (0..self.poses.len()).collect();
        for edge in self.edges.iter().filter(|e| !e.is_outvoted) {
            let (a, b) = (first(&mut parent, edge.nodes.0), first(&mut parent, edge.nodes.1));
            parent[a.max(b)] = a.min(b);
        }
        (0..parent.len()).filter(|i| parent[*i] == *i).collect()
    }

    fn evaluate(&self, poses: &[Pose], anchors: &[(usize, Pose)]) -> State {
        let evaluations: Vec<Evaluation> = self.edges.iter().map(|e| e.evaluate(&poses[e.nodes.0], &poses[e.nodes.1])).collect();
        let mut state = State { evaluations, gradient: vec![Vector6::zeros(); poses.len()], cost: 0.0 };
        for (edge, at) in self.edges.iter().zip(&state.evaluations).filter(|(edge, _)| !edge.is_outvoted) {
            let (first, second) = edge.gradient(at);
            state.gradient[edge.nodes.0] += first;
            state.gradient[edge.nodes.1] += second;
            state.cost += at.cost;
        }
        for factor in &self.verticals {
            let share = factor.share(&poses[factor.node].rotation);
            state.gradient[factor.node] += share.gradient;
            state.cost += share.cost;
        }
        for (node, pose) in anchors {
            let off = log(&pose.inv_mul(&poses[*node]));
            state.gradient[*node] += off / (FIXED_SIGMA * FIXED_SIGMA);
            state.cost += 0.5 * off.norm_squared() / (FIXED_SIGMA * FIXED_SIGMA);
        }
        state
    }

    /// Puts the matrix together, of linearisations that still hold and new ones. Returns the number of new ones.
    fn assemble(&mut self, state: &State, anchors: &[(usize, Pose)], always: bool) -> Result<usize, SlamError> {
        let mut system = match self.system.take() {
            Some(system) => system,
            None => {
                let structure = Structure::new(self.poses.len(), self.edges.iter().map(|e| e.nodes));
                let failed = || SlamError::Failed { reason: format!("a graph of {} nodes does not fit into memory", self.poses.len()) };
                structure.and_then(System::new).ok_or_else(failed)?
            }
        };
        let mut linearised = 0;
        system.clear();
        for (edge, at) in self.edges.iter_mut().zip(&state.evaluations).filter(|(edge, _)| !edge.is_outvoted) {
            linearised += usize::from(edge.linearise(at, always));
            let (a, b) = edge.nodes;
            if let (Some(linear), Some(place)) = (edge.linear(), system.structure().block(a, b)) {
                system.add_diagonal(a, &linear.blocks[0]);
                system.add(place, &linear.blocks[1]);
                system.add_diagonal(b, &linear.blocks[2]);
            }
        }
        for factor in &self.verticals {
            system.add_diagonal(factor.node, &factor.share(&self.poses[factor.node].rotation).block);
        }
        let fixed = Matrix6::identity() / (FIXED_SIGMA * FIXED_SIGMA);
        anchors.iter().for_each(|(node, _)| system.add_diagonal(*node, &fixed));
        self.system = Some(system);
        Ok(linearised)
    }
}

fn between(nodes: (usize, usize), edge: &Edge, options: &Options) -> Result<Between, SlamError> {
    let (information, _) = usable_information(edge)?;
    let is_loop = nodes.0.abs_diff(nodes.1) != 1;
    Ok(Between::new(nodes, edge.t_from_to, information, options.huber.filter(|_| is_loop)))
}

fn more(damping: f64) -> Result<f64, SlamError> {
    let next = (10.0 * damping).max(DAMPING.0);
    if next <= DAMPING.1 { Ok(next) } else { Err(SlamError::Failed { reason: "the system is singular".into() }) }
}

/// The largest step of a node, relative to what is small enough.
fn size(step: &[Vector6<f64>]) -> f64 {
    step.iter().map(|s| (s.fixed_rows::<3>(0).norm() / STEP.1).max(s.fixed_rows::<3>(3).norm() / STEP.0)).fold(0.0, f64::max)
}
