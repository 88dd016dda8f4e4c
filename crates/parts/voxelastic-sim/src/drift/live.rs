//! A SLAM system for a path that is not known in advance, such as that of a robot that explores.

use super::LoopSettings;
use super::correction::{Residual, corrected};
use super::loops::{loop_edge, nearest_earlier};
use super::odometry::{OdometryDrift, edges};
use crate::World;
use crate::random::Stream;
use nalgebra::UnitQuaternion;
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};

/// A simulated SLAM system that is told the true poses one after the other. The same path gives the same poses and edges.
#[derive(Clone, Debug)]
pub struct LiveSlam {
    rate: f64,
    loops: LoopSettings,
    truth: Vec<Pose>,
    odometry: Vec<Pose>,
    /// Path length up to each node, metres.
    travelled: Vec<f64>,
    /// Path length at the last loop closure, metres.
    closed: f64,
    drift: OdometryDrift,
    /// From odometry to the map, since the last correction.
    t_map_odometry: Pose,
    constant: Residual,
    random: [Stream; 2],
}

/// What the system knows after a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracked {
    /// The node.
    pub node: NodeId,
    /// Its pose when the scan is taken: by odometry since the last correction.
    pub t_map_lidar: Pose,
    /// The odometry edge to it; none for the first.
    pub edge: Option<Edge>,
    /// A loop edge that closes here, and the corrected poses of all nodes.
    pub closure: Option<(Edge, Vec<(NodeId, Pose)>)>,
}

impl LiveSlam {
    /// A system whose odometry drifts by about `rate` metres in 100 m; 0 for none.
    pub fn new(rate: f64, loops: LoopSettings, seed: u64) -> Self {
        let random = |purpose| Stream::new(seed, &[0xd1, purpose]);
        Self {
            rate,
            loops,
            truth: Vec::new(),
            odometry: Vec::new(),
            travelled: Vec::new(),
            closed: f64::NEG_INFINITY,
            drift: OdometryDrift::new(rate, random(0)),
            t_map_odometry: Pose::identity(),
            constant: Residual::constant(&random(2)),
            random: [random(1), random(2)],
        }
    }

    /// The next node, at the true pose `truth` of the lidar.
    pub fn step(&mut self, world: &World, truth: Pose) -> Tracked {
        let node = self.truth.len();
        let (odometry, metres) = match (self.truth.last(), self.odometry.last()) {
            (Some(before), Some(_)) if self.rate > 0.0 => {
                (self.drift.step(before, &truth), (truth.translation.vector - before.translation.vector).norm())
            }
            (Some(before), _) => (truth, (truth.translation.vector - before.translation.vector).norm()),
            _ => {
                self.drift.start(&truth);
                (truth, 0.0)
            }
        };
        self.truth.push(truth);
        self.odometry.push(odometry);
        self.travelled.push(self.travelled.last().copied().unwrap_or(0.0) + metres);
        let edge = node.checked_sub(1).and_then(|before| edges(&self.odometry[before..], self.rate).pop());
        let edge = edge.map(|edge| Edge { from: node as NodeId - 1, to: node as NodeId, ..edge });
        let t_map_lidar = normalised(self.t_map_odometry * odometry);
        let closure = self.close(world);
        Tracked { node: node as NodeId, t_map_lidar, edge, closure }
    }

    /// Closes a loop from an earlier node to the last one, if there is one near.
    fn close(&mut self, world: &World) -> Option<(Edge, Vec<(NodeId, Pose)>)> {
        let last = self.truth.len() - 1;
        if self.rate <= 0.0 || self.travelled[last] - self.closed < self.loops.spacing {
            return None;
        }
        let earlier = nearest_earlier(world, &self.truth, &self.travelled, last, &self.loops)?;
        let edge = loop_edge(&self.truth, (earlier, last), &self.loops, &self.random[0]);
        self.closed = self.travelled[last];
        let poses = corrected(&self.truth, &self.travelled, &self.constant, &Residual::changing(&self.random[1], &edge));
        self.t_map_odometry = normalised(poses[last] * self.odometry[last].inverse());
        Some((edge, (0..).zip(poses).collect()))
    }
}

/// Without the rounding errors that products of rotations gather.
fn normalised(pose: Pose) -> Pose {
    Pose::from_parts(pose.translation, UnitQuaternion::new_normalize(pose.rotation.into_inner()))
}
