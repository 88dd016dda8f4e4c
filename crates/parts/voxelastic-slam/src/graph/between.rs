//! An edge as the solver sees it: its residual, its share of the gradient, and its share of the matrix at the place where it was last linearised.

use super::lie::{adjoint, inverse_jacobian, inverse_jacobian_transposed, log};
use nalgebra::{Matrix6, Vector6};
use voxelastic::Pose;

/// Change of a residual (radians, metres) or of a weight, relative, from which an edge is linearised anew.
const STALE: (f64, f64, f64) = (1e-3, 1e-2, 0.05);

/// A measured pose of one node in the frame of another.
#[derive(Clone, Debug)]
pub(crate) struct Between {
    /// Index of the node in whose frame it is measured, and of the one measured.
    pub(crate) nodes: (usize, usize),
    t_from_to: Pose,
    /// Takes steps of the first node to the frame of the second.
    to_second: Matrix6<f64>,
    information: Matrix6<f64>,
    /// Standard deviations up to which the edge counts fully.
    huber: Option<f64>,
    /// Whether the edge does not count, as the others contradict it.
    pub(crate) is_outvoted: bool,
    linear: Option<Linear>,
}

/// What the edge adds to the matrix: blocks of the first node, of both, of the second.
#[derive(Clone, Debug)]
pub(crate) struct Linear {
    residual: Vector6<f64>,
    weight: f64,
    pub(crate) blocks: [Matrix6<f64>; 3],
}

/// An edge at some poses: residual, what the kernel leaves of it, and its cost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Evaluation {
    pub(crate) residual: Vector6<f64>,
    weight: f64,
    /// Length of the residual in standard deviations.
    pub(crate) deviation: f64,
    pub(crate) cost: f64,
}

impl Between {
    pub(crate) fn new(nodes: (usize, usize), t_from_to: Pose, information: Matrix6<f64>, huber: Option<f64>) -> Self {
        Self { nodes, t_from_to, to_second: adjoint(&t_from_to.inverse()), information, huber, is_outvoted: false, linear: None }
    }

    /// The edge at poses of its nodes.
    pub(crate) fn evaluate(&self, from: &Pose, to: &Pose) -> Evaluation {
        let residual = log(&(to.inverse() * (from * self.t_from_to)));
        let square = residual.dot(&(self.information * residual));
        let deviation = square.sqrt();
        let (weight, cost) = match self.huber {
            Some(k) if deviation > k => (k / deviation, k * (deviation - 0.5 * k)),
            _ => (1.0, 0.5 * square),
        };
        Evaluation { residual, weight, deviation, cost }
    }

    /// The deviation of the edge relative to that up to which it counts fully; none if it always does.
    pub(crate) fn contradiction(&self, from: &Pose, to: &Pose) -> Option<f64> {
        self.huber.map(|k| self.evaluate(from, to).deviation / k)
    }

    /// Its share of the gradient: of the first and of the second node.
    pub(crate) fn gradient(&self, at: &Evaluation) -> (Vector6<f64>, Vector6<f64>) {
        let pull = at.weight * (self.information * at.residual);
        let first = self.to_second.tr_mul(&inverse_jacobian_transposed(&at.residual, &pull));
        (first, -inverse_jacobian_transposed(&-at.residual, &pull))
    }

    /// Linearises the edge if it has moved since the last time; `always` also if it has moved hardly. Whether it did.
    pub(crate) fn linearise(&mut self, at: &Evaluation, always: bool) -> bool {
        let is_stale = self.linear.as_ref().is_none_or(|linear| {
            let moved = at.residual - linear.residual;
            let (angle, distance) = (moved.fixed_rows::<3>(0).norm(), moved.fixed_rows::<3>(3).norm());
            let weight = (at.weight / linear.weight - 1.0).abs();
            let share = if always { 1e-3 } else { 1.0 };
            angle > share * STALE.0 || distance > share * STALE.1 || weight > share * STALE.2
        });
        if is_stale {
            let first = inverse_jacobian(&at.residual) * self.to_second;
            let second = -inverse_jacobian(&-at.residual);
            let weighted = at.weight * self.information;
            let blocks = [first.tr_mul(&(weighted * first)), first.tr_mul(&(weighted * second)), second.tr_mul(&(weighted * second))];
            self.linear = Some(Linear { residual: at.residual, weight: at.weight, blocks });
        }
        is_stale
    }

    /// The outcome of the last linearisation.
    pub(crate) fn linear(&self) -> Option<&Linear> {
        self.linear.as_ref()
    }
}
