//! Corrected poses after each loop closure, in place of the back end of a SLAM system.
//!
//! Nothing is optimised. After a loop closure a good pose-graph optimiser leaves errors of a few centimetres that vary slowly along the path, so the
//! corrected poses are the true ones with such an error. Later nodes continue from the last corrected one by odometry until the next
//! closure. For the optimum of the pose graph itself, run an optimiser on it.

use super::odometry::path_lengths;
use crate::random::Stream;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use std::f64::consts::TAU;
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};

/// Corrected poses of all nodes so far, at a loop closure.
#[derive(Clone, Debug, PartialEq)]
pub struct Correction {
    /// The newer node of the loop edge.
    pub node: NodeId,
    /// Poses of the nodes 0 to `node`.
    pub poses: Vec<Pose>,
}

/// Standard deviation of the residual error per axis far from the first node, metres and radians.
const RESIDUAL_SIGMA: (f64, f64) = (0.02, 4e-4);

/// The corrections of a simulation, in order.
pub(crate) fn corrections(truth: &[Pose], loops: &[Edge], random: &Stream) -> Vec<Correction> {
    let travelled = path_lengths(truth);
    let constant = Residual::constant(random);
    let correction = |edge: &Edge| {
        let nodes = edge.to as usize + 1;
        let poses = corrected(&truth[..nodes], &travelled[..nodes], &constant, &Residual::changing(random, edge));
        Correction { node: edge.to, poses }
    };
    loops.iter().filter(|edge| (edge.to as usize) < truth.len()).map(correction).collect()
}

/// The true poses with the errors that a correction leaves. Each closure also changes the earlier poses a little.
pub(super) fn corrected(truth: &[Pose], travelled: &[f64], constant: &Residual, changing: &Residual) -> Vec<Pose> {
    let correct = |(pose, &s): (&Pose, &f64)| {
        let (shift, turn) = (constant.at(s).0 + changing.at(s).0, constant.at(s).1 + changing.at(s).1);
        Pose::from_parts(Translation3::from(pose.translation.vector + shift), UnitQuaternion::new(turn) * pose.rotation)
    };
    truth.iter().zip(travelled).map(correct).collect()
}

/// A slowly varying error along the path that is zero at its start.
#[derive(Clone, Debug)]
pub(super) struct Residual {
    /// Amplitude, wavelength and phase of the waves on each axis.
    waves: [[(f64, f64, f64); 3]; 6],
}

impl Residual {
    /// The error that all corrections share.
    pub fn constant(random: &Stream) -> Self {
        Self::new(random.fork(0), 0.95)
    }

    /// The error of the correction at a loop edge.
    pub fn changing(random: &Stream, edge: &Edge) -> Self {
        Self::new(random.fork(edge.to + 1), 0.3)
    }

    fn new(mut random: Stream, share: f64) -> Self {
        let mut wave = |amplitude: f64| (amplitude * random.normal() * share, random.range(25.0, 90.0), random.range(0.0, TAU));
        // The difference of two sines of random phase has unit variance; three waves are added.
        let unit = (1.0f64 / 3.0).sqrt();
        Self { waves: std::array::from_fn(|axis| std::array::from_fn(|_| wave(unit * if axis < 3 { RESIDUAL_SIGMA.0 } else { RESIDUAL_SIGMA.1 }))) }
    }

    /// Translation (metres) and rotation vector (radians) after `s` metres of path.
    fn at(&self, s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let value = |axis: usize| self.waves[axis].iter().map(|(a, l, p)| a * ((TAU * s / l + p).sin() - p.sin())).sum::<f64>();
        (Vector3::new(value(0), value(1), value(2)), Vector3::new(value(3), value(4), value(5)))
    }
}
