//! Where the lidar is on the body whose poses are given, from how both move.

use super::motions::{Motion, middle};
use nalgebra::{Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use voxelastic::geometry::Pose;

/// Least deviation of a measured motion, metres and radians; what the motions leave says whether it is more.
const SIGMA: (f64, f64) = (0.012, 0.0015);
/// What is thought of the mounting before: nothing but that it is on a vehicle, metres and radians.
const PRIOR: (f64, f64) = (5.0, 2.0);
/// A larger rotation is no small offset, radians.
const MOST_OFFSET: f64 = 0.3;
const ITERATIONS: usize = 12;

/// Where the lidar is in the frame that the poses are of.
#[derive(Clone, Copy, Debug)]
pub struct Mounting {
    /// Its pose there.
    pub t_base_lidar: Pose,
    /// Covariance of its place and its rotation, in its own frame, metres and radians.
    pub(super) covariance: Matrix6<f64>,
}

impl Mounting {
    /// One that was said.
    pub(super) fn said(t_base_lidar: Pose) -> Self {
        Self { t_base_lidar, covariance: Matrix6::zeros() }
    }

    /// Standard deviation of its place in the direction that is known worst, metres.
    pub fn sigma_m(&self) -> f64 {
        self.covariance.fixed_view::<3, 3>(0, 0).into_owned().symmetric_eigenvalues().max().max(0.0).sqrt()
    }

    /// Only what of a small offset is larger than this (metres, radians) and so many standard deviations; none if nothing is.
    pub(super) fn significant(&self, least: (f64, f64), sigmas: f64) -> Option<Self> {
        let kept = |offset: Vector3<f64>, from: usize, least: f64| {
            let block = self.covariance.fixed_view::<3, 3>(from, from).into_owned().symmetric_eigen();
            let along = |k: usize| {
                let (axis, sigma) = (block.eigenvectors.column(k).into_owned(), block.eigenvalues[k].max(0.0).sqrt());
                let size = axis.dot(&offset);
                if size.abs() > sigmas * sigma && size.abs() > 0.5 * least { axis * size } else { Vector3::zeros() }
            };
            let sum: Vector3<f64> = (0..3).map(along).sum();
            if sum.norm() > least { sum } else { Vector3::zeros() }
        };
        let place = kept(self.t_base_lidar.translation.vector, 0, least.0);
        let turn = kept(self.t_base_lidar.rotation.scaled_axis(), 3, least.1);
        let is_any = place.norm() + turn.norm() > 0.0 && turn.norm() < MOST_OFFSET;
        is_any.then(|| Self { t_base_lidar: Pose::from_parts(Translation3::from(place), UnitQuaternion::from_scaled_axis(turn)), ..*self })
    }
}

/// Finds the mounting under which the body's motions explain the measured ones, from a guess. Squares under a robust kernel; directions that no motion tells keep the guess.
pub(super) fn mounting(given: &[Pose], motions: &[Motion], guess: &Pose) -> Option<Mounting> {
    let mut x = *guess;
    let mut information = Matrix6::zeros();
    for _ in 0..ITERATIONS {
        let mut gradient = Vector6::zeros();
        information = prior();
        let off = moved(&x.inverse(), guess);
        gradient += information * Vector6::from_iterator(off.iter().copied());
        for (base, motion) in given.iter().zip(motions) {
            let residual = residual(base, &motion.measured, &x);
            let weight = 1.0 / (1.0 + residual.norm_squared() / 9.0).powi(2);
            let mut slopes = Matrix6::zeros();
            for axis in 0..6 {
                let mut step = Vector6::zeros();
                step[axis] = 1e-6;
                slopes.set_column(axis, &((self::residual(base, &motion.measured, &stepped(&x, &step)) - residual) / 1e-6));
            }
            information += slopes.transpose() * slopes * weight;
            gradient -= slopes.transpose() * residual * weight;
        }
        let step = information.cholesky()?.solve(&gradient);
        x = stepped(&x, &step);
        if step.norm() < 1e-9 {
            break;
        }
    }
    // What the motions leave says how exact they are.
    let residuals: Vec<f64> = given.iter().zip(motions).map(|(base, motion)| residual(base, &motion.measured, &x).norm_squared() / 6.0).collect();
    let scatter = middle(residuals.into_iter()).max(1.0);
    let covariance = information.try_inverse()? * scatter;
    Some(Mounting { t_base_lidar: x, covariance })
}

/// The rotation of the mounting that explains the motions, whatever its place: translations as far as they do not turn, and axes of rotation.
pub(super) fn rotation(given: &[Pose], motions: &[Motion]) -> UnitQuaternion<f64> {
    let mut correlation = Matrix3::zeros();
    for (base, motion) in given.iter().zip(motions) {
        let (a, b) = (base.rotation.scaled_axis(), motion.measured.rotation.scaled_axis());
        correlation += b * a.transpose() * 100.0;
        let turning = 1.0 / (1.0 + 20.0 * b.norm());
        correlation += motion.measured.translation.vector * base.translation.vector.transpose() * turning;
    }
    let svd = correlation.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return UnitQuaternion::identity() };
    let sign = (v_t.transpose() * u.transpose()).determinant().signum();
    let rotation = v_t.transpose() * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * u.transpose();
    UnitQuaternion::from_matrix(&rotation)
}

/// What is left of a motion of the body, moved to the lidar, against the measured one, in standard deviations.
fn residual(base: &Pose, measured: &Pose, x: &Pose) -> Vector6<f64> {
    moved(&(base * x).inverse(), &(x * measured)).component_div(&Vector6::new(SIGMA.0, SIGMA.0, SIGMA.0, SIGMA.1, SIGMA.1, SIGMA.1))
}

fn moved(inverse: &Pose, other: &Pose) -> Vector6<f64> {
    let off = inverse * other;
    let turn = off.rotation.scaled_axis();
    Vector6::new(off.translation.x, off.translation.y, off.translation.z, turn.x, turn.y, turn.z)
}

fn stepped(x: &Pose, step: &Vector6<f64>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
    x * Pose::from_parts(Translation3::from(step.fixed_rows::<3>(0).into_owned()), turn)
}

fn prior() -> Matrix6<f64> {
    let (m, rad) = (PRIOR.0.powi(-2), PRIOR.1.powi(-2));
    Matrix6::from_diagonal(&Vector6::new(m, m, m, rad, rad, rad))
}
