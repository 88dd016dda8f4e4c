//! Solving the normal equations, but not along directions in which the surfaces hold nothing.

use super::normal_equations::NormalEquations;
use nalgebra::{Matrix6, SymmetricEigen, Vector6};

/// A direction is degenerate if the surfaces hold the pose along it with less than this share of all weights. In a balanced scene each of
/// the three translations has a third.
const LEAST_SHARE: f64 = 0.002;

/// A step of the pose.
#[derive(Clone, Debug)]
pub(crate) struct Solution {
    pub(crate) step: Vector6<f64>,
    /// Unit directions (rotations in metres at the points' radius) along which the step is zero.
    pub(crate) degenerate: Vec<Vector6<f64>>,
}

impl Solution {
    /// Solves in metres: rotations count by how far they move a point at `radius`. Nothing moves along the unit directions in `fixed`. `None` if there is
    /// nothing to solve.
    pub(crate) fn of(equations: &NormalEquations, radius: f64, fixed: &[Vector6<f64>]) -> Option<Self> {
        if equations.weight.is_nan() || equations.weight <= 0.0 || !equations.information.iter().all(|v| v.is_finite()) {
            return None;
        }
        let scale = Vector6::new(1.0, 1.0, 1.0, 1.0 / radius, 1.0 / radius, 1.0 / radius);
        let scaled = Matrix6::from_fn(|i, j| equations.information[(i, j)] * scale[i] * scale[j]);
        let gradient = equations.gradient.component_mul(&scale);
        let eigen = SymmetricEigen::new(scaled);
        let mut step = Vector6::zeros();
        let mut degenerate = Vec::new();
        for k in 0..6 {
            let (value, direction) = (eigen.eigenvalues[k], eigen.eigenvectors.column(k).into_owned());
            if value > LEAST_SHARE * equations.weight {
                step += direction * (direction.dot(&gradient) / value);
            } else {
                degenerate.push(direction);
            }
        }
        for direction in fixed {
            step -= direction * direction.dot(&step);
        }
        Some(Self { step: step.component_mul(&scale), degenerate })
    }
}
