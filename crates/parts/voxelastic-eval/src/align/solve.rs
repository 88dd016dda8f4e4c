//! Normal equations of a rigid step in six unknowns, solved only in the directions that the geometry determines.

use nalgebra::{Matrix6, SymmetricEigen, Translation3, UnitQuaternion, Vector3, Vector6};
use voxelastic::Pose;

/// One point-to-plane residual in metres, with its derivative by (rotation times radius, translation).
#[derive(Clone, Copy, Debug)]
pub(super) struct PointToPlane {
    pub derivative: [f64; 6],
    pub residual: f64,
}

impl PointToPlane {
    /// From the plane's normal, the point's offset from the centre over the radius, and the vector from the point to the plane's point.
    pub fn new(n: [f64; 3], arm: [f64; 3], gap: [f64; 3]) -> Self {
        let turn = [arm[1] * n[2] - arm[2] * n[1], arm[2] * n[0] - arm[0] * n[2], arm[0] * n[1] - arm[1] * n[0]];
        let residual = n[0] * gap[0] + n[1] * gap[1] + n[2] * gap[2];
        Self { derivative: [turn[0], turn[1], turn[2], n[0], n[1], n[2]], residual }
    }
}

/// The normal equations, summed over residuals.
#[derive(Clone, Debug, Default)]
pub(super) struct System {
    h: Matrix6<f64>,
    g: Vector6<f64>,
    squares: f64,
    count: usize,
}

/// Least eigenvalue, relative to the largest, of a direction that is determined.
const MIN_EIGENVALUE: f64 = 1e-5;

impl System {
    pub fn of(rows: &[PointToPlane], weight: impl Fn(f64) -> f64) -> Self {
        let mut s = Self::default();
        for row in rows {
            let (j, w) = (Vector6::from(row.derivative), weight(row.residual));
            s.h += j * j.transpose() * w;
            s.g += j * (w * row.residual);
            s.squares += row.residual * row.residual;
            s.count += 1;
        }
        s
    }

    pub fn plus(self, other: &Self) -> Self {
        Self { h: self.h + other.h, g: self.g + other.g, squares: self.squares + other.squares, count: self.count + other.count }
    }

    pub fn rms(&self) -> f64 {
        if self.count == 0 { 0.0 } else { (self.squares / self.count as f64).sqrt() }
    }

    /// The least-squares step; none for less than six residuals.
    pub fn solve(&self) -> Option<Step> {
        if self.count < 6 || !self.h.iter().chain(self.g.iter()).all(|v| v.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(self.h);
        let largest = eigen.eigenvalues.max();
        if largest <= 0.0 {
            return None;
        }
        let (mut x, mut undetermined) = (Vector6::zeros(), 0);
        for k in 0..6 {
            let (value, direction) = (eigen.eigenvalues[k], eigen.eigenvectors.column(k));
            if value > MIN_EIGENVALUE * largest {
                x += direction * (direction.dot(&self.g) / value);
            } else {
                undetermined += 1;
            }
        }
        Some(Step { x, undetermined })
    }
}

/// A small rigid motion.
pub(super) struct Step {
    x: Vector6<f64>,
    /// Number of directions that are not determined.
    pub undetermined: usize,
}

impl Step {
    /// The motion as a pose: a rotation about `centre`, then a translation.
    pub fn pose(&self, centre: [f64; 3], radius: f64) -> Pose {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(self.x[0], self.x[1], self.x[2]) / radius);
        let centre = Vector3::from(centre);
        let translation = centre - rotation * centre + Vector3::new(self.x[3], self.x[4], self.x[5]);
        Pose::from_parts(Translation3::from(translation), rotation)
    }

    /// Upper bound of the displacement of a point at the radius, metres.
    pub fn length(&self) -> f64 {
        self.x.fixed_rows::<3>(0).norm() + self.x.fixed_rows::<3>(3).norm()
    }
}
