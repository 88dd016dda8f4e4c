//! A whole graph of which somebody holds nodes in place, and knows edges for certain: what an editor of maps asks for.

use super::solve::{self, Options, Problem, Solved, iterate, key, pose_of, se3, words_of};
use crate::SlamError;
use factrs::containers::{Factor, FactorBuilder, Graph};
use factrs::linalg::Matrix6 as SolverMatrix6;
use factrs::noise::GaussianNoise;
use factrs::optimizers::{BaseOptParams, LevenMarquardt, LevenParams, Optimizer};
use factrs::residuals::PriorResidual;
use factrs::variables::SE3;
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use std::panic::{AssertUnwindSafe, catch_unwind};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;

/// How surely a node is where it is held: metres and radians. Far surer than any edge.
const HELD: (f64, f64) = (1e-3, 1e-4);
/// The same of what is not held.
const FREE: (f64, f64) = (1e4, 1e4);
/// Rounds in which what is not held of a node is taken anew from the poses, and how little it moves in the last one, metres and radians.
const ROUNDS: usize = 8;
const SETTLED: (f64, f64) = (1e-5, 1e-6);

/// What is held of the rotation of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HeldRotation {
    /// Nothing.
    Free,
    /// This direction of the node points up, the z axis of the map.
    Up(Vector3<f64>),
    /// All of it: that of the node in the map.
    All(UnitQuaternion<f64>),
}

/// A node that is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// The node.
    pub node: NodeId,
    /// Its coordinates in the map, metres; those that are none are free.
    pub position: [Option<f64>; 3],
    /// Its rotation.
    pub rotation: HeldRotation,
}

impl Hold {
    /// A node whose whole pose is held.
    pub fn at(node: NodeId, t_map_node: &Pose) -> Self {
        Self { node, position: <[f64; 3]>::from(t_map_node.translation.vector).map(Some), rotation: HeldRotation::All(t_map_node.rotation) }
    }

    /// The pose that the node should have if what is not held stays as it is in `now`.
    pub fn wanted(&self, now: &Pose) -> Pose {
        let position = Vector3::from_fn(|k, _| self.position[k].unwrap_or(now.translation.vector[k]));
        let rotation = match self.rotation {
            HeldRotation::Free => now.rotation,
            HeldRotation::All(rotation) => rotation,
            HeldRotation::Up(up) => {
                let up = now.rotation * up;
                // Opposite directions: about any level axis.
                let turn = UnitQuaternion::rotation_between(&up, &Vector3::z());
                turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)) * now.rotation
            }
        };
        Pose::from_parts(Translation3::from(position), rotation)
    }

    /// Information of the pose in its own frame, rotation first.
    fn information(&self, wanted: &Pose) -> SolverMatrix6 {
        let of = |sigma: f64| 1.0 / (sigma * sigma);
        let position = Matrix3::from_diagonal(&Vector3::from_fn(|k, _| of(if self.position[k].is_some() { HELD.0 } else { FREE.0 })));
        let rotation = match self.rotation {
            HeldRotation::Free => Vector3::repeat(of(FREE.1)),
            HeldRotation::Up(_) => Vector3::new(of(HELD.1), of(HELD.1), of(FREE.1)),
            HeldRotation::All(_) => Vector3::repeat(of(HELD.1)),
        };
        let axes = *wanted.rotation.to_rotation_matrix().matrix();
        let in_node = |matrix: Matrix3<f64>| axes.transpose() * matrix * axes;
        let (rotation, position) = (in_node(Matrix3::from_diagonal(&rotation)), in_node(position));
        SolverMatrix6::from_fn(|i, j| match (i < 3, j < 3) {
            (true, true) => 0.5 * (rotation[(i, j)] + rotation[(j, i)]),
            (false, false) => 0.5 * (position[(i - 3, j - 3)] + position[(j - 3, i - 3)]),
            _ => 0.0,
        })
    }
}

/// Finds the poses that agree best with all edges while some nodes are held. `edges` are as those of [`Problem`], `certain` ones count fully however much the others
/// contradict them. Nothing else holds the nodes: of every connected piece of the graph, one has to be held.
///
/// # Errors
/// As [`optimise`](super::optimise).
pub fn optimise_held(nodes: &[(NodeId, Pose)], edges: &[Edge], certain: &[Edge], holds: &[Hold], options: &Options) -> Result<Solved, SlamError> {
    let all: Vec<Edge> = edges.iter().chain(certain).cloned().collect();
    let held: Vec<NodeId> = holds.iter().map(|hold| hold.node).collect();
    let index_of = solve::check(&Problem { nodes, edges: &all, fixed: &held })?;
    let mut poses = nodes.to_vec();
    let (mut cost_before, mut round) = (None, 0);
    loop {
        round += 1;
        let mut graph = Graph::with_capacity(all.len() + holds.len());
        let mut uncoupled = 0;
        for (edge, is_certain) in edges.iter().map(|edge| (edge, false)).chain(certain.iter().map(|edge| (edge, true))) {
            let (noise, is_whole) = solve::noise(edge)?;
            uncoupled += usize::from(!is_whole);
            let kernel = if is_certain { Options { huber: None, ..*options } } else { *options };
            graph.add_factor(solve::factor(edge, noise, index_of[&edge.from], index_of[&edge.to], &kernel));
        }
        for hold in holds {
            let i = index_of[&hold.node];
            graph.add_factor(prior(hold, &poses[i].1, i)?);
        }
        let values = solve::start(&Problem { nodes: &poses, edges: &all, fixed: &held });
        let base = BaseOptParams { max_iterations: options.max_iterations, ..BaseOptParams::default() };
        let before = *cost_before.get_or_insert_with(|| graph.error(&values));
        let mut solver = LevenMarquardt::new(LevenParams { base, ..LevenParams::default() }, graph);
        let outcome = catch_unwind(AssertUnwindSafe(|| iterate(&mut solver, values)));
        let (values, is_converged) = outcome.map_err(|panic| SlamError::Failed { reason: words_of(&*panic) })??;
        let mut moved = (0.0f64, 0.0f64);
        for (i, (node, pose)) in poses.iter_mut().enumerate() {
            let new = values.get_unchecked::<_, SE3>(key(i)).and_then(pose_of);
            let new = new.ok_or_else(|| SlamError::Failed { reason: format!("node {node} got no finite pose") })?;
            moved = (moved.0.max(new.translation_distance(pose)), moved.1.max(new.rotation_distance(pose)));
            *pose = new;
        }
        if round == ROUNDS || (moved.0 < SETTLED.0 && moved.1 < SETTLED.1) {
            return Ok(Solved { cost: solver.error(&values), poses, cost_before: before, is_converged, uncoupled });
        }
    }
}

fn prior(hold: &Hold, now: &Pose, index: usize) -> Result<Factor, SlamError> {
    let wanted = hold.wanted(now);
    let noise = GaussianNoise::<6>::from_matrix_inf(hold.information(&wanted).as_view());
    let noise = noise.ok_or(SlamError::BadPosition { node: hold.node })?;
    Ok(FactorBuilder::new1_unchecked(PriorResidual::new(se3(&wanted)), key(index)).noise(noise).build())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A way with turns and slopes, by odometry that is right.
    fn way(count: u64, seed: f64) -> (Vec<(NodeId, Pose)>, Vec<Edge>) {
        let step =
            |k: u64| Pose::new(Vector3::new(1.0, 0.1 * (seed + k as f64).sin(), 0.05), Vector3::new(0.01, -0.02, 0.2 * (seed * k as f64).cos()));
        let mut poses = vec![(0, Pose::new(Vector3::new(3.0, -2.0, 1.0), Vector3::new(0.02, 0.05, seed)))];
        let mut edges = Vec::new();
        for k in 1..count {
            let t_from_to = step(k);
            poses.push((k, poses[k as usize - 1].1 * t_from_to));
            edges.push(Edge { from: k - 1, to: k, t_from_to, information: None });
        }
        (poses, edges)
    }

    #[test]
    fn held_nodes_are_where_they_are_held_and_the_others_follow() {
        for k in 0..8u32 {
            let random = |n: u32| (f64::from(7 * k + n) * 12.9898).sin();
            let (seed, shift, at) = (3.0 * random(1), [2, 3, 4].map(|n| 2.0 * random(n)), 10 + u64::from(5 * k % 19));
            let (nodes, edges) = way(30, seed);
            let first = Hold::at(0, &nodes[0].1);
            let options = Options::default();
            let solve = |hold: Hold| optimise_held(&nodes, &edges, &[], &[first, hold], &options).unwrap().poses;
            let before = nodes[at as usize].1;
            // Place.
            let target = Pose::translation(shift[0], shift[1], shift[2]) * before;
            let solved = solve(Hold::at(at, &target));
            assert!(solved[at as usize].1.translation_distance(&target) < 2e-3 && solved[0].1.translation_distance(&nodes[0].1) < 2e-3);
            let along = |poses: &[(NodeId, Pose)], k: usize| poses[k].1.inverse() * poses[k + 1].1;
            // The error is shared by all edges before, and those behind keep their shape.
            let largest = (0..at as usize).map(|k| along(&solved, k).translation_distance(&edges[k].t_from_to)).fold(0.0, f64::max);
            assert!(largest < 0.35 * Vector3::from(shift).norm() + 1e-3, "{largest}");
            assert!((at as usize..29).all(|k| along(&solved, k).translation_distance(&edges[k].t_from_to) < 1e-3));
            // Height alone: the other directions are those of the cheapest bend.
            let height = before.translation.z + shift[2];
            let solved = solve(Hold { node: at, position: [None, None, Some(height)], rotation: HeldRotation::Free });
            assert!((solved[at as usize].1.translation.z - height).abs() < 2e-3);
            // Upright: a direction of the node is up, and its heading is nearly kept.
            let up = Vector3::new(0.05, -0.03, 1.0).normalize();
            let solved = solve(Hold { node: at, position: [None; 3], rotation: HeldRotation::Up(up) });
            assert!((solved[at as usize].1.rotation * up).angle(&Vector3::z()) < 1e-3);
        }
    }

    #[test]
    fn a_certain_edge_is_believed_where_a_loop_is_outvoted() {
        let (nodes, mut edges) = way(30, 0.3);
        let holds = [Hold::at(0, &nodes[0].1)];
        let wrong = Edge { from: 0, to: 29, t_from_to: Pose::translation(0.0, 0.0, 3.0) * (nodes[0].1.inverse() * nodes[29].1), information: None };
        let distance = |poses: &[(NodeId, Pose)]| (poses[0].1.inverse() * poses[29].1).translation_distance(&wrong.t_from_to);
        let sure = Options::default();
        let certain = optimise_held(&nodes, &edges, std::slice::from_ref(&wrong), &holds, &sure).unwrap();
        edges.push(wrong.clone());
        let doubted = optimise_held(&nodes, &edges, &[], &holds, &sure).unwrap();
        assert!(distance(&certain.poses) < distance(&doubted.poses) && distance(&certain.poses) < 2.0, "{}", distance(&certain.poses));
        let unknown = optimise_held(&nodes, &edges, &[], &[Hold::at(77, &nodes[0].1)], &sure);
        assert_eq!(unknown.unwrap_err(), SlamError::UnknownNode { node: 77 });
    }
}
